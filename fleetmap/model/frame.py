"""The name of a frame."""

Frame = tuple[str, int, str]
"""(robot, life, submap)."""
