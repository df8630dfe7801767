"""Jobs that write assets; see :mod:`app.server.tasks`.

All but the record of an asset is written as a draft while the person still looks at the joints;
accepting adds the record and moves it in place.
"""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from app.server.part_tasks import PartSource, articulated_object
from app.server.tasks import asset_of
from model.core.errors import ArtiworldError
from model.core.files import draft_of, written_to
from model.core.progress import Progress, no_progress, scaled_progress
from model.core.tree import KinematicTree
from model.io.assets.asset_folder import write_draft
from model.io.assets.reader import reload_check
from model.physics.collision.store import fingerprint
from model.physics.simulation_values import physics_of

DRAFTS_KEPT = 4


def prepare_asset(
    source: PartSource, tree: KinematicTree, progress: Progress = no_progress
) -> Path:
    """Write an asset without its record and read it back, so that accepting only moves it.

    Returns:
        The draft's folder, the same for the same parts and joints.

    Raises:
        ArtiworldError: where the written asset doesn't load correctly.
    """
    target = _draft_name(source, tree)
    with suppress(OSError):  # the place to write to is judged where it is written
        os.utime(target)  # now the newest, it is kept longest
        return target
    progress(0.02, "Cutting out the parts")
    asset = asset_of(source.folder)
    obj = articulated_object(source, tree, scaled_progress(progress, 0.02, 0.3))
    physics = physics_of(
        obj, store=source.workspace / "collision", progress=scaled_progress(progress, 0.3, 0.7)
    )
    with written_to(target, "check space and permissions"), draft_of(target, Path.is_dir) as fresh:
        write_draft(
            obj,
            fresh,
            original=asset,
            physics=physics,
            progress=scaled_progress(progress, 0.7, 0.85),
        )
        progress(0.85, "Checking the files")
        problems = reload_check(fresh)
        if problems:
            raise ArtiworldError(f"{obj.name} doesn't load correctly: {problems[0]}")
    _drop_drafts(target.parent)
    return target


def _draft_name(source: PartSource, tree: KinematicTree) -> Path:
    key = fingerprint(
        "draft", version("artiworld"), source.folder.name, source.labels,
        sorted(source.names.items()), source.category, source.title, source.complete, tree.links,
        tree.joints,
    )  # fmt: skip
    return source.workspace / "drafts" / key


def _drop_drafts(folder: Path) -> None:
    """Remove the oldest drafts, but for those being written."""
    found: list[tuple[float, Path]] = []
    for path in folder.glob("[!.]*"):
        with suppress(FileNotFoundError):  # it was accepted just now
            found.append((path.stat().st_mtime, path))
    for _, old in sorted(found)[:-DRAFTS_KEPT]:
        shutil.rmtree(old, ignore_errors=True)
