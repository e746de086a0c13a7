"""``fleetmap paper``: the paper's experiments, run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fleetmap.cli.output import AsJson, print_json, print_table, stderr
from fleetmap.model.errors import ConfigError


def paper(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder of results.")] = Path("paper"),
    maps: Annotated[
        Path | None, typer.Option("--maps", metavar="DIR", help="Also real maps: each map.yaml in DIR or below it.")
    ] = None,
    sizes: Annotated[str, typer.Option("--sizes", metavar="M,...", help="Which terrains.")] = "10,40,80",
    as_json: AsJson = False,
) -> None:
    """Run the paper's nine experiments again: maze, office and unstructured terrains of 10, 40 and 80 m.

    A simulated robot surveys each terrain with noise as a SLAM leaves it. The mapper's grid, the vector map made
    from it and the one made from the truth are scored against the truth, and the bytes of all formats are
    counted. Seeds are fixed, so that each run gives the same numbers. Leaves paper.json, report.html, figures as
    PNG, and the maps. Takes a minute or so.

    For instance:  fleetmap paper --out paper

    or the smallest terrains only, and real maps beside them:  fleetmap paper --sizes 10 --maps maps
    """
    from fleetmap.cli.maps import check_folder
    from fleetmap.model.kernel_cache import kernel_modules
    from fleetmap.model.kernel_compiler import compile_ahead
    from fleetmap.paper import PaperConfig, make_tables, run_paper

    config = PaperConfig(out=out, sizes_m=parse_sizes(sizes), maps=maps)
    check_folder(out)  # all is computed before anything is written
    compile_ahead(kernel_modules())
    with stderr.status("paper") as status:

        def say(what: str) -> None:
            status.update(what)
            if not stderr.is_terminal:
                stderr.print(what, highlight=False, soft_wrap=True)

        document = run_paper(config, on_progress=say)
    if as_json:
        print_json(document)
        return
    for table in make_tables(document):
        print_table(table.title, list(table.columns), [list(row) for row in table.rows])
        typer.echo(f"{table.note}\n")
    typer.echo(f"{out / 'report.html'}: tables and figures; {out / 'paper.json'}: all numbers")


def parse_sizes(text: str) -> tuple[int, ...]:
    """The numbers of a list such as ``10,40``."""
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(option="sizes", value=text, reason="expected 10, 40, 80, or a list such as 10,40") from None
