"""The options of each command that joins a fleet, under Zenoh's own names."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Connect = Annotated[
    list[str] | None, typer.Option("--connect", metavar="ENDPOINT", help="Where a robot listens, as tcp/10.0.0.2:7447.")
]
Listen = Annotated[list[str] | None, typer.Option("--listen", metavar="ENDPOINT", help="Where others may connect.")]
NoMulticast = Annotated[bool, typer.Option("--no-multicast-scouting", help="Find robots by --connect alone.")]
Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="JSON of the robots' config=, as for their certificates."),
]


def profile(no_multicast: bool) -> str:
    """The profile that stands for that flag."""
    return "local" if no_multicast else "lan"


def settings(config: Path | None) -> dict[str, object] | None:
    """What a file of settings holds.

    Raises
    ------
    ConfigError : it can't be read
    """
    from fleetmap.peer.settings import read_config

    return None if config is None else read_config(config)
