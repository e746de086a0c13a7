"""What is wrong, in words that say what to do."""

from __future__ import annotations

from dataclasses import dataclass

from fleetmap.engine import Engine


@dataclass(frozen=True, slots=True)
class Problem:
    """Something that a user should know of.

    Parameters
    ----------
    kind : ``disputed``: what a robot has said is contradicted, and nobody can tell who is right; ``namesake``: another
        living peer has the own name
    robot : whom it is about
    text : what was found, and what to do
    """

    kind: str
    robot: str
    text: str


def problems(engine: Engine) -> tuple[Problem, ...]:
    """All problems of now, by kind and robot."""
    found = [
        Problem("disputed", robot, f"{text}. forget({robot!r}) leaves it out of the merged map")
        for robot, text in sorted(engine.disputed().items())
    ]
    beside = [n for n in list(engine.neighbours.by_key.values()) if n.key[0] == engine.robot and n.spoke]
    if beside:
        lives = ", ".join(f"{n.key[1]:016x}" for n in beside)
        text = (
            f"another living peer is named {engine.robot} too (life {lives}): both maps are merged. Give each robot a "
            "name of its own, or end the other process"
        )
        found.append(Problem("namesake", engine.robot, text))
    return tuple(found)
