"""Rigid transforms of the plane: ``Pose2`` in metres for people, ``FixedPose`` in integers for the fleet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fleetmap.model.checks import as_number
from fleetmap.model.errors import ConfigError

Q30 = 1 << 30
MAX_UM = 1 << 44
"""Largest offset of a ``FixedPose`` along one axis, micrometres: 17592 km, so that UTM coordinates are within."""


@dataclass(frozen=True, slots=True)
class Pose2:
    """A pose, or the transform ``T_a_b`` that maps coordinates of frame b into frame a.

    Metres and radians, right-handed, yaw counter-clockwise from x (REP-103). Numbers of any type become floats; a
    bool, a string, NaN or infinity is a ConfigError.

    >>> Pose2(1.0, 0.0, math.pi / 2).apply([[2.0, 0.0]]).round(6).tolist()
    [[1.0, 2.0]]
    """

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        given = (self.x_m, self.y_m, self.yaw_rad)
        for name, value in zip(("x_m", "y_m", "yaw_rad"), given, strict=True):
            number = as_number(value)
            if number is None:
                reason = "expected three finite numbers: x_m, y_m, yaw_rad"
                raise ConfigError(option="pose", value=given, reason=reason)
            object.__setattr__(self, name, number)

    def __matmul__(self, other: Pose2) -> Pose2:
        """``T_a_c = T_a_b @ T_b_c``."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return Pose2(
            self.x_m + c * other.x_m - s * other.y_m,
            self.y_m + s * other.x_m + c * other.y_m,
            wrap(self.yaw_rad + other.yaw_rad),
        )

    def inverse(self) -> Pose2:
        """``T_b_a`` of this ``T_a_b``."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return Pose2(-c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m, wrap(-self.yaw_rad))

    def apply(self, points_xy: ArrayLike) -> NDArray[np.float64]:
        """Map points, (..., 2) metres, through this transform."""
        p = np.asarray(points_xy, np.float64)
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        out = np.empty_like(p)
        out[..., 0] = self.x_m + c * p[..., 0] - s * p[..., 1]
        out[..., 1] = self.y_m + s * p[..., 0] + c * p[..., 1]
        return out


@dataclass(frozen=True, slots=True)
class FixedPose:
    """A transform in whole micrometres and a Q30 rotation: computed once by its author, then only read.

    Every peer applies it with integers alone, so that no libm can make two peers disagree.
    """

    x_um: int = 0
    y_um: int = 0
    cos_q30: int = Q30
    sin_q30: int = 0

    def __post_init__(self) -> None:
        if max(abs(self.x_um), abs(self.y_um)) > MAX_UM:
            place_m = self.x_um / 1e6, self.y_um / 1e6
            reason = f"expected x and y of at most {MAX_UM / 1e6:.0f} m: poses travel as whole micrometres up to 2^44"
            raise ConfigError(option="pose", value=place_m, reason=reason)
        # A rotation that is off by more than rounding would scale the map.
        if abs(self.cos_q30**2 + self.sin_q30**2 - Q30**2) > Q30 << 3:
            raise ConfigError(option="pose", value=(self.cos_q30, self.sin_q30), reason="no rotation in Q30")

    @classmethod
    def from_pose(cls, pose: Pose2) -> FixedPose:
        """Round a pose to micrometres and Q30; ConfigError if it is farther than ``MAX_UM`` from 0."""
        if max(abs(pose.x_m), abs(pose.y_m)) > MAX_UM / 1e6:  # the largest floats have no micrometres
            raise ConfigError(option="pose", value=pose, reason=f"at most {MAX_UM // 10**6} m from 0")
        return cls(
            round(pose.x_m * 1e6),
            round(pose.y_m * 1e6),
            round(math.cos(pose.yaw_rad) * Q30),
            round(math.sin(pose.yaw_rad) * Q30),
        )

    def to_pose(self) -> Pose2:
        """The same transform in metres and radians."""
        return Pose2(self.x_um / 1e6, self.y_um / 1e6, math.atan2(self.sin_q30, self.cos_q30))

    def __matmul__(self, other: FixedPose) -> Self:
        """Compose in Python integers; each component is rounded half up once."""
        c, s = self.cos_q30, self.sin_q30
        return type(self)(
            self.x_um + shift_round(c * other.x_um - s * other.y_um, 30),
            self.y_um + shift_round(s * other.x_um + c * other.y_um, 30),
            *as_rotation(
                shift_round(c * other.cos_q30 - s * other.sin_q30, 30),
                shift_round(s * other.cos_q30 + c * other.sin_q30, 30),
            ),
        )

    def inverse(self) -> Self:
        """``T_b_a`` of this ``T_a_b``; the offset is rounded half up once."""
        c, s = self.cos_q30, self.sin_q30
        return type(self)(
            shift_round(-c * self.x_um - s * self.y_um, 30), shift_round(s * self.x_um - c * self.y_um, 30), c, -s
        )

    def apply_um(self, x_um: int, y_um: int) -> tuple[int, int]:
        """A point in whole micrometres, mapped through this transform and rounded half up once."""
        c, s = self.cos_q30, self.sin_q30
        return self.x_um + shift_round(c * x_um - s * y_um, 30), self.y_um + shift_round(s * x_um + c * y_um, 30)


class FarPose(FixedPose):
    """A pose on the way of a computation: it may lie beyond ``MAX_UM``, and what is composed from it, too."""

    __slots__ = ()

    def __post_init__(self) -> None:
        """Any is allowed."""


def as_rotation(cos_q30: int, sin_q30: int) -> tuple[int, int]:
    """The same direction as a rotation: in a long chain of poses the roundings add up, and would scale the map."""
    square = cos_q30**2 + sin_q30**2
    if abs(square - Q30**2) <= Q30 << 2:
        return cos_q30, sin_q30
    length = math.isqrt(square)
    return ((cos_q30 << 30) + length // 2) // length, ((sin_q30 << 30) + length // 2) // length


def shift_round(value: int, bits: int) -> int:
    """``value / 2**bits`` rounded half up, exactly."""
    return (value + (1 << (bits - 1))) >> bits


def wrap(yaw_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    return math.pi - (math.pi - yaw_rad) % (2 * math.pi)
