"""``artiworld check``: whether assets work in a simulator, with figures."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from app.cli import output
from app.cli.commands import CheckCommand
from app.cli.export import (
    asset_names,
    error_text,
    find_assets,
    named_formats,
    physics_settings,
    run_all,
    shape_store,
)
from app.cli.output import Result
from app.cli.predict import predicted_confidence
from model.core.articulated_object import ArticulatedObject, inertial_problems
from model.core.errors import ConfigurationError
from model.core.progress import Progress
from model.core.shapes import Primitive
from model.io.assets.reader import load_object, reading_notes
from model.io.export.registry import EXPORTERS
from model.io.readback import write_and_read
from model.physics.collision.measure import free_volume, overlaps_of
from model.physics.simulation_values import Physics, PhysicsSettings, physics_of, whose_shapes
from model.validation.engines import ENGINES, MUJOCO, require_engines
from model.validation.examine import with_low_confidence
from model.validation.runner import validate

MOST_WARNINGS = 3
"""Warnings of one asset below the table; ``--json`` has all."""
VERDICTS = {"fine": "fine", "look": "warning", "broken": "error"}
"""Verdict as stored → as printed."""


@dataclass(frozen=True)
class CheckTask:
    """One asset to check; picklable.

    Attributes:
        store: folder of cached collision shapes.
        validate: whether the joints are validated.
        coacd_seconds: time for the comparison with coacd; 0 for none.
        engines: that drive the joints.
    """

    asset: Path
    name: str
    formats: tuple[str, ...]
    physics: PhysicsSettings
    store: Path | None
    validate: bool
    coacd_seconds: float
    engines: tuple[str, ...] = (MUJOCO,)


def check(options: CheckCommand, progress: Progress) -> Result:
    """Check all assets; the exit code is 1 where one has an error.

    Errors are what can't be read back, and broken joints unless these are allowed.
    """
    formats = tuple(_readable_formats(options.format))
    assets = find_assets(options.assets)
    physics, store = physics_settings(options.physics), shape_store(options.physics)
    # MuJoCo alone is the default, and may be missing: the report says so then.
    engines = (MUJOCO,) if options.engine == MUJOCO else require_engines(options.engine)
    tasks = [
        CheckTask(
            asset, name, formats, physics, store, options.gate, options.compare_coacd, engines
        )
        for asset, name in zip(assets, asset_names(assets), strict=True)
    ]
    rows: dict[int, dict[str, Any]] = {}
    progress(0.0, f"checking {len(tasks)} assets")
    for i, answer in run_all(check_one, tasks, options.jobs):
        rows[i] = answer if isinstance(answer, dict) else _failed(tasks[i], answer)
        progress(len(rows) / len(tasks), tasks[i].name)
    found = [rows[i] for i in range(len(tasks))]
    report = {"assets": found, "summary": summary(found)}
    key = "readable" if options.allow_broken else "fine"
    return Result(report, lambda: _print(report), int(not all(row[key] for row in found)))


def _readable_formats(given: tuple[str, ...]) -> list[str]:
    """The formats to check: built-in ones, as nothing here reads a plug-in's.

    Raises:
        ConfigurationError: where a plug-in's is asked for by name.
    """
    formats = named_formats(given or ["all"])
    unread = {f for f in formats if f not in EXPORTERS.built_in}
    for name in (n.strip() for word in given for n in word.split(",")):
        if name in unread:
            raise ConfigurationError(
                f"nothing here reads the format {name!r} back; "
                f"there are {', '.join(EXPORTERS.built_in)}"
            )
    return [f for f in formats if f in EXPORTERS.built_in]


def _failed(task: CheckTask, error: Exception) -> dict[str, Any]:
    return {
        "asset": str(task.asset),
        "name": task.name,
        "fine": False,
        "readable": False,
        "error": error_text(error),
    }


def check_one(task: CheckTask) -> dict[str, Any]:
    """All findings on one asset.

    Raises:
        ArtiworldError: where it can't be read.
    """
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
        "formats": [_format(obj, physics, name) for name in task.formats],
        "collision": _collision(obj, physics, seconds, task.coacd_seconds)
        if physics.collision
        else None,
        "gate": _validation(obj, task) if task.validate else None,
    }
    row["readable"] = not row["inertia_problems"] and all(f["fine"] for f in row["formats"])
    row["fine"] = row["readable"] and not (row["gate"] and row["gate"]["verdict"] == "broken")
    return row


def _format(obj: ArticulatedObject, physics: Physics, name: str) -> dict[str, Any]:
    """Write the object in a format and read it back."""
    start = time.perf_counter()
    back = write_and_read(obj, physics, name)
    return {
        "format": name,
        "fine": back.fine,
        "readers": list(back.readers),
        "problems": list(back.problems),
        "seconds": round(time.perf_counter() - start, 3),
    }


def _collision(
    obj: ArticulatedObject, physics: Physics, seconds: float, coacd_seconds: float
) -> dict[str, Any]:
    shapes = [s for each in physics.collision.values() for s in each]
    links = len(physics.collision)
    overlaps = overlaps_of(obj, physics.collision)
    free = free_volume(obj, physics.collision, coacd_seconds=coacd_seconds)
    row: dict[str, Any] = {
        "shapes": len(shapes),
        "shapes_a_link": round(len(shapes) / max(links, 1), 2),
        "most_of_a_link": max((len(each) for each in physics.collision.values()), default=0),
        "primitives": sum(isinstance(s, Primitive) for s in shapes),
        "overlap_at_rest_m": round(overlaps.at_rest, 6),
        "from_source": list(physics.declared_shapes),
        "links_overlapping_at_rest": [list(pair) for pair in overlaps.links_at_rest],
        "overlap_over_range_m": {name: round(d, 6) for name, d in overlaps.over_range.items()},
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


def _validation(obj: ArticulatedObject, task: CheckTask) -> dict[str, Any]:
    """Validate the joints, also against the confidence of their prediction."""
    if not task.physics.declared_shapes:
        obj = replace(obj, shapes={})
    report = validate(obj, store=task.store, fixes=False, engines=task.engines)
    report = with_low_confidence(report, obj.tree, predicted_confidence(task.asset, obj.tree))
    runs = [run for run in (report.physics, *report.others) if run is not None]
    works = dict(zip(task.engines, map(report.executable_in, runs), strict=False))
    return {**report.to_json(), "engines": works, "seconds": round(report.seconds, 3)}


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
        "gate": {
            v: sum(1 for r in read if r["gate"] and r["gate"]["verdict"] == v) for v in VERDICTS
        },
        "engines": _engines([r["gate"]["engines"] for r in read if r["gate"]]),
    }


def _engines(found: list[dict[str, bool]]) -> dict[str, int]:
    """Engine → number of assets that are executable there."""
    names = dict.fromkeys(name for each in found for name in each)
    return {name: sum(each.get(name, False) for each in found) for name in names}


def _print(report: dict[str, Any]) -> None:
    output.print_records(None, map(_cells, report["assets"]))
    for row in report["assets"]:
        output.print_notes(f"{row['name']}: {note}" for note in row.get("notes", ()))
        warnings = _joints_with(row.get("gate"), "look")
        lines = warnings[:MOST_WARNINGS]
        if len(warnings) > MOST_WARNINGS:
            lines.append(f"{len(warnings) - MOST_WARNINGS} more, with --json")
        output.print_notes((f"{row['name']}: {line}" for line in lines), "warning")
    output.console().print(_closing_line(report["summary"]))


def _cells(row: dict[str, Any]) -> dict[str, Any]:
    """An asset's row of the table."""
    read = verdict = ""
    figures: dict[str, str] = dict.fromkeys(
        ("shapes", "free kept", "one hull", "rest mm", "range mm"), ""
    )
    errors: list[str] = [row["error"]] if "error" in row else []
    if "error" not in row:
        errors = row["inertia_problems"] + [p for f in row["formats"] for p in f["problems"]]
        errors += _joints_with(row["gate"], "broken")
        read = f"{sum(f['fine'] for f in row['formats'])} of {len(row['formats'])}"
        verdict = VERDICTS[row["gate"]["verdict"]] if row["gate"] else ""
        if collision := row["collision"]:
            over_range = max(collision["overlap_over_range_m"].values(), default=0)
            figures = {
                "shapes": str(collision["shapes"]),
                "free kept": f"{100 * collision['free_kept']:.1f} %",
                "one hull": f"{100 * collision['free_kept_by_one_hull']:.1f} %",
                "rest mm": f"{1000 * collision['overlap_at_rest_m']:.1f}",
                "range mm": f"{1000 * over_range:.1f}",
            }
    found = {"validation": verdict, "errors": output.wrong(errors)}
    return {"asset": row["name"], "read back": read, **figures, **found}


def _joints_with(report: dict[str, Any] | None, verdict: str) -> list[str]:
    """Joint and reason, for each joint with that verdict."""
    joints = report["joints"] if report else []
    return [f"{j['joint']}: {j['sentence']}" for j in joints if j["verdict"] == verdict]


def _closing_line(summary: dict[str, Any]) -> str:
    line = f"{summary['readable']} of {summary['assets']} can be read back"
    counts: dict[str, int] = summary["gate"]
    if not any(counts.values()):
        return line
    line += (
        f"; validation: {counts['fine']} fine, {counts['look']} with warnings, "
        f"{counts['broken']} with errors"
    )
    if len(summary["engines"]) > 1:
        each = (f"{n} in {ENGINES[name].title}" for name, n in summary["engines"].items())
        line += f"; executable: {', '.join(each)}"
    return line
