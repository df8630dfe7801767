"""``artiworld check``: whether assets work in a simulator, with figures."""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from app.cli.batch import asset_names, find_assets, run_all
from app.cli.options import add_json
from app.cli.physics_options import add_physics, physics_settings, store_folder
from model.core.errors import ArtiworldError, ConfigurationError

if TYPE_CHECKING:
    from model.core.articulated_object import ArticulatedObject
    from model.physics.simulation_values import Physics, PhysicsSettings

DOUBTS_TOLD = 3
"""Of one asset's joints that are to be looked at, in the table's lines; ``--json`` has all."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    add = parser.add_argument
    add("assets", nargs="+", type=Path, metavar="ASSET",
        help="asset folders, URDF and MJCF files, or folders of assets")  # fmt: skip
    add("--format", action="append", default=[], metavar="NAME,NAME",
        help="formats to write and read back (default: all)")  # fmt: skip
    add("--gate", action=argparse.BooleanOptionalAction, default=True,
        help="sweep every joint, and drive it in MuJoCo")  # fmt: skip
    add("--allow-broken", action="store_true",
        help="exit with 0 where all can be read back, whatever the gate says")  # fmt: skip
    add("--compare-coacd", type=float, default=0.0, metavar="SECONDS",
        help="also run coacd with its defaults, this long an asset at most")  # fmt: skip
    add_physics(parser)
    add("--jobs", type=int, default=None, metavar="N",
        help="processes (default: as many as processors)")  # fmt: skip
    add_json(parser)


@dataclass(frozen=True)
class CheckTask:
    """One asset to check; picklable."""

    asset: Path
    name: str
    formats: tuple[str, ...]
    physics: PhysicsSettings
    store: Path | None
    gate: bool
    coacd_seconds: float


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code: 1 where an asset has something wrong.

    That is what can't be read back, and what the gate calls broken unless that is allowed.
    """
    from app.cli import printing

    formats = _readable_formats(args.format)
    assets = find_assets(args.assets)
    settings, store = physics_settings(args), store_folder(args)
    tasks = [
        CheckTask(asset, name, tuple(formats), settings, store, args.gate, args.compare_coacd)
        for asset, name in zip(assets, asset_names(assets), strict=True)
    ]
    rows: dict[int, dict[str, Any]] = {}
    with printing.session(args.json) as show:
        show.progress(0.0, f"checking {len(tasks)} assets")
        for i, answer in run_all(check_one, tasks, args.jobs or os.cpu_count() or 1):
            rows[i] = answer if isinstance(answer, dict) else _failed(tasks[i], answer)
            show.progress(len(rows) / len(tasks), tasks[i].name)
    report = {"assets": [rows[i] for i in range(len(tasks))]}
    report["summary"] = summary(report["assets"])  # type: ignore[assignment]
    show.result(report, lambda: _print(report))
    told = "readable" if args.allow_broken else "fine"
    return 0 if all(row[told] for row in report["assets"]) else 1


def _readable_formats(given: list[str]) -> list[str]:
    """The formats to check; of plug-ins' nothing is known that reads them back.

    Raises:
        ConfigurationError: where one of these is asked for by its name.
    """
    from app.cli.export_command import named_formats
    from model.io.export.registry import BUILT_IN

    formats = named_formats(given or ["all"])
    unread = [f for f in formats if f not in BUILT_IN]
    if unread and {n.strip() for word in given for n in word.split(",")} & set(unread):
        raise ConfigurationError(
            f"nothing here reads the format {unread[0]!r} back; there are {', '.join(BUILT_IN)}"
        )
    return [f for f in formats if f in BUILT_IN]


def _failed(task: CheckTask, error: Exception) -> dict[str, Any]:
    kind = "" if isinstance(error, ArtiworldError) else f"{type(error).__name__}: "
    return {
        "asset": str(task.asset), "name": task.name, "fine": False, "readable": False,
        "error": f"{kind}{error}",
    }  # fmt: skip


def check_one(task: CheckTask) -> dict[str, Any]:
    """Everything about one asset.

    Raises:
        ArtiworldError: where it can't be read.
    """
    from model.core.inertial import inertial_problems
    from model.io.assets.reader import load_object, reading_notes
    from model.physics.simulation_values import physics_of, whose_shapes

    obj = load_object(task.asset)
    start = time.process_time()
    physics = physics_of(obj, task.physics, store=task.store)
    seconds = time.process_time() - start
    whose = whose_shapes(obj, physics)
    row: dict[str, Any] = {
        "asset": str(task.asset),
        "name": task.name,
        "category": obj.category,
        "notes": [*reading_notes(task.asset, obj), *([whose] if whose else ())],
        "links": len(obj.parts),
        "moving_joints": sum(j.moves for j in obj.tree.joints),
        "kilograms": round(sum(i.mass for i in physics.inertials.values()), 4),
        "inertia_problems": inertial_problems(physics.inertials),
        "formats": _formats(obj, physics, task.formats),
        "collision": _collision(obj, physics, seconds, task.coacd_seconds)
        if physics.collision else None,
        "gate": _gate(obj, task) if task.gate else None,
    }  # fmt: skip
    row["readable"] = not row["inertia_problems"] and all(f["fine"] for f in row["formats"])
    row["fine"] = row["readable"] and not (row["gate"] and row["gate"]["verdict"] == "broken")
    return row


def _formats(
    obj: ArticulatedObject, physics: Physics, formats: tuple[str, ...]
) -> list[dict[str, Any]]:
    from model.io.export.registry import load_exporter, write_object
    from model.io.readback.compare import read_back

    out: list[dict[str, Any]] = []
    with TemporaryDirectory(prefix="artiworld-") as folder:
        for name in formats:
            start = time.perf_counter()
            try:
                files = write_object(obj, load_exporter(name), Path(folder, name), physics=physics)
                back = read_back(name, files[0], obj)
                readers, problems, fine = back.readers, back.problems, back.fine
            except ArtiworldError as error:
                readers, problems, fine = (), (str(error),), False
            if not readers and not problems:
                problems = ("none of its readers is installed",)
            out.append({
                "format": name, "fine": fine, "readers": list(readers), "problems": list(problems),
                "seconds": round(time.perf_counter() - start, 3),
            })  # fmt: skip
    return out


def _collision(
    obj: ArticulatedObject, physics: Physics, seconds: float, coacd_seconds: float
) -> dict[str, Any]:
    from model.core.shapes import Primitive
    from model.physics.collision.measure import free_volume, overlaps_of

    held = physics.collision
    shapes = [s for each in held.values() for s in each]
    met = overlaps_of(obj, held)
    free = free_volume(obj, held, coacd_seconds=coacd_seconds)
    row: dict[str, Any] = {
        "shapes": len(shapes),
        "shapes_a_link": round(len(shapes) / max(len(held), 1), 2),
        "most_of_a_link": max((len(each) for each in held.values()), default=0),
        "primitives": sum(isinstance(s, Primitive) for s in shapes),
        "overlap_at_rest_m": round(met.at_rest, 6),
        "from_source": list(physics.told_shapes),
        "links_overlapping_at_rest": [list(pair) for pair in met.links_at_rest],
        "overlap_over_range_m": {name: round(d, 6) for name, d in met.over_range.items()},
        "free_kept": round(free.kept, 4),
        "free_kept_by_one_hull": round(free.kept_by_hull, 4),
        "free_kept_by_coacd": None if free.kept_by_coacd is None else round(free.kept_by_coacd, 4),
        "coacd_hulls": None if free.coacd is None else sum(map(len, free.coacd.values())),
        "coacd_seconds": None if free.coacd_seconds is None else round(free.coacd_seconds, 1),
        "processor_seconds": round(seconds, 3),
    }
    others = {"one_hull": free.hull, "coacd": free.coacd} if coacd_seconds else {}
    for name, its in others.items():
        other = None if its is None else overlaps_of(obj, its)
        row[f"overlap_at_rest_by_{name}_m"] = other and round(other.at_rest, 6)
        row[f"overlap_over_range_by_{name}_m"] = other and {
            joint: round(d, 6) for joint, d in other.over_range.items()
        }
    return row


def _gate(obj: ArticulatedObject, task: CheckTask) -> dict[str, Any]:
    from app.cli.headless import predicted_sure
    from model.validation.low_confidence import with_unsure
    from model.validation.runner import run_gate

    if not task.physics.told_shapes:
        obj = replace(obj, shapes={})
    report = run_gate(obj, store=task.store, mends=False)
    report = with_unsure(report, obj.tree, predicted_sure(task.asset, obj.tree))
    return {**report.to_json(), "seconds": round(report.seconds, 3)}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Means and counts over assets that could be read."""
    read = [r for r in rows if "error" not in r]
    shaped = [r["collision"] for r in read if r["collision"]]
    against = [c for c in shaped if c["free_kept_by_coacd"] is not None]
    names = list(dict.fromkeys(f["format"] for r in read for f in r["formats"]))
    links = sum(r["links"] for r in read if r["collision"])
    ranges = [d for c in shaped for d in c["overlap_over_range_m"].values()]

    def mean(values: list[float]) -> float | None:
        return round(sum(values) / len(values), 4) if values else None

    return {
        "assets": len(rows),
        "unreadable": len(rows) - len(read),
        "readable": sum(r["readable"] for r in rows),
        "fine": sum(r["fine"] for r in rows),
        "fine_by_format": {
            n: sum(f["fine"] for r in read for f in r["formats"] if f["format"] == n) for n in names
        },
        "shapes_a_link": round(sum(c["shapes"] for c in shaped) / links, 2) if links else None,
        "free_kept": mean([c["free_kept"] for c in shaped]),
        "free_kept_by_one_hull": mean([c["free_kept_by_one_hull"] for c in shaped]),
        "compared_with_coacd": len(against),
        "free_kept_there": mean([c["free_kept"] for c in against]),
        "free_kept_by_coacd": mean([c["free_kept_by_coacd"] for c in against]),
        "overlapping_at_rest": sum(c["overlap_at_rest_m"] > 0 for c in shaped),
        "joints": len(ranges),
        "joints_overlapping_over_range": sum(d > 0 for d in ranges),
        "collision_processor_seconds": mean([c["processor_seconds"] for c in shaped]),
        "gate": {v: sum(1 for r in read if r["gate"] and r["gate"]["verdict"] == v)
                 for v in ("fine", "look", "broken")},
    }  # fmt: skip


def _print(report: dict[str, Any]) -> None:
    from rich.table import Table
    from rich.text import Text

    from app.cli.printing import console

    table = Table()
    for column in ("asset", "read back", "shapes", "free kept", "one hull", "rest mm", "range mm",
                   "gate", "wrong"):  # fmt: skip
        table.add_column(column, overflow="fold")
    for row in report["assets"]:
        if "error" in row:
            table.add_row(row["name"], "", "", "", "", "", "", "", Text(row["error"], "bold red"))
            continue
        made = row["collision"] or {}
        wrong = row["inertia_problems"] + [p for f in row["formats"] for p in f["problems"]]
        wrong += _joints_said_to_be(row["gate"], "broken")
        shown = ["", "", "", "", ""]
        if made:
            ranges = made["overlap_over_range_m"].values()
            shown = [
                str(made["shapes"]), f"{100 * made['free_kept']:.1f} %",
                f"{100 * made['free_kept_by_one_hull']:.1f} %",
                f"{1000 * made['overlap_at_rest_m']:.1f}", f"{1000 * max(ranges, default=0):.1f}",
            ]  # fmt: skip
        fine = sum(f["fine"] for f in row["formats"])
        gate = row["gate"]["verdict"] if row["gate"] else ""
        table.add_row(
            row["name"], f"{fine} of {len(row['formats'])}", *shown, gate,
            Text("\n".join(wrong), "bold red"),
        )  # fmt: skip
    target = console()
    target.print(table)
    for row in report["assets"]:
        for note in row.get("notes", ()):
            target.print(f"note: {row['name']}: {note}", style="yellow", markup=False)
        doubts = _joints_said_to_be(row.get("gate"), "look")
        for doubt in doubts[:DOUBTS_TOLD]:
            target.print(f"look: {row['name']}: {doubt}", style="yellow", markup=False)
        if len(doubts) > DOUBTS_TOLD:
            more = len(doubts) - DOUBTS_TOLD
            target.print(f"look: {row['name']}: {more} more, with --json", style="yellow")
    target.print(_closing_line(report["summary"]))


def _joints_said_to_be(gate: dict[str, Any] | None, verdict: str) -> list[str]:
    """The joints of which the gate says so, and why of each."""
    joints = gate["joints"] if gate else []
    return [f"{j['joint']}: {j['sentence']}" for j in joints if j["verdict"] == verdict]


def _closing_line(summary: dict[str, Any]) -> str:
    line = f"{summary['readable']} of {summary['assets']} can be read back"
    gate = summary["gate"]
    if not any(gate.values()):
        return line
    return (
        f"{line}; the gate: {gate['fine']} fine, {gate['look']} to look at, {gate['broken']} broken"
    )
