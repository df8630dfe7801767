"""``artiworld scene``: whole scenes, from a description to an articulated scene."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli.options import add_json, count
from model.prediction.registry import DEFAULT

if TYPE_CHECKING:
    from model.scenes.assets import AssetIndex
    from model.scenes.clicked import ObjectClicks
    from model.scenes.scene import Scene


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    kinds = parser.add_subparsers(dest="scene_command", metavar="convert|inspect", required=True)
    convert = kinds.add_parser("convert", help="articulate every object that can be, in place")
    inspect = kinds.add_parser("inspect", help="say what is in a scene and what can be articulated")
    for command in (convert, inspect):
        add = command.add_argument
        add(
            "scene",
            type=Path,
            metavar="SCENE",
            help="a scene: a description, or GLB, USD or PLY with its geometry",
        )
        add("--assets", type=Path, action="append", default=[], metavar="DIR",
            help="folder of the scene's 3D assets; may be repeated (default: the scene's "
                 "folder)")  # fmt: skip
        add("--format", metavar="NAME", help="of the scene (default: told by the file)")
        add_json(command)
        _add_finder(command)
    add = convert.add_argument
    add("--out", type=Path, required=True, metavar="DIR",
        help="folder for the articulated scene; a run that was killed goes on there")  # fmt: skip
    add("--jobs", type=_jobs, default=os.cpu_count() or 1, metavar="N",
        help="processes (default: as many as processors)")  # fmt: skip
    add("--predictor", default=DEFAULT, metavar="NAME", help="who predicts joints")
    add("--seed", type=count, default=0, help="the only source of randomness (default: 0)")
    add("--formats", type=_formats, default=(), metavar="NAME,NAME",
        help="write the scene as sdf and usd too, besides MJCF")  # fmt: skip
    add("--clicks", type=_clicks, action="append", default=[], metavar="ID=FILE",
        help="cut the object ID into parts by the clicks in FILE (as segment's --prompts, but in "
             "the scene's metres, +z up) and articulate it; may be repeated")  # fmt: skip
    add("--segmenter", default="default", metavar="NAME", help="who answers the clicks")
    add("--ray", metavar="ADDRESS",
        help="let a Ray cluster do the work (host:port, auto, or local)")  # fmt: skip
    add("--keep-limits", action="store_true",
        help="leave joint limits as predicted where the motion hits neighbours")  # fmt: skip
    add("--collision", action="store_true",
        help="make collision shapes; without them every base is fixed in MJCF")  # fmt: skip
    add("--time-limit", type=float, default=1800.0, metavar="SECONDS",
        help="for one asset (default: 1800)")  # fmt: skip


def _add_finder(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--finder", default="lexicon", metavar="NAME",
        help="who says what can be articulated: lexicon, openai:MODEL (any server that speaks "
             "OpenAI's protocol; key in OPENAI_API_KEY) or qwen3:FOLDER (default: lexicon)",
    )  # fmt: skip
    add("--finder-url", metavar="URL",
        help="openai: address of the server, such as http://localhost:11434/v1")  # fmt: skip
    add("--finder-batch", type=_jobs, default=20, metavar="N",
        help="openai: objects a question (default: 20)")  # fmt: skip
    add("--finder-timeout", type=float, default=120.0, metavar="SECONDS",
        help="openai: for one answer (default: 120)")  # fmt: skip
    add("--finder-cache", type=Path, metavar="DIR",
        help="where answers are kept (default: ~/.cache/artiworld/finder)")  # fmt: skip
    add("--price", type=_prices, metavar="IN,OUT", help="of a million tokens, for the cost")
    add("--dry-run", action="store_true", help="say what asking would cost, and do nothing")


def _formats(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    if not set(names) <= {"mjcf", "sdf", "usd"}:
        raise ValueError
    return tuple(n for n in names if n != "mjcf")


_formats.__name__ = "list of sdf and usd"


def _clicks(text: str) -> tuple[str, Path]:
    id, equals, file = text.rpartition("=")
    if not (equals and id and file):
        raise ValueError
    return id, Path(file)


_clicks.__name__ = "ID=FILE"


def _prices(text: str) -> tuple[float, float]:
    into, out = (float(word) for word in text.split(","))
    if not (0 <= into < float("inf") and 0 <= out < float("inf")):
        raise ValueError
    return into, out


_prices.__name__ = "pair of prices"


def _jobs(text: str) -> int:
    value = int(text)
    if value < 1:
        raise ValueError
    return value


_jobs.__name__ = "number from 1"


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from app.cli import printing

    if args.dry_run:
        with printing.session(args.json) as show:
            report = _dry_run(args, show)
        show.result(report, lambda: _print_dry_run(report))
        return 0
    if args.scene_command == "inspect":
        with printing.session(args.json) as show:
            report = _inspect(args, show)
        show.result(report, lambda: _print_inspection(report))
        return 0
    with printing.session(args.json) as show:
        summary = _convert(args, show)
    show.result(summary, lambda: _print_summary(summary, args.out))
    return 0


def _convert(args: argparse.Namespace, show: Any) -> dict[str, Any]:
    from app.cli.headless import check_output
    from model.core.errors import ConfigurationError
    from model.prediction.registry import check_predictor
    from model.scenes.convert import ConvertSettings, convert_scene
    from model.scenes.registry import read_scene
    from model.segmentation.registry import check_segmenter

    check_output(args.out, args.scene.parent, *args.assets)
    check_predictor(args.predictor)
    check_segmenter(args.segmenter)
    if not args.time_limit > 0:
        raise ConfigurationError(f"--time-limit {args.time_limit} must be above 0 seconds")
    finder = _finder(args, show)
    show.progress(0.0, f"reading {args.scene.name}")
    scene = read_scene(args.scene, args.format)
    settings = ConvertSettings(
        args.jobs, args.predictor, args.seed, args.keep_limits, args.collision, args.time_limit,
        args.formats, _clicked(args), partial(_kept, args.segmenter), args.ray,
    )  # fmt: skip
    summary = convert_scene(
        scene, _assets(scene, args.assets), args.out, finder, settings, show.progress
    )
    return summary | _usage(args, finder)


def _assets(scene: Scene, folders: Sequence[Path]) -> AssetIndex:
    """The assets in the folders that were named, else in the scene's own, as ``serve`` does."""
    from model.scenes.assets import index_assets
    from model.scenes.embedded import holds_geometry

    return index_assets(folders or (() if holds_geometry(scene) else (scene.path.parent,)))


def _kept(segmenter: str, asset: Path) -> ObjectClicks | None:
    """The clicks that are kept beside an asset."""
    from app.server.prompt_file import beside, read_prompts
    from model.scenes.clicked import ObjectClicks

    kept = beside(asset)
    if kept is None:
        return None
    file = read_prompts(kept)
    return ObjectClicks(file.prompts, file.names, file.category, segmenter, in_scene=False)


def _clicked(args: argparse.Namespace) -> dict[str, Any]:
    """Object → its clicks."""
    if not args.clicks:
        return {}
    from app.server.prompt_file import read_prompts
    from model.core.errors import ConfigurationError
    from model.scenes.clicked import ObjectClicks

    out: dict[str, Any] = {}
    for id, path in args.clicks:
        if id in out:
            raise ConfigurationError(f"--clicks names {id!r} twice; put all clicks into one file")
        file = read_prompts(path)
        out[id] = ObjectClicks(file.prompts, file.names, file.category, args.segmenter)
    return out


def _finder(args: argparse.Namespace, show: Any) -> Any:
    from model.scenes.finder_registry import FinderOptions, default_cache, load_finder

    options = FinderOptions(
        args.finder_url, args.finder_batch, args.finder_timeout,
        cache=args.finder_cache or default_cache(), asks=not args.dry_run,
    )  # fmt: skip
    return load_finder(args.finder, options, show.progress)


def _usage(args: argparse.Namespace, finder: Any) -> dict[str, Any]:
    """What the language model was asked, and its price; nothing for the lexicon."""
    from dataclasses import asdict

    usage = getattr(finder, "usage", None)
    if usage is None:
        return {}
    cost = None if args.price is None else round(usage.price(*args.price), 6)
    return {"finder_usage": {**asdict(usage), "cost": cost}}


def _dry_run(args: argparse.Namespace, show: Any) -> dict[str, Any]:
    """What asking would take; nothing is asked and nothing written."""
    from dataclasses import asdict

    from model.scenes.convert import descriptions
    from model.scenes.language_finder import LanguageFinder, Usage
    from model.scenes.registry import read_scene

    finder = _finder(args, show)
    scene = read_scene(args.scene, args.format)
    usage = Usage()
    if isinstance(finder, LanguageFinder):
        usage = finder.estimate(descriptions(scene))
    cost = None if args.price is None else round(usage.price(*args.price), 6)
    return {"scene": scene.name, "objects": len(scene.objects), "finder": finder.name,
            "estimate": {**asdict(usage), "cost": cost}}  # fmt: skip


def _print_dry_run(report: dict[str, Any]) -> None:
    told = report["estimate"]
    cost = "" if told["cost"] is None else f", about {told['cost']:.4f} in the prices' currency"
    print(
        f"{report['scene']}: {report['objects']} objects; {report['finder']} would be asked "
        f"{told['requests']} times about {told['asked']} of them ({told['cached']} were answered "
        f"before): about {told['input_tokens']} tokens in and {told['output_tokens']} out{cost}"
    )


def _inspect(args: argparse.Namespace, show: Any) -> dict[str, Any]:
    from dataclasses import asdict
    from tempfile import TemporaryDirectory

    from model.scenes.convert import decide
    from model.scenes.embedded import unpack
    from model.scenes.registry import read_scene
    from model.scenes.results import sim_id

    finder = _finder(args, show)
    scene = read_scene(args.scene, args.format)
    with TemporaryDirectory() as folder:
        inside = unpack(scene, Path(folder))
        outcomes = decide(scene, _assets(scene, args.assets), finder, inside)
    held = set(inside.files.values())
    objects = [
        {"id": o.obj.id, "description": o.obj.description, "category": o.obj.category,
         "room": o.obj.room, "asset": o.obj.asset,
         "file": None if o.path is None else str(args.scene if o.path in held else o.path),
         "position": o.obj.world_from_object[:3, 3].tolist(), **asdict(o.decision)}
        for o in outcomes
    ]  # fmt: skip
    return {
        "scene": scene.name, "reader": scene.reader, "objects": objects, "finder": finder.name,
        "sim_id": dict(sim_id(outcomes)),
        "missing_assets": sorted(
            {o["asset"] for o in objects if o["asset"] and o["file"] is None}
        ),
        "problems": [asdict(p) for p in scene.problems],
    } | _usage(args, finder)  # fmt: skip


def _print_inspection(report: dict[str, Any]) -> None:
    from rich.table import Table
    from rich.text import Text

    from app.cli import printing

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
    _print_figures(report["sim_id"])


def _print_figures(found: dict[str, Any], works: dict[str, Any] | None = None) -> None:
    from rich.text import Text

    from app.cli import printing

    if not found["articulable"]:
        return
    text = f"Sim-Id {found['found']}/{found['articulable']}"
    text += f", wrongly found {found['wrongly_found']}"
    if works is not None:
        text += f"; Sim-Us {works['usable']}/{works['articulable']}"
    printing.console().print(Text(text))


def _print_summary(summary: dict[str, Any], out: Path) -> None:
    from rich.table import Table
    from rich.text import Text

    from app.cli import printing

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
    for o in summary["results"]:
        for note in o["notes"]:
            printing.console().print(Text(f"note: {o['id']}: {note}", "yellow"))
    _print_problems(summary)
    _print_figures(summary["sim_id"], summary["sim_us"])
    printing.console().print(Text(f"written to {out}"))


def _print_problems(report: dict[str, Any]) -> None:
    from rich.text import Text

    from app.cli import printing

    for problem in report["problems"]:
        left = "left out: " if problem["skipped"] else ""
        printing.console().print(
            Text(f"note: {problem['object']}: {left}{problem['reason']}", "yellow")
        )
    if report["missing_assets"]:
        missing = ", ".join(report["missing_assets"])
        printing.console().print(Text(f"note: assets that are missing: {missing}", "yellow"))
