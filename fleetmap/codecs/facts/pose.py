"""A pose as the value of a fact: four msgpack numbers; no bytes for the identity."""

from __future__ import annotations

from functools import lru_cache

import msgpack

from fleetmap.model.pose import MAX_UM, Q30, FixedPose


def pack_pose(pose: FixedPose) -> bytes:
    """x, y in micrometres, cos, sin times 2^30."""
    if pose == FixedPose():
        return b""
    packed: bytes = msgpack.packb([pose.x_um, pose.y_um, pose.cos_q30, pose.sin_q30])
    return packed


@lru_cache(4096)
def unpack_pose(value: bytes) -> FixedPose:
    """The pose in a value; ``ValueError`` if it is none, or not as ``pack_pose`` writes it."""
    if not value:
        return FixedPose()
    try:
        numbers = msgpack.unpackb(value, max_str_len=0, max_bin_len=0, max_map_len=0, max_ext_len=0, max_array_len=4)
    except (ValueError, msgpack.exceptions.UnpackException) as error:
        raise ValueError(f"expected a pose: {error}") from None
    if not isinstance(numbers, list) or len(numbers) != 4 or any(type(number) is not int for number in numbers):
        raise ValueError("expected a pose of four whole numbers")
    x_um, y_um, cos_q30, sin_q30 = numbers
    if max(abs(x_um), abs(y_um)) > MAX_UM or max(abs(cos_q30), abs(sin_q30)) > Q30:
        raise ValueError("a pose is out of bounds")
    pose = FixedPose(x_um, y_um, cos_q30, sin_q30)
    if pack_pose(pose) != value:
        raise ValueError("expected a pose in its shortest form")
    return pose
