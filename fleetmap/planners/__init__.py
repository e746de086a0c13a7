"""Paths on maps."""
