"""``fleetmap merge``: several maps of one building become one."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fleetmap.cli.output import AsJson, print_json, progress
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import FixedPose, Pose2

if TYPE_CHECKING:
    from fleetmap.align.protocol import Alignment
    from fleetmap.model.mergedmap import MergedMap
    from fleetmap.model.vectormap import VectorMap

LONGEST_STEM = 56
"""Characters of a file's name that a frame keeps: a number is added where two are equal, and 64 are allowed."""


def merge(
    maps: Annotated[
        list[Path], typer.Argument(metavar="MAP...", help="Maps of one storey: map_server .yaml, .fmap or .fgrid.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="OUT.fmap", help="Where the merged map goes.")],
    pose: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,YAW",
            help="Where a map lies in the merged one, metres and radians; once for each map, in their order. "
            "Without any, all are found.",
        ),
    ] = None,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="PLAN.png|MAP", help="Gives the frame, and adds no wall: a floor plan, or a map as those above."
        ),
    ] = None,
    resolution: Annotated[
        float | None, typer.Option(metavar="M", help="Metres a pixel, if the reference is a picture.")
    ] = None,
    allow_missing: Annotated[
        bool, typer.Option("--allow-missing", help="Leave out maps that can't be placed, and say which.")
    ] = False,
    png: Annotated[Path | None, typer.Option(metavar="OUT.png", help="Draw the merged map.")] = None,
    as_json: AsJson = False,
) -> None:
    """Merge maps of one storey into one map, as robots of a fleet do; where they lie is told, or found.

    With --pose for each map, p_merged = R(yaw) p_map + (x, y).

    Without, every two maps are aligned, as by `fleetmap align`, in the frame of the first map, or of the reference.
    Nothing is written, and the command ends with 1, if a map can't be placed (each pair says why), or if three or more
    maps contradict each other: one placed in two ways lies 0.3 m or 1 degree apart.

    A floor plan is a picture: dark pixels are walls, all others free, and its lower left corner is at (0, 0).

    For instance:  fleetmap merge monday.yaml tuesday.yaml -o both.fmap --png both.png

                   fleetmap merge r1.yaml r2.fmap -o both.fmap --pose 0,0,0 --pose 4.2,-1,1.5708

                   fleetmap merge r1.yaml r2.yaml -o both.fmap --reference plan.png --resolution 0.02
    """
    poses = _checked(maps, out, pose or [], reference, resolution, png)
    with progress("merge") as tell:
        result = Result(maps, reference)
        vector_maps = _read(maps, reference, resolution, tell)
        if poses:
            result.poses = list(poses)
        else:
            _find(result, vector_maps, tell)
        result.fold(vector_maps[-len(maps) :], allow_missing=allow_missing, tell=tell)
        if result.merged is not None:
            _write(result.merged, out, png, tell)
    if as_json:
        print_json(as_document(result, out, png))
    else:
        _print(result, out)
    if result.merged is None:
        raise typer.Exit(1)


def _checked(
    maps: Sequence[Path],
    out: Path,
    given: Sequence[str],
    reference: Path | None,
    resolution: float | None,
    png: Path | None,
) -> list[Pose2]:
    """The poses that are given; all that can be refused before any work is."""
    from fleetmap.cli.maps import check_output, check_resolution

    inputs = [*maps, *([] if reference is None else [reference])]
    check_output(out, ".fmap", inputs=inputs)
    if png is not None:
        check_output(png, ".png", inputs=inputs)
    check_resolution(reference, resolution)
    poses = [parse_pose(text) for text in given]
    if poses and reference is not None:
        raise ConfigError(option="reference", value=str(reference), reason="goes without --pose, which say it all")
    if poses and len(poses) != len(maps):
        reason = f"expected one for each of {len(maps)} maps, in their order; found {len(poses)}"
        raise ConfigError(option="pose", value=list(given), reason=reason)
    if len(maps) == 1 and not poses and reference is None:
        raise ConfigError(option="maps", value=str(maps[0]), reason="expected two, or one with --pose or --reference")
    return poses


def parse_pose(text: str) -> Pose2:
    """X,Y,YAW as a pose.

    Raises
    ------
    ConfigError : these are not three numbers, or it is too far away
    """
    try:
        x_m, y_m, yaw_rad = (float(part) for part in text.split(","))
        pose = Pose2(x_m, y_m, yaw_rad)
    except ValueError:  # of a number, of how many there are, or of Pose2 where one is not finite
        reason = "expected X,Y,YAW in metres and radians, as 2,1,1.5708"
        raise ConfigError(option="pose", value=text, reason=reason) from None
    FixedPose.from_pose(pose)
    return pose


def _read(
    maps: Sequence[Path], reference: Path | None, resolution_m: float | None, tell: Callable[[str], None]
) -> list[VectorMap]:
    """All maps; the reference first, if there is one."""
    from fleetmap.cli.maps import read_vector_map
    from fleetmap.model.kernel_cache import modules_of
    from fleetmap.model.kernel_compiler import compile_ahead

    compile_ahead(modules_of("model", "vectorize", "codecs", "align", "merge"))
    found = []
    if reference is not None:
        tell(f"reads {reference}")
        found.append(read_vector_map(reference, resolution_m))
    for path in maps:
        tell(f"reads {path}")
        found.append(read_vector_map(path))
    return found


def _find(result: Result, vector_maps: Sequence[VectorMap], tell: Callable[[str], None]) -> None:
    """Place all maps by those that fit."""
    from fleetmap.cli.placing import align_all, contradictions, differences, place

    def on_pair(done: int, total: int) -> None:
        tell(f"aligns pair {done + 1} of {total}")

    result.found = align_all(vector_maps, on_pair)
    poses = place(len(vector_maps), result.found)
    result.off = differences(poses, result.found)
    result.contradictions = contradictions(result.off)
    result.poses = poses[-len(result.maps) :]


@dataclass(slots=True, eq=False)
class Result:
    """What came of it.

    Parameters
    ----------
    maps, reference : their files
    poses : T_merged_map of each map; None of those that have no place
    found : each pair of those that were aligned: places in ``names``
    off : metres and radians of those that were held against the others
    contradictions : those that are too far off
    left_out : why each map that is not in the merged one isn't, in some lines
    merged : the merged map; None if there is none
    why_not : and why there is none
    """

    maps: Sequence[Path]
    reference: Path | None
    poses: list[Pose2 | None] = field(default_factory=list)
    found: Mapping[tuple[int, int], Alignment] = field(default_factory=dict)
    off: Mapping[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    contradictions: list[tuple[int, int]] = field(default_factory=list)
    left_out: dict[int, list[str]] = field(default_factory=dict)
    merged: MergedMap | None = None
    why_not: str = ""

    @property
    def names(self) -> list[str]:
        """Of all that were aligned: the reference first, if there is one."""
        return [str(path) for path in (*([] if self.reference is None else [self.reference]), *self.maps)]

    def fold(self, vector_maps: Sequence[VectorMap], *, allow_missing: bool, tell: Callable[[str], None]) -> None:
        """Merge the maps that have a place, unless they contradict each other or one is missing that must not be."""
        from fleetmap.merge.fold import fold
        from fleetmap.merge.protocol import Source

        self.left_out = {k: self._not_placed(k) for k, pose in enumerate(self.poses) if pose is None}
        if self.contradictions:
            self.why_not = f"the maps contradict each other: {self._contradictions()}"
            return
        if self._missing(allow_missing):
            return
        tell("folds")
        frames = [(robot, 0, "0") for robot in names_of(self.maps)]
        merged = fold(
            Source(frames[k], FixedPose.from_pose(pose), vector_maps[k])
            for k, pose in enumerate(self.poses)
            if pose is not None
        )
        self.left_out |= {frames.index(frame): ["can't be merged", reason] for frame, reason in merged.left_out}
        if not self._missing(allow_missing):
            self.merged = merged

    def _missing(self, allow_missing: bool) -> bool:
        """Whether too many maps are left out."""
        which = ", ".join(str(self.maps[k]) for k in sorted(self.left_out))
        if len(self.left_out) == len(self.maps):
            self.why_not = f"no map is left: {which}"
        elif self.left_out and not allow_missing:
            self.why_not = f"left out would be {which}; --allow-missing writes the others"
        return bool(self.why_not)

    def _not_placed(self, k: int) -> list[str]:
        lines, place = ["not placed"], k + len(self.names) - len(self.maps)
        for (a, b), alignment in self.found.items():
            if place in (a, b):
                other = self.names[a if b == place else b]
                either = ", which isn't placed either" if alignment.outcome == "committed" else ""
                lines.append(f"beside {other}{either}: {alignment.outcome}: {alignment.text}")
        return lines

    def _contradictions(self) -> str:
        said = []
        for a, b in self.contradictions:
            off_m, off_rad = self.off[a, b]
            by = f"{off_m:.2f} m and {math.degrees(off_rad):.1f} degrees"
            said.append(f"{self.names[b]} lies {by} elsewhere by {self.names[a]} than by the others")
        return "; ".join(said)


def names_of(paths: Iterable[Path]) -> list[str]:
    """A robot's name for each file, all of them different."""
    names: list[str] = []
    for path in paths:
        stem = re.sub(r"[^A-Za-z0-9_.-]", "_", path.stem)[:LONGEST_STEM] or "map"
        name, count = stem, 1
        while name in names:
            count += 1
            name = f"{stem}-{count}"
        names.append(name)
    return names


def _write(merged: MergedMap, out: Path, png: Path | None, tell: Callable[[str], None]) -> None:
    from fleetmap.codecs.fmap import save_fmap
    from fleetmap.report import draw_map

    tell("writes")
    image = None if png is None else draw_map(merged)  # before anything is written: it may be too large
    save_fmap(merged, out)
    if image is not None and png is not None:
        image.save(png)


def as_document(result: Result, out: Path, png: Path | None) -> dict[str, Any]:
    """The document of `fleetmap merge --json`."""
    merged, names = result.merged, result.names
    maps = []
    for k, (path, pose) in enumerate(zip(result.maps, result.poses, strict=True)):
        reason = "; ".join(result.left_out.get(k, [])) or None
        pose = None if reason is not None else pose
        x_m, y_m, yaw_rad = (None, None, None) if pose is None else (pose.x_m, pose.y_m, pose.yaw_rad)
        placed = {"placed": pose is not None, "reason": reason}
        maps.append({"path": str(path), "x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad, **placed})
    pairs = []
    for (a, b), alignment in result.found.items():
        off_m, off_rad = (round(v, 6) for v in result.off[a, b]) if (a, b) in result.off else (None, None)
        about = {"outcome": alignment.outcome, "text": alignment.text, "off_m": off_m, "off_rad": off_rad}
        pairs.append({"a": names[a], "b": names[b], **about})
    return {
        "digest": None if merged is None else merged.digest,
        "edges": None if merged is None else len(merged),
        "out": None if merged is None else str(out),
        "png": None if merged is None or png is None else str(png),
        "reference": None if result.reference is None else str(result.reference),
        "maps": maps,
        "pairs": pairs,
        "left_out": [str(result.maps[k]) for k in sorted(result.left_out)],
        "text": result.why_not or "merged",
    }


def _print(result: Result, out: Path) -> None:
    for k, (path, pose) in enumerate(zip(result.maps, result.poses, strict=True)):
        if k in result.left_out or pose is None:
            typer.echo(f"{path}: " + "\n  ".join(result.left_out[k]))
        else:
            yaw = math.degrees(pose.yaw_rad)
            again = f"--pose {pose.x_m:.4f},{pose.y_m:.4f},{pose.yaw_rad:.6f}"
            typer.echo(f"{path}: x {pose.x_m:.3f} m, y {pose.y_m:.3f} m, yaw {yaw:.3f} degrees ({again})")
    if result.merged is None:
        typer.echo(f"nothing written: {result.why_not}")
        return
    count, all_of = len(result.maps) - len(result.left_out), len(result.maps)
    of = f"{count} of {all_of} maps" if count < all_of else f"{count} map{'s' * (count > 1)}"
    typer.echo(f"{out}: {len(result.merged)} edges of {of}, digest {result.merged.digest}")
