"""``artiworld export``: articulated objects in the formats of simulators."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.text import Text

from app.cli import printing
from app.cli.batch import ASSET_FILES, asset_names, error_text, find_assets, run_all
from app.cli.commands import ExportCommand
from app.cli.output import check_output
from app.cli.physics_settings import physics_settings, shape_store
from app.server.export_tasks import ExportTask, export_one
from model.core.errors import ConfigurationError
from model.core.progress import Progress
from model.io.export.registry import exporter_names, load_exporter
from model.io.export.simready import AboutPackage, remember, remembered


def export(options: ExportCommand) -> int:
    """Write all assets in all formats, print the files, and return the exit code."""
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
