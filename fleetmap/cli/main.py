"""The commands, and what each way to fail looks like from outside.

Exit codes: 0 ok, 1 ran but failed, 2 usage, 130 interrupted. With ``--json`` stdout holds exactly one JSON
document, also for errors.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import warnings
from typing import Annotated

import typer
from rich.markup import escape

from fleetmap.__main__ import main as main
from fleetmap.cli.align import align
from fleetmap.cli.bridge import bridge
from fleetmap.cli.compare import compare
from fleetmap.cli.compiling import CompilingShown
from fleetmap.cli.doctor import doctor
from fleetmap.cli.merge import merge
from fleetmap.cli.output import CheckedOutput, OutputLost, print_json, stderr
from fleetmap.cli.paper import paper
from fleetmap.cli.play import play
from fleetmap.cli.rasterize import rasterize
from fleetmap.cli.record import record
from fleetmap.cli.sim import sim
from fleetmap.cli.stats import stats
from fleetmap.cli.vectorize import vectorize
from fleetmap.cli.warmup import warmup
from fleetmap.model.errors import ConfigError, FleetmapError
from fleetmap.model.kernel_compiler import listen
from fleetmap.version import __version__

app = typer.Typer(
    help="Robots of a fleet share vector maps peer to peer, and all hold the same merged map.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (sim, stats, doctor, record, play, vectorize, rasterize, compare, align, merge, paper, warmup):
    app.command()(command)
app.add_typer(bridge, name="bridge")

# typer keeps its exceptions in a copy of click of its own: reach them through the public name it exports.
_UsageError = typer.BadParameter.__mro__[1]


@app.callback(invoke_without_command=True)
def top(
    version: Annotated[bool, typer.Option("--version", help="Print the version and end.", is_eager=True)] = False,
) -> None:
    """Robots of a fleet share vector maps peer to peer, and all hold the same merged map."""
    if version:
        typer.echo(f"fleetmap {__version__}")
        raise typer.Exit


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout = CheckedOutput(sys.stdout)
    try:
        code = _run(arguments)
        sys.stdout.flush()
    except OutputLost as error:
        # What is left in the buffer would fail once more as Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not error.reader_gone:  # as in `| head`, which has what it wanted
            _tell(f"[bold red]error:[/] {error}")
        return 1
    return code


def _run(arguments: list[str]) -> int:
    as_json = "--json" in arguments
    told: set[str] = set()

    def show_once(message: Warning | str, *_: object, **__: object) -> None:
        # A command that runs something twice, for its time, says everything once.
        if str(message) not in told:
            told.add(str(message))
            _tell(f"[yellow]warning:[/] {escape(str(message))}")

    warnings.showwarning = show_once
    compiling = CompilingShown()
    listen(compiling)
    try:
        result = app(arguments, prog_name="fleetmap", standalone_mode=False)
        if result == 130:  # newer versions of typer turn Ctrl-C into this
            raise KeyboardInterrupt
        return result if isinstance(result, int) else 0
    except ConfigError as error:
        return _fail(error, 2, as_json)
    except FleetmapError as error:
        return _fail(error, 1, as_json)
    except OSError as error:
        return _fail(error, 1, as_json)
    except (KeyboardInterrupt, typer.Abort) as error:
        return _fail(error, 130, as_json)
    except Exception as error:
        if not isinstance(error, _UsageError):
            raise
        return _fail(error, 2, as_json)
    finally:
        compiling.close()
        listen(None)


def _fail(error: BaseException, code: int, as_json: bool) -> int:
    if code == 130:
        kind, message = "Interrupted", "interrupted"
    else:
        kind = type(error).__name__
        formatter = getattr(error, "format_message", None)
        message = formatter() if formatter else str(error)
    if as_json:
        print_json({"error": {"type": kind, "message": message, "exit_code": code}})
    elif code == 2 and not message:
        return code  # help was asked for, and has been printed
    else:
        _tell(f"[bold red]error:[/] {escape(message)}")
        if code == 2:
            _tell("Try a command with --help.")
    return code


def _tell(text: str) -> None:
    with contextlib.suppress(OSError):  # nobody can be told
        stderr.print(text, highlight=False, soft_wrap=True)
