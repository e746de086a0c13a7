"""Checks of what a user hands in: what passes has its type, what doesn't is refused where it was handed in."""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Integral, Real
from typing import TypeVar

from fleetmap.model.errors import ConfigError

T = TypeVar("T")


def as_number(value: object) -> float | None:
    """The value as a float; None if it is no finite number. Bools and strings are none, whatever ``float`` says."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def check_number(
    option: str, value: object, *, expected: str = "a finite number", fits: Callable[[float], bool] = lambda _: True
) -> float:
    """The value as a float.

    Parameters
    ----------
    expected : what ``fits`` asks for, in words

    Raises
    ------
    ConfigError : it is no finite number, or doesn't fit
    """
    number = as_number(value)
    if number is None or not fits(number):
        raise ConfigError(option=option, value=value, reason=f"expected {expected}")
    return number


def check_count(option: str, value: object, *, least: int = 0, most: int, unit: str = "") -> int:
    """The value as an int.

    Raises
    ------
    ConfigError : it is no whole number from ``least`` to ``most``
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or not least <= int(value) <= most:
        raise ConfigError(option=option, value=value, reason=f"expected a whole number, {least} to {most}{unit}")
    return int(value)


def check_xy(option: str, value: object) -> tuple[float, float]:
    """A point as two floats, of any sequence or array of two numbers.

    Raises
    ------
    ConfigError : these are not two finite numbers
    """
    try:
        parts = [] if isinstance(value, str | bytes) else list(value)  # type: ignore[call-overload]
    except TypeError:
        parts = []
    numbers = [number for number in map(as_number, parts) if number is not None]
    if len(parts) != 2 or len(numbers) != 2:
        raise ConfigError(option=option, value=value, reason="expected two finite numbers (x, y), metres")
    return numbers[0], numbers[1]


def check_type(option: str, value: object, *kinds: type[T], hint: str = "") -> T:
    """The value, if it is of one of these types.

    Parameters
    ----------
    hint : what to do if it isn't

    Raises
    ------
    ConfigError : it is of another type
    """
    if not isinstance(value, kinds):
        told = f"expected {' or '.join(kind.__name__ for kind in kinds)}; found {type(value).__name__}"
        raise ConfigError(option=option, value=value, reason=f"{told}: {hint}" if hint else told)
    return value
