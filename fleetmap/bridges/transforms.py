"""``TransformBuffer``: who lies where in whom, over time: as much of tf2 as a map needs.

Transforms are in space, and asked for in the plane: a base that is tilted has a yaw nevertheless.
"""

from __future__ import annotations

import math
import threading
from bisect import bisect_left, insort
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from fleetmap.model.pose import Pose2

KEPT_S = 10.0
"""How far back transforms are kept, as in tf2."""
MAX_SAMPLES = 2000
"""Of one child: 200 a second."""
MAX_SAMPLES_IN_ALL = 40_000
"""Each takes some 500 B; of many children each has room for a share."""
MAX_FRAMES = 512
"""Child frames that are known; more are refused and counted."""
MAX_NAME = 255
MAX_SHIFT_M = 1e8
"""Farther than any place on earth: what is beyond is refused, so that sums stay finite."""
LONGEST_CHAIN = 64
STATIC_NS = -1


@dataclass(frozen=True, slots=True)
class Transform:
    """T_parent_child in space: ``rotation`` is a unit quaternion (x, y, z, w), ``shift_m`` (3,)."""

    shift_m: NDArray[np.float64]
    rotation: NDArray[np.float64]

    def __matmul__(self, other: Transform) -> Transform:
        turn = Rotation.from_quat(self.rotation)
        shift = self.shift_m + turn.apply(other.shift_m)
        return Transform(shift, (turn * Rotation.from_quat(other.rotation)).as_quat())

    def inverse(self) -> Transform:
        """T_child_parent."""
        back = Rotation.from_quat(self.rotation).inv()
        return Transform(-back.apply(self.shift_m), back.as_quat())

    def to_pose(self) -> Pose2:
        """What is left of it in the plane: x, y, and where the x axis points."""
        x_axis = Rotation.from_quat(self.rotation).apply([1.0, 0.0, 0.0])
        return Pose2(float(self.shift_m[0]), float(self.shift_m[1]), math.atan2(x_axis[1], x_axis[0]))


IDENTITY = Transform(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))


@dataclass(slots=True)
class _Child:
    """What is known of one frame: its parent, and where it lay when; ascending by time."""

    parent: str
    static: bool
    samples: list[tuple[int, Transform]] = field(default_factory=list)


class TransformBuffer:
    """Bounded; may be used from several threads.

    Attributes
    ----------
    refused : transforms that were none, or too many
    """

    def __init__(self) -> None:
        self._children: dict[str, _Child] = {}
        self._lock = threading.Lock()
        self.refused = 0

    def take(self, transforms: Iterable[Any], *, static: bool) -> None:
        """Take in the ``transforms`` of a ``tf2_msgs/TFMessage``."""
        for message in transforms:
            child, parent = str(message.child_frame_id).lstrip("/"), str(message.header.frame_id).lstrip("/")
            stamp = message.header.stamp
            transform = _transform_of(message.transform)
            with self._lock:
                if transform is None or not self._fits(child, parent):
                    self.refused += 1
                    continue
                self._add(child, parent, int(stamp.sec) * 10**9 + int(stamp.nanosec), transform, static=static)

    def lookup(self, target: str, source: str, stamp_ns: int | None = None) -> tuple[Pose2, int] | None:
        """T_target_source, and when that was; None if it isn't known.

        Parameters
        ----------
        stamp_ns : when; None: at the latest time at which the whole way is known
        """
        with self._lock:
            down, up = self._way(source), self._way(target)
            common = next((name for name in down if name in up), None)
            if common is None:
                return None
            down, up = down[: down.index(common)], up[: up.index(common)]
            moving = [self._children[name] for name in (*down, *up) if not self._children[name].static]
            at_ns = min((child.samples[-1][0] for child in moving), default=0) if stamp_ns is None else stamp_ns
            T_common_source, T_common_target = self._along(down, at_ns), self._along(up, at_ns)
        if T_common_source is None or T_common_target is None:
            return None
        return (T_common_target.inverse() @ T_common_source).to_pose(), at_ns

    def why_not(self, target: str, source: str) -> str:
        """In words, what is missing for a lookup that gave None."""
        with self._lock:
            known = set(self._children) | {child.parent for child in self._children.values()}
            for name in (source, target):
                if name not in known:
                    frames = ", ".join(sorted(known)[:8]) or "none at all"
                    return f"no frame {name!r} on /tf and /tf_static; there is {frames}"
            ends = self._way(source)[-1], self._way(target)[-1]
            if ends[0] != ends[1]:
                return f"{source!r} and {target!r} are in two trees, under {ends[0]!r} and {ends[1]!r}"
        return f"the way from {source!r} to {target!r} isn't known for one common time yet"

    def _fits(self, child: str, parent: str) -> bool:
        named = 0 < len(child) <= MAX_NAME and 0 < len(parent) <= MAX_NAME and child != parent
        return named and (child in self._children or len(self._children) < MAX_FRAMES)

    def _add(self, child: str, parent: str, stamp_ns: int, transform: Transform, *, static: bool) -> None:
        known = self._children.get(child)
        if known is None or known.parent != parent or known.static != static:
            known = self._children[child] = _Child(parent, static)
        samples = known.samples
        if static:
            known.samples = [(STATIC_NS, transform)]
            return
        if samples and stamp_ns < samples[-1][0] - KEPT_S * 1e9:
            samples.clear()  # time has begun anew: a simulation or a bag that was started again
        if samples and stamp_ns <= samples[-1][0]:
            if all(stamp_ns != sample[0] for sample in samples):
                insort(samples, (stamp_ns, transform), key=lambda sample: sample[0])
        else:
            samples.append((stamp_ns, transform))
        old = bisect_left(samples, samples[-1][0] - int(KEPT_S * 1e9), key=lambda sample: sample[0])
        room = min(MAX_SAMPLES, MAX_SAMPLES_IN_ALL // len(self._children))
        del samples[: max(old, len(samples) - room)]

    def _way(self, name: str) -> list[str]:
        """The frame, its parent, and so on; stops where it would go round."""
        way = [name]
        while (child := self._children.get(way[-1])) is not None and len(way) < LONGEST_CHAIN:
            if child.parent in way:
                break
            way.append(child.parent)
        return way

    def _along(self, names: list[str], at_ns: int) -> Transform | None:
        """From the first of the frames to the parent of the last one."""
        whole = IDENTITY
        for name in names:
            step = _at(self._children[name], at_ns)
            if step is None:
                return None
            whole = step @ whole
        return whole


def _at(child: _Child, at_ns: int) -> Transform | None:
    """Where a frame lay, between two samples if need be; None outside of what is known."""
    samples = child.samples
    if child.static:
        return samples[0][1]
    k = bisect_left(samples, at_ns, key=lambda sample: sample[0])
    if k == len(samples):
        return None
    after_ns, after = samples[k]
    if after_ns == at_ns:
        return after
    if k == 0:
        return None
    before_ns, before = samples[k - 1]
    part = (at_ns - before_ns) / (after_ns - before_ns)
    turn = Slerp([0.0, 1.0], Rotation.from_quat([before.rotation, after.rotation]))(part).as_quat()
    return Transform(before.shift_m + part * (after.shift_m - before.shift_m), turn)


def _transform_of(message: Any) -> Transform | None:
    """A ``geometry_msgs/Transform``; None if it isn't finite, too far, or no rotation."""
    shift, q = message.translation, message.rotation
    shift_m = np.array([shift.x, shift.y, shift.z], np.float64)
    rotation = np.array([q.x, q.y, q.z, q.w], np.float64)
    length = math.hypot(*rotation)
    # Compared so that NaN fails, too.
    if not ((np.abs(shift_m) <= MAX_SHIFT_M).all() and abs(length - 1) < 0.1):
        return None
    return Transform(shift_m, rotation / length)
