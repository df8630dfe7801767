"""``artiworld export``: articulated objects in the formats of simulators."""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli.batch import ASSET_FILES, asset_names, find_assets, run_all
from app.cli.options import add_json
from app.cli.physics_options import add_physics, physics_settings, store_folder
from model.core.errors import ArtiworldError, ConfigurationError

if TYPE_CHECKING:
    from model.core.progress import Progress
    from model.physics.simulation_values import PhysicsSettings


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
    add = parser.add_argument
    add("assets", nargs="+", type=Path, metavar="ASSET",
        help="asset folders, URDF and MJCF files, or folders of assets")  # fmt: skip
    add("--format", required=True, action="append", metavar="NAME,NAME",
        help="urdf, ros, mjcf, usd, sdf, glb, or all; may be repeated")  # fmt: skip
    add("--out", type=Path, required=True, metavar="DIR",
        help="folder for the files; of several assets each gets one below it, of several formats "
             "each one below that")  # fmt: skip
    add_physics(parser)
    add("--check", action="store_true", help="read each file back and compare link poses")
    add("--jobs", type=int, default=None, metavar="N",
        help="processes for several assets (default: as many as processors)")  # fmt: skip
    add_json(parser)


@dataclass(frozen=True)
class ExportTask:
    """One asset to write; picklable."""

    asset: Path
    folders: tuple[tuple[str, Path], ...]
    physics: PhysicsSettings
    store: Path | None
    check: bool


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code: 2 where an asset could not be written."""
    from app.cli import printing
    from app.cli.headless import check_output

    formats = named_formats(args.format)
    assets = find_assets(args.assets)
    settings, store = physics_settings(args), store_folder(args)
    check_output(args.out, *assets, *(a.parent for a in assets if a.is_file()))
    several = len(assets) > 1 or _is_collection(args.assets)
    tasks = [
        ExportTask(asset, tuple(
            (f, (args.out / name if several else args.out) / (f if len(formats) > 1 else ""))
            for f in formats
        ), settings, store, args.check)
        for asset, name in zip(assets, asset_names(assets), strict=True)
    ]  # fmt: skip
    with printing.session(args.json) as show:
        if not several:
            report = export_one(tasks[0], show.progress)
        else:
            report = _batch(tasks, args.jobs, show.progress)
    if several:
        show.result(report, lambda: _print_batch(report))
        return 2 if report["failed"] else 0
    alone = report["formats"][0] | {"asset": report["asset"]} if len(formats) == 1 else report
    show.result(alone, lambda: _print_one(report))
    return 1 if any(f.get("problems") for f in report["formats"]) else 0


def _is_collection(paths: list[Path]) -> bool:
    """Whether a folder of assets was given, even where it holds one."""
    return any(p.is_dir() and not any((p / name).is_file() for name in ASSET_FILES) for p in paths)


def named_formats(given: list[str]) -> list[str]:
    """Format names of ``--format``, each once.

    Raises:
        ConfigurationError: for one that isn't there.
    """
    from model.io.export.registry import exporter_names, load_exporter

    names = [n.strip() for text in given for n in text.split(",") if n.strip()]
    if "all" in names:
        names = list(exporter_names())
    if not names:
        raise ConfigurationError("--format names no format; give one, such as urdf")
    for name in names:
        load_exporter(name)  # a wrong name is told before anything is done
    return list(dict.fromkeys(names))


def export_one(task: ExportTask, progress: Progress | None = None) -> dict[str, Any]:
    """Write one asset in all the formats asked for.

    Raises:
        ArtiworldError: where the asset can't be read or written.
    """
    from model.core.progress import no_progress, scaled_progress
    from model.io.assets.reader import load_object, reading_notes
    from model.io.export.manifest import write_about
    from model.io.export.registry import BUILT_IN, load_exporter, losses_of, write_object
    from model.io.readback.compare import read_back
    from model.physics.simulation_values import physics_of, whose_shapes

    progress = progress or no_progress
    progress(0.0, f"reading {task.asset}")
    obj = load_object(task.asset)
    physics = physics_of(
        obj, task.physics, store=task.store, progress=scaled_progress(progress, 0.05, 0.5)
    )
    whose = whose_shapes(obj, physics)
    notes = [*reading_notes(task.asset, obj), *([whose] if whose else ())]
    written: list[dict[str, Any]] = []
    for i, (name, folder) in enumerate(task.folders):
        start = 0.5 + 0.5 * i / len(task.folders)
        span = scaled_progress(progress, start, 0.5 + 0.5 * (i + 1) / len(task.folders))
        files = write_object(obj, load_exporter(name), folder, physics=physics, progress=span)
        said = [*notes, *(losses_of(name, obj))]
        about = write_about(folder, task.asset, name, said)
        entry: dict[str, Any] = {
            "format": name,
            "folder": str(folder),
            "files": [
                {"file": os.path.relpath(f, folder), "bytes": f.stat().st_size}
                for f in (*files, about)
            ],
        }
        if task.check and name in BUILT_IN:
            back = read_back(name, files[0], obj)
            entry |= {"readers": list(back.readers), "problems": list(back.problems)}
        elif task.check:  # a plug-in's
            said.append(f"nothing here reads {name} back: it was written, not checked")
        if said:
            entry["notes"] = said
        written.append(entry)
    shapes = {link: len(held) for link, held in physics.collision.items()}
    return {
        "asset": str(task.asset), "collision_shapes": shapes,
        "collision_from_source": list(physics.told_shapes), "formats": written,
    }  # fmt: skip


def _batch(tasks: list[ExportTask], jobs: int | None, progress: Progress) -> dict[str, Any]:
    answers: dict[int, dict[str, Any]] = {}
    for i, answer in run_all(export_one, tasks, jobs or os.cpu_count() or 1):
        progress((len(answers) + 1) / len(tasks), f"{tasks[i].asset}")
        if isinstance(answer, Exception):
            kind = "" if isinstance(answer, ArtiworldError) else f"{type(answer).__name__}: "
            answers[i] = {"asset": str(tasks[i].asset), "error": f"{kind}{answer}"}
        else:
            answers[i] = answer
    rows = [answers[i] for i in range(len(tasks))]
    bad = sum("error" in r or any(f.get("problems") for f in r["formats"]) for r in rows)
    return {"assets": rows, "written": len(rows) - bad, "failed": bad}


def _print_one(report: dict[str, Any]) -> None:
    from app.cli import printing

    for entry in report["formats"]:
        printing.files_table(entry | {"asset": report["asset"]}, Path(entry["folder"]))
        for problem in entry.get("problems", []):
            printing.console().print(f"wrong: {problem}", style="bold red")
        for note in entry.get("notes", []):
            printing.console().print(f"note: {note}", style="yellow", markup=False)


def _print_batch(report: dict[str, Any]) -> None:
    from rich.table import Table
    from rich.text import Text

    from app.cli.printing import console

    table = Table()
    for column in ("asset", "formats", "collision shapes", "files", "wrong"):
        table.add_column(column, overflow="fold")
    for row in report["assets"]:
        if "error" in row:
            table.add_row(row["asset"], "", "", "", Text(row["error"], "bold red"))
            continue
        wrong = [p for f in row["formats"] for p in f.get("problems", [])]
        table.add_row(
            row["asset"],
            ", ".join(f["format"] for f in row["formats"]),
            str(sum(row["collision_shapes"].values())),
            str(sum(len(f["files"]) for f in row["formats"])),
            Text("; ".join(wrong), "bold red"),
        )
    target = console()
    target.print(table)
    for row in report["assets"]:
        for note in dict.fromkeys(n for f in row.get("formats", ()) for n in f.get("notes", ())):
            target.print(f"note: {row['asset']}: {note}", style="yellow", markup=False)
    target.print(f"{report['written']} written, {report['failed']} failed")
