"""The job that exports an asset in the formats of simulators; see :mod:`app.server.tasks`."""

from __future__ import annotations

import os
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

from model.core.errors import CommandError
from model.core.files import unnamed_file, written_to
from model.core.packages import install_command
from model.core.progress import Progress, no_progress, scaled_progress
from model.geometry.completion import as_scanned, complete
from model.io.assets.reader import PROVENANCE, load_object, reading_notes
from model.io.export.formats import losses_of
from model.io.export.manifest import about_asset, write_about
from model.io.export.registry import EXPORTERS, load_exporter, write_object
from model.io.export.simready import (
    VALIDATOR,
    AboutPackage,
    SimReadyExporter,
    simready_problems,
    validator_installed,
)
from model.io.file_names import FileNames
from model.io.readback import read_back
from model.physics.simulation_values import PhysicsSettings, physics_of, whose_shapes

DOWNLOAD_BYTES = 400_000_000
"""Largest download; a browser's passes through the memory of the server."""


def zipped(folder: Path, name: str) -> BinaryIO:
    """Return the files of a folder as an unnamed zip beside it, in which it has that name.

    Raises:
        CommandError: where it is too large.
    """
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    if sum(p.stat().st_size for p in files) > DOWNLOAD_BYTES:
        raise CommandError(f"too large to download: copy {folder} from the server's disk")
    with written_to(folder.parent):
        out = unnamed_file(folder.parent)
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in files:
                archive.write(path, Path(name) / path.relative_to(folder))
    out.seek(0)
    return out


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
        own_notes = [*notes, *(losses_of(name, obj, physics))]
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
