"""Kind 10: how exact the start is: standard deviations along each axis and of the yaw; the usual ones unless said."""

from __future__ import annotations

from fleetmap.codecs.facts.facts import Facts, FactsStep

KIND = 10
USUAL = (30_000, 2_000)
"""Micrometres and microradians."""
BYTES = 5
_KEY = bytes([KIND])


def start_sigma_of(facts: Facts) -> tuple[int, int]:
    """Micrometres and microradians."""
    value = facts.get(_KEY)
    return USUAL if value is None else (int.from_bytes(value[:BYTES], "big"), int.from_bytes(value[BYTES:], "big"))


def set_start_sigma(sigma_um: int, sigma_urad: int) -> FactsStep:
    """The step that says how exact the start is."""
    value = sigma_um.to_bytes(BYTES, "big") + sigma_urad.to_bytes(BYTES, "big")
    return {_KEY: None if (sigma_um, sigma_urad) == USUAL else value}


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` if this is no such fact."""
    if subject or len(value) != 2 * BYTES:
        raise ValueError("expected two standard deviations in 10 bytes")
