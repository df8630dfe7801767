"""``artiworld scene``: from a description to an articulated scene."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from app.cli import output
from app.cli.commands import SceneConvertCommand, SceneInspectCommand
from app.cli.output import Result, check_output
from app.server.prompt_file import beside, read_prompts
from model.core.errors import ConfigurationError
from model.core.progress import Progress
from model.prediction.registry import check_predictor
from model.scenes.articulable_finders import FinderOptions, default_cache, load_finder
from model.scenes.asset_parts import AssetIndex, ObjectClicks, index_assets
from model.scenes.convert import ConvertSettings, convert_scene, decide, descriptions
from model.scenes.language_finder import LanguageFinder, Usage
from model.scenes.registry import read_scene
from model.scenes.results import sim_id
from model.scenes.scene import ArticulableFinder, Scene
from model.scenes.unpacking import holds_geometry, unpack
from model.segmentation.registry import check_segmenter


def convert(options: SceneConvertCommand, progress: Progress) -> Result:
    """Articulate every object that can be, or estimate the cost of asking about them."""
    if options.dry_run:
        return estimate(options, progress)
    check_output(options.out, options.scene.parent, *options.assets)
    check_predictor(options.predictor)
    check_segmenter(options.segmenter)
    finder = _finder(options, progress)
    progress(0.0, f"reading {options.scene.name}")
    scene = read_scene(options.scene, options.format)
    settings = ConvertSettings(
        options.jobs,
        options.predictor,
        options.seed,
        options.keep_limits,
        options.collision,
        options.time_limit,
        tuple(options.formats),
        _object_clicks(options),
        partial(_clicks_beside, options.segmenter),
        options.ray,
    )
    assets = _assets(scene, options.assets)
    summary = convert_scene(scene, assets, options.out, finder, settings, progress)
    summary |= _usage(options, finder)
    return Result(summary, lambda: _print_summary(summary, options.out))


def inspect(options: SceneInspectCommand, progress: Progress) -> Result:
    """The objects of a scene, and which of them can be articulated; or the cost of asking."""
    if options.dry_run:
        return estimate(options, progress)
    finder = _finder(options, progress)
    scene = read_scene(options.scene, options.format)
    with TemporaryDirectory() as folder:
        inside = unpack(scene, Path(folder))
        outcomes = decide(scene, _assets(scene, options.assets), finder, inside)
    embedded = set(inside.files.values())
    objects = [
        {
            "id": o.obj.id,
            "description": o.obj.description,
            "category": o.obj.category,
            "room": o.obj.room,
            "asset": o.obj.asset,
            "file": o.path and str(options.scene if o.path in embedded else o.path),
            "position": o.obj.world_from_object[:3, 3].tolist(),
            **asdict(o.decision),
        }
        for o in outcomes
    ]
    report = {
        "scene": scene.name,
        "reader": scene.reader,
        "objects": objects,
        "finder": finder.name,
        "sim_id": dict(sim_id(outcomes)),
        "missing_assets": sorted({o["asset"] for o in objects if o["asset"] and o["file"] is None}),
        "problems": [asdict(p) for p in scene.problems],
    } | _usage(options, finder)
    return Result(report, lambda: _print_inspection(report))


def estimate(options: SceneInspectCommand, progress: Progress) -> Result:
    """The estimated cost of a language model's finder, without calling it."""
    finder = _finder(options, progress)
    scene = read_scene(options.scene, options.format)
    usage = Usage()
    if isinstance(finder, LanguageFinder):
        usage = finder.estimate(descriptions(scene))
    report = {
        "scene": scene.name,
        "objects": len(scene.objects),
        "finder": finder.name,
        "estimate": {**asdict(usage), "cost": _cost(options, usage)},
    }
    return Result(report, lambda: _print_estimate(report))


def _assets(scene: Scene, folders: tuple[Path, ...]) -> AssetIndex:
    """The assets in the folders given, else those beside the scene, as for ``serve``."""
    return index_assets(folders or (() if holds_geometry(scene) else (scene.path.parent,)))


def _clicks_beside(segmenter: str, asset: Path) -> ObjectClicks | None:
    """The clicks in a prompt file beside an asset."""
    path = beside(asset)
    if path is None:
        return None
    file = read_prompts(path)
    return ObjectClicks(file.prompts, file.names, file.category, segmenter, in_scene=False)


def _object_clicks(options: SceneConvertCommand) -> dict[str, ObjectClicks]:
    """Object → its clicks."""
    out: dict[str, ObjectClicks] = {}
    for id, path in options.clicks:
        if id in out:
            raise ConfigurationError(f"--clicks names {id!r} twice; put all clicks into one file")
        file = read_prompts(path)
        out[id] = ObjectClicks(file.prompts, file.names, file.category, options.segmenter)
    return out


def _finder(options: SceneInspectCommand, progress: Progress) -> ArticulableFinder:
    settings = FinderOptions(
        options.finder_url,
        options.finder_batch,
        options.finder_timeout,
        cache=options.finder_cache or default_cache(),
        asks=not options.dry_run,
    )
    return load_finder(options.finder, settings, progress)


def _usage(options: SceneInspectCommand, finder: ArticulableFinder) -> dict[str, Any]:
    """Requests and tokens of a language model, and their cost; empty for other finders."""
    usage: Usage | None = getattr(finder, "usage", None)
    if usage is None:
        return {}
    return {"finder_usage": {**asdict(usage), "cost": _cost(options, usage)}}


def _cost(options: SceneInspectCommand, usage: Usage) -> float | None:
    return None if options.price is None else round(usage.price(*options.price), 6)


def _print_estimate(report: dict[str, Any]) -> None:
    usage = report["estimate"]
    cost = "" if usage["cost"] is None else f", about {usage['cost']:.4f} in the prices' currency"
    print(
        f"{report['scene']}: {report['objects']} objects; {report['finder']} would be asked "
        f"{usage['requests']} times about {usage['asked']} of them ({usage['cached']} were "
        f"answered before): about {usage['input_tokens']} tokens in and "
        f"{usage['output_tokens']} out{cost}"
    )


def _print_inspection(report: dict[str, Any]) -> None:
    rows = [
        {
            "object": o["id"],
            "articulable": "yes" if o["articulable"] else "no",
            "parts": ", ".join(o["parts"]),
            "reason": o["reason"],
            "asset found": "yes" if o["file"] else "no",
        }
        for o in report["objects"]
    ]
    output.print_records(f"{report['scene']} ({report['reader']})", rows)
    _print_problems(report)
    _print_figures(report["sim_id"])


def _print_summary(summary: dict[str, Any], out: Path) -> None:
    columns = ("kind", "state", "joints", "shortened", "reason")
    rows = [
        {"object": o["id"], **{c: str(o[c] or "") for c in columns}} for o in summary["results"]
    ]
    counts = f"{summary['objects']} objects, {summary['articulable']} articulable"
    output.print_records(f"{summary['scene']}: {counts}", rows)
    output.print_notes(f"{o['id']}: {note}" for o in summary["results"] for note in o["notes"])
    _print_problems(summary)
    _print_figures(summary["sim_id"], summary["sim_us"])
    output.console().print(f"written to {out}")


def _print_figures(found: dict[str, Any], works: dict[str, Any] | None = None) -> None:
    if not found["articulable"]:
        return
    text = f"Sim-Id {found['found']}/{found['articulable']}"
    text += f", wrongly found {found['wrongly_found']}"
    if works is not None:
        text += f"; Sim-Us {works['usable']}/{works['articulable']}"
    output.console().print(text)


def _print_problems(report: dict[str, Any]) -> None:
    notes = [
        f"{p['object']}: {'left out: ' if p['skipped'] else ''}{p['reason']}"
        for p in report["problems"]
    ]
    if report["missing_assets"]:
        notes.append(f"missing assets: {', '.join(report['missing_assets'])}")
    output.print_notes(notes)
