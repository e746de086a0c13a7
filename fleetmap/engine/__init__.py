"""Streams, replicas and sync decisions: no I/O, no thread, no clock."""
