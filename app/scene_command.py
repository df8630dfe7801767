"""``artiworld scene``: whole scenes, from a description to an articulated scene."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from model.predictors import DEFAULT

def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    kinds = parser.add_subparsers(dest="scene_command", metavar="convert|inspect", required=True)
    convert = kinds.add_parser("convert", help="articulate every object that can be, in place")
    inspect = kinds.add_parser("inspect", help="say what is in a scene and what can be articulated")
    for command in (convert, inspect):
        add = command.add_argument
        add("scene", type=Path, metavar="SCENE", help="a scene description")
        add("--assets", type=Path, action="append", default=[], metavar="DIR",
            help="folder of the scene's 3D assets; may be repeated")  # fmt: skip
        add("--format", metavar="NAME", help="of the scene (default: told by the file)")
        add("--json", action="store_true", help="print JSON and nothing else")
    add = convert.add_argument
    add("--out", type=Path, required=True, metavar="DIR",
        help="folder for the articulated scene; a run that was killed goes on there")  # fmt: skip
    add("--jobs", type=_jobs, default=os.cpu_count() or 1, metavar="N",
        help="processes (default: as many as processors)")  # fmt: skip
    add("--predictor", default=DEFAULT, metavar="NAME", help="who predicts joints")
    add("--seed", type=int, default=0, help="the only source of randomness (default: 0)")
    add("--keep-limits", action="store_true",
        help="leave joint limits as predicted where the motion hits neighbours")  # fmt: skip
    add("--collision", action="store_true",
        help="make collision shapes; without them every base is fixed in MJCF")  # fmt: skip
    add("--time-limit", type=float, default=1800.0, metavar="SECONDS",
        help="for one asset (default: 1800)")  # fmt: skip


def _jobs(text: str) -> int:
    value = int(text)
    if value < 1:
        raise ValueError
    return value


_jobs.__name__ = "number of processes"


def run_scene(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from app import printing

    if args.scene_command == "inspect":
        with printing.session(args.json) as show:
            report = _inspect(args)
        show.result(report, lambda: _print_inspection(report))
        return 0
    with printing.session(args.json) as show:
        summary = _convert(args, show)
    show.result(summary, lambda: _print_summary(summary, args.out))
    return 0


def _convert(args: argparse.Namespace, show: Any) -> dict[str, Any]:
    from app.headless import check_output
    from model.errors import ConfigurationError
    from model.predictors import check_predictor
    from model.scenes.assets import index_assets
    from model.scenes.convert import ConvertSettings, convert_scene
    from model.scenes.finders import LexiconFinder
    from model.scenes.registry import read_scene

    check_output(args.out, args.scene.parent, *args.assets)
    check_predictor(args.predictor)
    if not args.time_limit > 0:
        raise ConfigurationError(f"--time-limit {args.time_limit} must be above 0 seconds")
    show.progress(0.0, f"reading {args.scene.name}")
    scene = read_scene(args.scene, args.format)
    settings = ConvertSettings(
        args.jobs, args.predictor, args.seed, args.keep_limits, args.collision, args.time_limit
    )
    return convert_scene(
        scene, index_assets(args.assets), args.out, LexiconFinder(), settings, show.progress
    )


def _inspect(args: argparse.Namespace) -> dict[str, Any]:
    from dataclasses import asdict

    from model.scenes.assets import index_assets
    from model.scenes.finders import LexiconFinder
    from model.scenes.protocol import ObjectDescription
    from model.scenes.registry import read_scene

    scene = read_scene(args.scene, args.format)
    assets = index_assets(args.assets)
    asked = [ObjectDescription(o.description, o.category, o.fit or o.box) for o in scene.objects]
    decisions = LexiconFinder().find(asked)
    objects = []
    for o, decision in zip(scene.objects, decisions, strict=True):
        found = None if o.asset is None else assets.find(o.asset)
        objects.append({
            "id": o.id, "description": o.description, "category": o.category, "room": o.room,
            "asset": o.asset, "file": None if found is None else str(found),
            "position": o.world_from_object[:3, 3].tolist(), **asdict(decision),
        })  # fmt: skip
    return {
        "scene": scene.name, "reader": scene.reader, "objects": objects,
        "missing_assets": sorted(
            {o["asset"] for o in objects if o["asset"] and o["file"] is None}
        ),
        "problems": [asdict(p) for p in scene.problems],
    }  # fmt: skip


def _print_inspection(report: dict[str, Any]) -> None:
    from rich.table import Table
    from rich.text import Text

    from app import printing

    table = Table(title=Text(f"{report['scene']} ({report['reader']})"))
    for column in ("object", "articulable", "parts", "why", "asset found"):
        table.add_column(column)
    for o in report["objects"]:
        table.add_row(
            Text(o["id"]), "yes" if o["articulable"] else "no", ", ".join(o["parts"]),
            Text(o["reason"]), "yes" if o["file"] else "no",
        )  # fmt: skip
    printing.console().print(table)
    _print_problems(report)


def _print_summary(summary: dict[str, Any], out: Path) -> None:
    from rich.table import Table
    from rich.text import Text

    from app import printing

    title = (
        f"{summary['scene']}: {summary['objects']} objects, {summary['articulable']} articulable"
    )
    table = Table(title=Text(title))
    for column in ("object", "kind", "state", "joints", "shortened", "reason"):
        table.add_column(column)
    for o in summary["results"]:
        table.add_row(
            Text(o["id"]), o["kind"] or "", o["state"], str(o["joints"] or ""),
            str(o["shortened"] or ""), Text(o["reason"] or ""),
        )  # fmt: skip
    printing.console().print(table)
    _print_problems(summary)
    found = summary["sim_id"]
    if found["articulable"]:
        text = f"Sim-Id {found['found']}/{found['articulable']}"
        printing.console().print(Text(f"{text}, wrongly found {found['wrongly_found']}"))
    printing.console().print(Text(f"written to {out}"))


def _print_problems(report: dict[str, Any]) -> None:
    from rich.text import Text

    from app import printing

    for problem in report["problems"]:
        left = "left out: " if problem["skipped"] else ""
        printing.console().print(
            Text(f"note: {problem['object']}: {left}{problem['reason']}", "yellow")
        )
    if report["missing_assets"]:
        missing = ", ".join(report["missing_assets"])
        printing.console().print(Text(f"note: assets that are missing: {missing}", "yellow"))
