"""Transforms as messages, and a buffer that has taken some."""

from types import SimpleNamespace

from fleetmap.bridges.transforms import TransformBuffer

S = 10**9
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def stamped(parent, child, at_ns=0, shift=(0.0, 0.0, 0.0), q=UPRIGHT):
    stamp = SimpleNamespace(sec=at_ns // S, nanosec=at_ns % S)
    transform = SimpleNamespace(
        translation=SimpleNamespace(**dict(zip("xyz", shift, strict=True))),
        rotation=SimpleNamespace(**dict(zip("xyzw", q, strict=True))),
    )
    header = SimpleNamespace(stamp=stamp, frame_id=parent)
    return SimpleNamespace(header=header, child_frame_id=child, transform=transform)


def buffer_of(*messages, static=()):
    buffer = TransformBuffer()
    buffer.take(messages, static=False)
    buffer.take(static, static=True)
    return buffer


def x_at(buffer, at_ns, target="a", source="b"):
    found = buffer.lookup(target, source, at_ns)
    return None if found is None else found[0].x_m
