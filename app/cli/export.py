"""``artiworld export``: articulated objects in the formats of simulators.

With what ``check`` shares: one function over many assets in worker processes, where no failure or
crash ends the batch, and the settings of physics.
"""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast, get_args

from app.cli import output
from app.cli.commands import ExportCommand
from app.cli.options import PhysicsOptions
from app.cli.output import Result, check_output
from app.server.export_tasks import ExportTask, export_one
from model.core.errors import ArtiworldError, ConfigurationError, InputFileError
from model.core.files import free_name
from model.core.joint import JointDynamics
from model.core.pool import robust_map
from model.core.progress import Progress
from model.io import model_files
from model.io.assets.reader import NO_MODEL, NO_MODEL_REMEDY
from model.io.export.registry import exporter_names, load_exporter
from model.io.export.simready import AboutPackage, remember, remembered
from model.io.model_files import is_model, model_of
from model.io.urdf.files import allow
from model.io.zips import unzipped
from model.physics.collision.build import CollisionSettings, Method
from model.physics.collision.store import default_store
from model.physics.inertia import read_materials
from model.physics.simulation_values import SLIDING, TURNING, PhysicsSettings

T = TypeVar("T")

ASSET_FILES = ("object.urdf", "mobility.urdf", "object.xml", "model.sdf")
"""Files that mark a folder as an asset: ours, PartNet-Mobility's, exports to MJCF and SDF."""


MOST_FILES = 10
"""Files of one folder that get a row each; a folder with more gets one row."""


class Crashed(RuntimeError):
    """A worker process ended without an answer."""


def find_assets(paths: Sequence[Path]) -> list[Path]:
    """Assets among ``paths``: files of models, asset folders, folders of these, and zips.

    Raises:
        InputFileError: for a path with nothing of the kind.
    """
    out: list[Path] = []
    unpacked = ExitStack()
    atexit.register(unpacked.close)
    for path in paths:
        if not path.exists():
            raise InputFileError(path, "no such file or folder", "check the path")
        found = _below(path) if path.is_dir() else [unpacked.enter_context(unzipped(path))]
        if not found:
            raise InputFileError(path, NO_MODEL, NO_MODEL_REMEDY)
        out += found
    return list(dict.fromkeys(out))


def _below(folder: Path) -> list[Path]:
    """Assets that a folder is or holds; models of others only where it holds no assets."""
    allow(folder)
    found = _in_folder(folder) or [
        a for child in sorted(folder.iterdir()) for a in _in_folder(child)
    ]
    if found:
        return found
    with suppress(InputFileError):
        found = model_files.find_assets([folder])
    return [p for p in found if is_model(p) or (p.is_dir() and model_of(p) is not None)]


def _in_folder(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    if (folder / ASSET_FILES[0]).is_file():
        return [folder]
    return [folder / name for name in ASSET_FILES[1:] if (folder / name).is_file()][:1]


def asset_names(assets: Sequence[Path]) -> list[str]:
    """A unique name for each: the folder's, or the file's where it has a name of its own."""
    out: list[str] = []
    for asset in assets:
        if asset.is_dir():
            base = asset.resolve().name
        else:
            base = asset.parent.resolve().name if asset.name in ASSET_FILES else asset.stem
        out.append(free_name(base, out))
    return out


def run_all(
    function: Callable[[Any], T], tasks: Sequence[Any], jobs: int | None
) -> Iterator[tuple[int, T | Exception]]:
    """(index of the task, its answer or exception), in the order of completion.

    A task whose process dies twice, the second time alone, gives a :class:`Crashed`.

    Args:
        function: can be pickled.
        jobs: processes; None for as many as processors.
    """
    jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    numbered = [_Numbered(i, task) for i, task in enumerate(tasks)]
    for each, outcome in robust_map(partial(_outcome, function), numbered, jobs, "spawn"):
        if outcome is None:
            crash = Crashed("the worker process crashed (often because memory ran out)")
            yield each.index, crash
        else:
            yield each.index, outcome[0]


@dataclass(frozen=True, eq=False)
class _Numbered:
    """A task with its identity, as equal tasks may come twice."""

    index: int
    task: Any


def _outcome(function: Callable[[Any], T], numbered: _Numbered) -> tuple[T | Exception]:
    try:
        return (function(numbered.task),)
    except Exception as error:  # the boundary of a task
        return (error,)


def error_text(error: Exception) -> str:
    """Message of a failed task; internal errors are named by their type."""
    kind = "" if isinstance(error, ArtiworldError) else f"{type(error).__name__}: "
    return f"{kind}{error}"


def physics_settings(options: PhysicsOptions) -> PhysicsSettings:
    """Check the options and turn them into settings.

    Raises:
        ArtiworldError: naming the option and what would be right.
    """
    method = "hollow" if options.method is None else options.method
    if method not in get_args(Method):
        known = ", ".join(get_args(Method))
        raise ConfigurationError(f"no collision method {method!r}; there are {known}")
    collision = None
    if not options.no_collision:
        hulls = 24 if options.max_hulls is None else options.max_hulls
        collision = CollisionSettings(method=cast("Method", method), max_hulls=hulls)
    table = read_materials(options.materials)
    if options.material is not None:
        table = table.only(options.material)
    if (density := options.density) is not None:
        if not 0 < density < 1e5:
            raise ConfigurationError(f"--density {density:g} must be between 0 and 100000")
        table = table.with_density(density)
    default_dynamics = options.turning is None and options.sliding is None
    return PhysicsSettings(
        collision=collision,
        materials=table,
        turning=_dynamics(options.turning, "--turning", TURNING),
        sliding=_dynamics(options.sliding, "--sliding", SLIDING),
        hold=default_dynamics,
        fixed_base=not options.free_base,
        declared_masses=density is None and options.material is None and options.materials is None,
        declared_dynamics=default_dynamics,
        declared_shapes=options.method is None and options.max_hulls is None,
    )


def shape_store(options: PhysicsOptions) -> Path | None:
    """Folder of cached collision shapes; None caches none."""
    return None if options.no_cache else options.cache or default_store()


def _dynamics(text: str | None, option: str, usual: JointDynamics) -> JointDynamics:
    if text is None:
        return usual
    try:
        damping, friction = (float(word) for word in text.split(","))
    except ValueError:
        damping = friction = -1.0
    if not (0 <= damping < float("inf") and 0 <= friction < float("inf")):
        raise ConfigurationError(
            f"{option} {text!r} must be two numbers from 0 on, such as 0.1,0.05"
        )
    return replace(usual, damping=damping, friction=friction)


def export(options: ExportCommand, progress: Progress) -> Result:
    """Write all assets in all formats.

    The exit code is 2 where one of several can't be written, 1 where one alone doesn't read back.
    """
    formats = named_formats(options.format)
    package = None
    if options.profile is not None and "usd" not in formats:
        raise ConfigurationError(f"--profile {options.profile} is of --format usd")
    assets = find_assets(options.assets)
    if options.profile is not None:
        # Accepted assets lie in the folder "assets" of their workspace.
        workspace = assets[0].parent.parent if assets[0].parent.name == "assets" else None
        author, license = remembered(workspace)
        package = AboutPackage(
            options.author or author, options.license or license, qcode=options.qcode
        )
        remember(workspace, package)
    physics, store = physics_settings(options.physics), shape_store(options.physics)
    check_output(options.out, *assets, *(a.parent for a in assets if a.is_file()))
    several = len(assets) > 1 or _is_collection({*options.assets} - {*assets})
    tasks = []
    for asset, name in zip(assets, asset_names(assets), strict=True):
        base = options.out / name if several else options.out
        folders = tuple((f, base / f if len(formats) > 1 else base) for f in formats)
        tasks.append(
            ExportTask(asset, folders, physics, store, options.check, options.complete, package)
        )
    if several:
        report = _export_all(tasks, options.jobs, progress)
        return Result(report, lambda: _print_batch(report), 2 if report["failed"] else 0)
    report = export_one(tasks[0], progress)
    alone = report["formats"][0] | {"asset": report["asset"]} if len(formats) == 1 else report
    wrong = any(f.get("problems") for f in report["formats"])
    return Result(alone, lambda: _print_one(report), int(wrong))


def _is_collection(paths: Iterable[Path]) -> bool:
    """True if a path is a folder of assets, even of only one."""
    return any(p.is_dir() and not any((p / name).is_file() for name in ASSET_FILES) for p in paths)


def named_formats(given: Iterable[str]) -> list[str]:
    """Format names of ``--format``, each once.

    Raises:
        ConfigurationError: for an unknown one.
    """
    names = [n.strip() for text in given for n in text.split(",") if n.strip()]
    if "all" in names:
        names = list(exporter_names())
    if not names:
        raise ConfigurationError("--format names no format; give one, such as urdf")
    for name in names:
        load_exporter(name)  # a wrong name fails before anything is done
    return list(dict.fromkeys(names))


def _export_all(tasks: list[ExportTask], jobs: int | None, progress: Progress) -> dict[str, Any]:
    answers: dict[int, dict[str, Any]] = {}
    for i, answer in run_all(export_one, tasks, jobs):
        if isinstance(answer, Exception):
            answers[i] = {"asset": str(tasks[i].asset), "error": error_text(answer)}
        else:
            answers[i] = answer
        progress(len(answers) / len(tasks), f"{tasks[i].asset}")
    rows = [answers[i] for i in range(len(tasks))]
    bad = sum("error" in r or any(f.get("problems") for f in r["formats"]) for r in rows)
    return {"assets": rows, "written": len(rows) - bad, "failed": bad}


def _print_one(report: dict[str, Any]) -> None:
    for entry in report["formats"]:
        print_files(entry | {"asset": report["asset"]}, Path(entry["folder"]))
        output.print_notes(entry.get("problems", []), "wrong", "bold red")
        output.print_notes(entry.get("notes", []))


def print_files(report: dict[str, Any], out: Path) -> None:
    """Print the files that ``export`` wrote; a folder of many, as of shapes, gets one row."""
    folders: dict[str, dict[str, int]] = {}
    for file in report["files"]:
        folders.setdefault(os.path.dirname(file["file"]), {})[file["file"]] = file["bytes"]
    sizes: dict[str, int] = {}
    for folder, files in folders.items():
        many = folder and len(files) > MOST_FILES
        sizes |= {f"{folder}/ · {len(files)} files": sum(files.values())} if many else files
    rows = [{"file": name, "bytes": size} for name, size in sizes.items()]
    output.print_figures(f"{report['asset']} as {report['format']}", rows)
    output.console().print(f"written to {out}")


def _print_batch(report: dict[str, Any]) -> None:
    output.print_records(None, map(_cells, report["assets"]))
    for row in report["assets"]:
        notes = dict.fromkeys(n for f in row.get("formats", ()) for n in f.get("notes", ()))
        output.print_notes(f"{row['asset']}: {note}" for note in notes)
    output.console().print(f"{report['written']} written, {report['failed']} failed")


def _cells(row: dict[str, Any]) -> dict[str, Any]:
    """An asset's row of the table."""
    formats = row.get("formats", ())
    problems = (
        [row["error"]] if "error" in row else [p for f in formats for p in f.get("problems", ())]
    )
    return {
        "asset": row["asset"],
        "formats": ", ".join(f["format"] for f in formats),
        "collision shapes": sum(row.get("collision_shapes", {}).values()),
        "files": sum(len(f["files"]) for f in formats),
        "wrong": output.wrong([row["error"]] if "error" in row else problems),
    }
