"""``fleetmap bridge``: a robot between ROS 2 and its fleet. Its options are those of ``bridges.options``."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable
from contextlib import suppress
from dataclasses import Field
from pathlib import Path
from typing import Annotated, Any

import typer

from fleetmap.bridges.options import BridgeOptions, WireOptions, checked, options_of
from fleetmap.cli.output import stderr

bridge = typer.Typer(no_args_is_help=True, rich_markup_mode="rich")

PANELS = {BridgeOptions: "The robot in its fleet, topics and frames", WireOptions: "How ROS is reached"}


@bridge.callback()
def about() -> None:
    """Put a robot of another world into a fleet."""


def spread(function: Callable[..., None]) -> Callable[..., None]:
    """Give a command all options of the bridge; they come in as ``given``, without those that nobody gave."""

    def command(**values: Any) -> None:
        params_file, for_s = values.pop("params_file"), values.pop("for_s")
        if values.pop("no_multicast_scouting") and values["profile"] in (None, "lan"):
            values["profile"] = "local"
        function(params_file, for_s, {name: value for name, value in values.items() if value is not None})

    parameters = [_parameter(f, panel) for kind, panel in PANELS.items() for f in options_of(kind)]
    about_file = typer.Option(metavar="FILE", help="Parameters in ROS's form; options that are given win.")
    about_local = typer.Option("--no-multicast-scouting", help="The same as --profile local.")
    parameters.append(_keyword("params_file", Annotated[Path | None, about_file]))
    parameters.append(_keyword("no_multicast_scouting", Annotated[bool | None, about_local]))
    about_time = typer.Option("--for-s", min=0.0, metavar="S", help="So long; else until Ctrl-C.")
    parameters.append(_keyword("for_s", Annotated[float | None, about_time]))
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__doc__, command.__name__ = function.__doc__, function.__name__
    return command


def _parameter(f: Field[Any], panel: str) -> inspect.Parameter:
    if f.name == "robot":
        argument = typer.Argument(metavar="[ROBOT]", help=f.metadata["about"])
        return _keyword(f.name, Annotated[str | None, argument])
    kind: Any = type(f.default)
    shown = f.default if f.default not in ("", (), True, False) else None
    name = "--" + f.name.replace("_", "-")
    flags = [f"{name}/--no-{name[2:]}"] if kind is bool else [name]
    about = f.metadata["about"] + (f" [dim]\\[{shown}][/dim]" if shown is not None else "")
    option = typer.Option(*flags, help=about, rich_help_panel=panel, show_default=False)
    wanted = list[str] if kind is tuple else kind
    return _keyword(f.name, Annotated[wanted | None, option])


def _keyword(name: str, annotation: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


@bridge.command("ros2")
@spread
def ros2(params_file: Path | None, for_s: float | None, given: dict[str, Any]) -> None:
    """Share a ROS 2 robot's map with its fleet, and say the fleet's map to ROS; no ROS is needed. Until Ctrl-C.

    Speaks the wire of rmw_zenoh, or of zenoh-bridge-ros2dds with `--via ros2dds`, to the router beside the robot.

    In: the map (latched, any distribution), its updates, and the pose by /tf. Out: fleet_map (latched), walls and
    frontiers as markers, teammates, the transform from the fleet's frame to the robot's map, diagnostics.

    For instance:  fleetmap bridge ros2 r1 --fleet site-4 --start 0,0,0 --connect tcp/10.0.0.2:7448

    in a namespace, with parameters in a file:  fleetmap bridge ros2 --namespace /r1 --params-file r1.yaml
    """
    from fleetmap.bridges.parameters import read_parameters
    from fleetmap.bridges.ros2 import serve

    if params_file is not None:
        node, namespace = (
            given.get(name, next(f.default for f in options_of(WireOptions) if f.name == name))
            for name in ("node", "namespace")
        )
        given = {**read_parameters(params_file, node=node, namespace=namespace), **given}
    options = BridgeOptions(**checked(BridgeOptions, given))
    wire = WireOptions(**checked(WireOptions, given))

    def tell(text: str) -> None:
        stderr.print(f"{options.robot}: {text}", markup=False, highlight=False, soft_wrap=True)

    place = wire.ros_listen or wire.ros_endpoint
    tell(f"joins fleet {options.fleet}; ROS by {wire.via} at {place}, {wire.dialect().where}. Ctrl-C ends it.")

    async def work() -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(for_s):
                await serve(options, wire, tell)

    asyncio.run(work())
