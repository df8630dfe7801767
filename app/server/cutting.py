"""Leaving out parts of an open scan, and cutting objects out of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from app.server import room_tasks
from app.server.jobs import CLICKS
from app.server.open_object import OpenObject
from model.core.errors import CommandError
from sessions import commands as cmd
from sessions.document import Document


def leave_out(obj: OpenObject, what: str, part: int, who: str) -> None:
    """Leave out the floor and the walls ("floor and walls"), or one part ("part")."""
    asset, doc = obj.need_asset(), obj.document
    _need_whole_faces(doc)
    left_out = None if doc.left_out is None else doc.left_out.elements
    if what == "part":
        labels = obj.source().labels
        arguments: tuple[Any, ...] = (labels, part, left_out)
        function: Callable[..., room_tasks.Removal] = room_tasks.leave_out_part
    else:
        function, arguments = room_tasks.floor_and_walls, (left_out,)
    job = obj.services.workers.reading.submit(
        function,
        asset.folder,
        obj.services.workspace,
        *arguments,
        on_progress=obj.jobs.progress("room"),
        priority=6,
        preempted_by=CLICKS,
    )

    def keep(removal: room_tasks.Removal) -> None:
        name = doc.part_names.get(part, f"part {part}") if what == "part" else what
        obj.do(cmd.LeaveOut(removal.elements, removal.count, name), who)

    obj.start("room", job, keep)
    obj.changed()


def cut_out(obj: OpenObject, part: int, who: str, done: Callable[[int], None]) -> None:
    """Make one part an object of its own in the queue; ``done`` gets its id."""
    asset, doc = obj.need_asset(), obj.document
    name = f"{asset.name}_{doc.part_names.get(part) or f'part_{part}'}"

    def keep(crop: room_tasks.Crop) -> None:
        new = obj.services.queue.add([crop.path])[0]
        placed = cmd.Placed(str(asset.path), asset.sha256, crop.elements, crop.position)
        obj.services.hub.session(new).do(placed, who)
        out = cmd.CropOut(crop.name, str(crop.path), crop.elements, crop.count, crop.position)
        obj.do(out, who)
        done(new)

    _cut(obj, room_tasks.cut_out, (), part, name, keep)


def pick_out(
    obj: OpenObject, copy: Path, part: int, name: str, keep: Callable[[room_tasks.Picked], None]
) -> None:
    """Write one part and the rest for the scene; ``keep`` gets both.

    Args:
        copy: folder of the working copy that is open.
    """
    _cut(obj, room_tasks.pick_out, (copy,), part, name, keep)


def _cut(
    obj: OpenObject,
    function: Callable[..., Any],
    first: tuple[Any, ...],
    part: int,
    name: str,
    keep: Callable[[Any], None],
) -> None:
    asset, doc = obj.need_asset(), obj.document
    _need_whole_faces(doc)
    if not doc.segmentation_current:
        raise CommandError("the parts are still being computed; try again in a moment")
    job = obj.services.workers.reading.submit(
        function,
        *first,
        asset.folder,
        obj.services.workspace,
        obj.source(doc).labels,
        part,
        None if doc.left_out is None else doc.left_out.elements,
        name,
        on_progress=obj.jobs.progress("room"),
        priority=6,
        preempted_by=CLICKS,
    )
    obj.start("room", job, keep)
    obj.changed()


def _need_whole_faces(doc: Document) -> None:
    # Left out and cut out elements are those of the file.
    if doc.face_cuts:
        raise CommandError(
            "faces were split by a cut: undo it first, then cut again in the new object"
        )
