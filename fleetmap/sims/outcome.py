"""The end of a run: its figures, and the run folder with ``report.html``, ``map.*`` and ``stats.json``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict

import numpy as np

from fleetmap.accounting import (
    BASELINES,
    Comparison,
    Count,
    Transport,
    compare,
    together,
    with_heartbeats,
)
from fleetmap.model.lattice import FREE
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.report import Chart, Curve, Report, Trail, colour, draw_map, write_report
from fleetmap.sims.config import HEARTBEAT_S, Death, RobotProgress
from fleetmap.sims.run import Run
from fleetmap.sims.score import covered, map_error

BYTES = (
    "bytes_vector",
    "bytes_deltas",
    "bytes_grid_gzip_full",
    "bytes_grid_gzip_updates",
    "bytes_grid_exact_updates",
)

LABELS = {
    "grid_gzip_full": ("whole grids, gzip", "#9aa4ae"),
    "grid_gzip_updates": ("changed rectangles, gzip", "#4d5863"),
    "grid_exact_updates": ("differences, exact layer", "#2f6fb0"),
    "vector": ("fleetmap, all it sent", "#c0445c"),
}
"""What is shown, and in which colour."""


def write_outcome(run: Run, deaths: list[Death]) -> dict[str, object]:
    """Score the run and write its folder; returns what ``stats.json`` holds."""
    from fleetmap.codecs.fmap import load_fmap, save_fmap
    from fleetmap.model.map_server import save_map

    out = run.config.out
    maps = {robot: as_merged(load_fmap(path)) for robot, path in run.maps.items()}
    # Peers that hold the same map need to be looked at once.
    distinct = {merged.digest: (merged, run.T_world_merged(robot)) for robot, merged in maps.items()}
    shown, T_world_shown = next(iter(distinct.values()), (MergedMap(np.zeros((0, 8), np.int32)), Pose2()))
    grid = shown.to_grid() if len(shown) else None
    explored_m2 = 0.0 if grid is None else int((grid.states_yx() == FREE).sum()) * grid.resolution_m**2
    document = figures(run, deaths, list(distinct.values()), explored_m2=explored_m2)
    save_fmap(shown, out / "map.fmap")
    if grid is not None:
        save_map(grid, out / "map.yaml")
    (out / "stats.json").write_text(json.dumps(document, indent=1, allow_nan=False, default=str) + "\n")
    report = make_report(run, deaths, shown, T_world_shown, document)
    draw_map(shown, report.trails).save(out / "map.png")
    write_report(report, out / "report.html")
    return document


def as_merged(loaded: object) -> MergedMap:
    """What a robot wrote, which is a merged map."""
    if not isinstance(loaded, MergedMap):
        raise TypeError(f"expected a merged map; found {type(loaded).__name__}")
    return loaded


def figures(
    run: Run, deaths: list[Death], maps: list[tuple[MergedMap, Pose2]], *, explored_m2: float
) -> dict[str, object]:
    """All numbers of a run; the worst living peer counts where they differ.

    Parameters
    ----------
    maps : what the living peers hold, and where its frame really lies in the world
    explored_m2 : free in the merged map
    """
    config = run.config
    sizes = [sent(run, robot) for robot in run.latest]
    fleet = together(comparison(run, robot, run.latest[robot], at_end=True) for robot in run.latest)
    totals = {key: sum(size[key] for size in sizes) for key in BYTES}
    errors = [map_error(m, pose, run.world, run.reachable, range_m=config.range_m) for m, pose in maps]
    worst = max(errors, key=lambda e: -1.0 if math.isnan(e.p95) else e.p95, default=None)
    error = {} if worst is None else {k: None if math.isnan(v) else round(v, 4) for k, v in asdict(worst).items()}
    digests = sorted({str(answer["digest"]) for answer in run.sync.values()})
    return {
        "robots": len(run.latest),
        "components": components(run),
        "together_s": together_s(run),
        "misplaced_m": misplaced_m(run),
        "covered": round(min((covered(m, pose, run.world, run.reachable) for m, pose in maps), default=0.0), 5),
        "converged": run.converged,
        "finished": run.finished,
        "digest": digests[0] if run.converged else None,
        "collisions": sum(p.collisions for p in run.latest.values()),
        "merged_error_m": error or {"median": None, "p95": None},
        "duration_s": round(run.duration_s, 2),
        "simulated_s": max((p.t_s for p in run.latest.values()), default=0.0),
        "distance_m": round(sum(p.distance_m for p in run.latest.values()), 2),
        "published": sum(p.published for p in run.latest.values()),
        "reachable_m2": round(float(run.reachable.sum()) * run.world.resolution_m**2, 2),
        **totals,
        "ratio_full": ratio(totals["bytes_grid_gzip_full"], totals["bytes_vector"]),
        "ratio_updates": ratio(totals["bytes_grid_gzip_updates"], totals["bytes_vector"]),
        "ratio_exact": ratio(totals["bytes_grid_exact_updates"], totals["bytes_vector"]),
        "explored_m2": round(explored_m2, 2),
        "bytes_per_m2": per(totals["bytes_vector"], explored_m2),
        "bytes_per_s_robot": per(totals["bytes_vector"], fleet.time_s),
        "wire_bytes_vector": fleet.wire.total,
        **{f"wire_bytes_{name}": size for name, size in fleet.wire_grids.items()},
        **{f"wire_ratio_{short}": ratio(fleet.wire_grids[name], fleet.wire.total) for name, short in BASELINES.items()},
        "wire_bytes_per_m2": per(fleet.wire.total, explored_m2),
        "wire_bytes_per_s_robot": per(fleet.wire.total, fleet.time_s),
        "wire": fleet.wire._asdict(),
        "merged_edges": max((len(m) for m, _ in maps), default=0),
        "dead": [asdict(death) for death in deaths],
        "per_robot": [robot_figures(run, robot) for robot in run.latest],
        "fleet": run.fleet,
        "endpoint": run.endpoint,
        "world": run.world.name,
        "config": {**asdict(config), "out": str(config.out)},
    }


def sent(run: Run, robot: str) -> dict[str, int]:
    """One robot's bytes; what it sent after the last round counts, too, unless it died before."""
    stats, progress = run.stats.get(robot, {}), run.latest[robot]
    return {key: int(str(stats.get(key, getattr(progress, key)))) for key in BYTES}


def comparison(run: Run, robot: str, progress: RobotProgress, *, at_end: bool = False) -> Comparison:
    """One robot's bytes, payload and wire, beside grids, with the heartbeats and keep-alives of simulated time.

    ``at_end``: what it sent after the last round counts, too, unless it died before.
    """
    stats = run.stats.get(robot, {}) if at_end else {}

    def counts(name: str) -> dict[str, Count]:
        table = stats.get(name, getattr(progress, name))
        assert isinstance(table, Mapping)
        return {str(key): Count(*count) for key, count in table.items()}

    none = dict.fromkeys(BASELINES, Count())
    sent = with_heartbeats(counts("sent"), progress.t_s, HEARTBEAT_S)
    return compare(sent, {**none, **counts("grids")}, progress.t_s, Transport(robot, run.fleet))


def robot_figures(run: Run, robot: str) -> dict[str, object]:
    """One robot's row: its last progress, what it sent by kind, and what its peer counted."""
    progress = run.latest[robot]
    stats = run.stats.get(robot, {})
    kinds = stats.get("sent", {})
    shown = {key: value for key, value in asdict(progress).items() if key not in ("trail_xy", "grids")}
    found = comparison(run, robot, progress, at_end=True)
    return {
        **shown,
        **sent(run, robot),
        "wire_bytes_vector": found.wire.total,
        **{f"wire_bytes_{name}": size for name, size in found.wire_grids.items()},
        "sent": {kind: count[1] for kind, count in kinds.items()} if isinstance(kinds, dict) else {},
        "sent_messages": {kind: count[0] for kind, count in kinds.items()} if isinstance(kinds, dict) else {},
        "received": stats.get("received", {}),
        "dropped": stats.get("dropped", {}),
        "digest": run.sync.get(robot, {}).get("digest"),
        "missing": run.sync.get(robot, {}).get("missing"),
    }


def components(run: Run) -> int:
    """How many merged maps the living peers hold: those that share a robot are one component."""
    groups: list[set[str]] = []
    for robot, answer in run.sync.items():
        revisions = answer["revisions"]
        held = {robot} | {str(row[0]) for row in revisions} if isinstance(revisions, list) else {robot}
        joined = [group for group in groups if group & held]
        groups = [group for group in groups if not group & held] + [held.union(*joined)]
    return len(groups)


def ratio(baseline: int, size: int) -> float | None:
    """How many times larger the baseline is."""
    return round(baseline / size, 2) if size else None


def per(size_bytes: int, of: float) -> float | None:
    """Bytes per square metre, or second."""
    return round(size_bytes / of, 2) if of > 0 else None


def make_report(
    run: Run, deaths: list[Death], shown: MergedMap, T_world_shown: Pose2, document: dict[str, object]
) -> Report:
    """What the report shows of a run, in the frame of the merged map that is ``shown``."""
    T_shown_world = T_world_shown.inverse()
    times = [max(p.t_s for p in row.values()) for row in run.series]
    robots = list(run.latest)
    trails = tuple(
        Trail(robot, trail(run, robot, T_shown_world), dead=any(death.robot == robot for death in deaths))
        for robot in robots
    )
    coverage = Chart(
        "Coverage over time",
        "share of the reachable floor that the robot knows, in %",
        tuple(
            Curve(robot, tuple(zip(times, (100 * row[robot].covered for row in run.series), strict=True)), colour(k))
            for k, robot in enumerate(robots)
        ),
    )
    payload = Chart(
        "Payload over time",
        "handed to the transport by the whole fleet, to one receiver, kB, logarithmic",
        tuple(
            Curve(label, tuple(zip(times, kilobytes(run, f"bytes_{name}"), strict=True)), tint)
            for name, (label, tint) in LABELS.items()
        ),
        logarithmic=True,
    )
    parts = [together(comparison(run, robot, p) for robot, p in row.items()) for row in run.series]
    wire = Chart(
        "On the wire over time",
        "the same on an IP link, with all that a fleet says besides its map, kB, logarithmic",
        tuple(
            Curve(
                label,
                tuple(
                    (t_s, (part.wire.total if name == "vector" else part.wire_grids[name]) / 1e3)
                    for t_s, part in zip(times, parts, strict=True)
                ),
                tint,
            )
            for name, (label, tint) in LABELS.items()
        ),
        logarithmic=True,
    )
    return Report(
        title=f"{len(robots)} robots, {run.world.name}",
        subtitle=f"fleetmap sim · seed {run.config.seed} · {fixed(document['simulated_s'], 0)} s simulated in "
        f"{fixed(document['duration_s'], 0)} s · digest {document['digest'] or 'differs'}",
        merged=shown,
        trails=trails,
        tiles=tiles(document),
        charts=(coverage, payload, wire),
        table=robot_table(run),
        sizes=size_table(document),
        notes=tuple(
            f"{death.robot} was lost after {death.t_s:g} s of simulated time ({death.wall_s:g} s after the start of "
            f"the run): {death.reason}. Its map stays in the merged one."
            for death in deaths
        ),
    )


def tiles(document: dict[str, object]) -> tuple[tuple[str, str, str], ...]:
    """The summary: (name, value, explanation)."""
    error = document["merged_error_m"]
    assert isinstance(error, dict)
    return (
        ("covered", f"{fixed(document['covered'], 2, 100)} %", "of the floor that a robot can reach"),
        ("converged", "yes" if document["converged"] else "no", "all living robots hold the same map"),
        ("map error", f"{fixed(error['median'], 1, 100)} cm", f"median; p95 {fixed(error['p95'], 1, 100)} cm"),
        ("collisions", str(document["collisions"]), "contacts with the true world"),
        (
            "sent",
            f"{fixed(document['bytes_vector'], 1, 1e-3)} / {fixed(document['wire_bytes_vector'], 1, 1e-3)} kB",
            "payload / on the wire, by all robots, to one receiver",
        ),
        ("whole grids", both(document, "full"), "as many bytes, gzipped: payload / on the wire"),
        ("changed rectangles", both(document, "updates"), "as many bytes, gzipped as map updates"),
        ("differences", both(document, "exact"), "as many bytes, through the exact layer"),
        (
            "a square metre",
            f"{fixed(document['bytes_per_m2'], 1)} / {fixed(document['wire_bytes_per_m2'], 1)} B",
            "payload / on the wire, of floor explored",
        ),
        (
            "a second and robot",
            f"{fixed(document['bytes_per_s_robot'], 1)} / {fixed(document['wire_bytes_per_s_robot'], 1)} B",
            "payload / on the wire",
        ),
        ("driven", f"{fixed(document['distance_m'], 0)} m", "all robots together"),
    )


def both(document: dict[str, object], short: str) -> str:
    """A ratio as payload and on the wire."""
    return f"{fixed(document[f'ratio_{short}'], 1)} / {fixed(document[f'wire_ratio_{short}'], 1)} times"


def size_table(document: dict[str, object]) -> tuple[tuple[str, ...], ...]:
    """Header, and what was sent beside what grids would have taken."""
    rows = [("", "payload kB", "times", "wire kB", "times")]
    for name, (label, _) in LABELS.items():
        short = BASELINES.get(name)
        payload, wire = document[f"bytes_{name}"], document[f"wire_bytes_{name}"]
        times = ("", "") if short is None else (document[f"ratio_{short}"], document[f"wire_ratio_{short}"])
        rows.append((label, fixed(payload, 1, 1e-3), fixed(times[0], 1), fixed(wire, 1, 1e-3), fixed(times[1], 1)))
    return tuple(rows)


def robot_table(run: Run) -> tuple[tuple[str, ...], ...]:
    """Header and one row a robot."""
    head = ("robot", "state", "driven m", "published", "sent kB", "of it deltas kB", "on the wire kB", "contacts")
    rows = []
    for p in run.latest.values():
        size = sent(run, p.robot)
        wire = comparison(run, p.robot, p, at_end=True).wire.total
        sizes = (f"{size['bytes_vector'] / 1e3:.1f}", f"{size['bytes_deltas'] / 1e3:.1f}", f"{wire / 1e3:.1f}")
        state = "dead" if p.state == "dead" else "done"
        rows.append((p.robot, state, f"{p.distance_m:.1f}", str(p.published), *sizes, str(p.collisions)))
    return (head, *rows)


def kilobytes(run: Run, key: str) -> Iterable[float]:
    """The fleet's total after each round."""
    return [sum(int(getattr(p, key)) for p in row.values()) / 1e3 for row in run.series]


def trail(run: Run, robot: str, T_shown_world: Pose2) -> tuple[tuple[float, float], ...]:
    """Where a robot went, from its start, in the frame of the map that is shown."""
    start = run.starts[list(run.latest).index(robot)]
    points = [(start.x_m, start.y_m)]
    before = None
    for row in run.series:
        if row[robot].t_s != before:  # a dead robot's last row stays
            points += [(float(x), float(y)) for x, y in row[robot].trail_xy]
        before = row[robot].t_s
    return tuple((float(x), float(y)) for x, y in T_shown_world.apply(points))


def together_s(run: Run) -> float | None:
    """When, in simulated time, all who lived were in one merged map for good; None if they weren't in the end."""
    since = None
    for row in run.series:
        living = [p for p in row.values() if p.state != "dead"]
        all_in = bool(living) and all(p.members >= len(living) for p in living)
        since = (since if since is not None else max(p.t_s for p in living)) if all_in else None
    return since


def misplaced_m(run: Run) -> float:
    """How far a merged map had its own robot from where that really was, at most, at any moment."""
    worst = 0.0
    for row in run.series:
        for robot, p in row.items():
            if p.state not in ("dead", "starting"):
                x, y = run.start_of(robot).inverse().apply((p.x_m, p.y_m))
                there = (run.T_world_frame(p.frame) @ Pose2(*p.T_merged_robot)).apply((x, y))
                worst = max(worst, math.dist(there, (p.x_m, p.y_m)))
    return round(worst, 4)


def fixed(value: object, digits: int, factor: float = 1.0) -> str:
    """A number for people; a dash if there is none."""
    return f"{value * factor:,.{digits}f}" if isinstance(value, int | float) else "-"
