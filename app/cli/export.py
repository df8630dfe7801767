"""``artiworld export``: articulated objects in the formats of simulators."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.text import Text

from app.cli import printing
from app.cli.batch import ASSET_FILES, asset_names, error_text, find_assets, run_all
from app.cli.commands import ExportCommand
from app.cli.output import check_output
from app.cli.physics_settings import physics_settings, shape_store
from model.core.errors import ConfigurationError
from model.core.installing import install_command
from model.core.progress import Progress, no_progress, scaled_progress
from model.geometry.completion import as_scanned, complete
from model.io.assets.reader import PROVENANCE, load_object, reading_notes
from model.io.export.manifest import about_asset, write_about
from model.io.export.registry import (
    EXPORTERS,
    exporter_names,
    load_exporter,
    losses_of,
    write_object,
)
from model.io.export.simready import (
    VALIDATOR,
    AboutPackage,
    SimReadyExporter,
    simready_problems,
    validator_installed,
)
from model.io.file_names import FileNames
from model.io.readback.compare import read_back
from model.physics.simulation_values import PhysicsSettings, physics_of, whose_shapes


@dataclass(frozen=True)
class ExportTask:
    """One asset to write; picklable.

    Attributes:
        folders: (format, its folder).
        store: folder of cached collision shapes.
        check: whether each file is read back.
        complete: whether scanned parts are completed; None: as they were saved.
        package: what a SimReady package says of itself; None for plain USD.
    """

    asset: Path
    folders: tuple[tuple[str, Path], ...]
    physics: PhysicsSettings
    store: Path | None
    check: bool
    complete: bool | None = None
    package: AboutPackage | None = None


def export(options: ExportCommand) -> int:
    """Write all assets in all formats, print the files, and return the exit code."""
    formats = named_formats(options.format)
    package = None
    if options.profile is not None:
        if "usd" not in formats:
            raise ConfigurationError(f"--profile {options.profile} is of --format usd")
        package = AboutPackage(options.author, options.license, qcode=options.qcode)
    assets = find_assets(options.assets)
    physics, store = physics_settings(options.physics), shape_store(options.physics)
    check_output(options.out, *assets, *(a.parent for a in assets if a.is_file()))
    several = len(assets) > 1 or _is_collection(options.assets)
    tasks = []
    for asset, name in zip(assets, asset_names(assets), strict=True):
        base = options.out / name if several else options.out
        folders = tuple((f, base / f if len(formats) > 1 else base) for f in formats)
        tasks.append(
            ExportTask(asset, folders, physics, store, options.check, options.complete, package)
        )
    with printing.session(options.json) as show:
        if several:
            report = _export_all(tasks, options.jobs, show.progress)
        else:
            report = export_one(tasks[0], show.progress)
    if several:
        show.result(report, lambda: _print_batch(report))
        return 2 if report["failed"] else 0
    alone = report["formats"][0] | {"asset": report["asset"]} if len(formats) == 1 else report
    show.result(alone, lambda: _print_one(report))
    return 1 if any(f.get("problems") for f in report["formats"]) else 0


def _is_collection(paths: Iterable[Path]) -> bool:
    """Whether a folder of assets was given, even where it holds one."""
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


def export_one(task: ExportTask, progress: Progress = no_progress) -> dict[str, Any]:
    """Write one asset in all formats asked for.

    Raises:
        ArtiworldError: where the asset can't be read or written.
    """
    progress(0.0, f"reading {task.asset}")
    obj = load_object(task.asset)
    if task.complete is not None:
        obj = replace(obj, parts=as_scanned(obj.parts))
    if task.complete:
        obj = complete(obj, scaled_progress(progress, 0.0, 0.05))
    physics = physics_of(
        obj, task.physics, store=task.store, progress=scaled_progress(progress, 0.05, 0.5)
    )
    if (task.asset / PROVENANCE).is_file():  # others name their links themselves
        names = FileNames.of(obj)
        obj, physics = names.object(obj), names.physics(physics)
    whose = whose_shapes(obj, physics)
    notes = [*reading_notes(task.asset, obj), *([whose] if whose else ())]
    written: list[dict[str, Any]] = []
    for i, (name, folder) in enumerate(task.folders):
        start = 0.5 + 0.5 * i / len(task.folders)
        span = scaled_progress(progress, start, 0.5 + 0.5 * (i + 1) / len(task.folders))
        exporter = load_exporter(name)
        if name == "usd" and task.package is not None:
            source = about_asset(task.asset)["source"] or task.asset.name
            exporter = SimReadyExporter(replace(task.package, source=source))
        files = write_object(obj, exporter, folder, physics=physics, progress=span)
        own_notes = [*notes, *(losses_of(name, obj))]
        about = write_about(folder, task.asset, name, own_notes)
        entry: dict[str, Any] = {
            "format": name,
            "folder": str(folder),
            "files": [
                {"file": os.path.relpath(f, folder), "bytes": f.stat().st_size}
                for f in (*files, about)
            ],
        }
        if task.check and name in EXPORTERS.built_in:
            back = read_back(name, files[0], obj)
            entry |= {"readers": list(back.readers), "problems": list(back.problems)}
            if isinstance(exporter, SimReadyExporter) and validator_installed():
                entry["readers"].append(VALIDATOR)
                entry["problems"] += simready_problems(files[0])
            elif isinstance(exporter, SimReadyExporter):
                own_notes.append(f"not validated: {install_command('artiworld[simready]')}")
        elif task.check:  # a plug-in's
            own_notes.append(f"nothing here reads {name} back: it was written, not checked")
        if own_notes:
            entry["notes"] = own_notes
        written.append(entry)
    return {
        "asset": str(task.asset),
        "collision_shapes": {link: len(shapes) for link, shapes in physics.collision.items()},
        "collision_from_source": list(physics.declared_shapes),
        "formats": written,
    }


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
        printing.print_files(entry | {"asset": report["asset"]}, Path(entry["folder"]))
        for problem in entry.get("problems", []):
            printing.console().print(Text(f"wrong: {problem}", "bold red"))
        printing.print_notes(entry.get("notes", []))


def _print_batch(report: dict[str, Any]) -> None:
    rows = []
    for row in report["assets"]:
        if "error" in row:
            rows.append((row["asset"], "", "", "", Text(row["error"], "bold red")))
            continue
        wrong = [p for f in row["formats"] for p in f.get("problems", [])]
        rows.append((
            row["asset"],
            ", ".join(f["format"] for f in row["formats"]),
            str(sum(row["collision_shapes"].values())),
            str(sum(len(f["files"]) for f in row["formats"])),
            Text("; ".join(wrong), "bold red"),
        ))  # fmt: skip
    columns = ("asset", "formats", "collision shapes", "files", "wrong")
    printing.console().print(printing.table_of(None, columns, rows))
    for row in report["assets"]:
        notes = dict.fromkeys(n for f in row.get("formats", ()) for n in f.get("notes", ()))
        printing.print_notes(f"{row['asset']}: {note}" for note in notes)
    printing.console().print(f"{report['written']} written, {report['failed']} failed")
