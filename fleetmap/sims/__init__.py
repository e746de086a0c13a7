"""Simulated fleets."""
