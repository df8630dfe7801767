"""Picking objects out of an object of the open scene, such as a refrigerator out of an unlabelled
room.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from app.server import scene_tasks
from app.server.jobs import CLICKS
from app.server.object_context import ObjectContext
from app.server.prepare_tasks import Crop, Removal
from app.server.preparing import pick_out
from app.server.scene_state import SceneState
from app.server.scene_tasks import SceneItem
from app.server.workers import READ_SECONDS
from model.core.errors import CommandError
from model.core.geometry import quaternion_wxyz
from model.scenes.articulable_finders import LexiconFinder
from model.scenes.scene import Decision, FloatArray, ObjectDescription, SceneObject
from model.scenes.values import pose, rotation_from_quaternion
from sessions import commands as cmd
from sessions.checks import clean_text
from sessions.document import Position, Quaternion
from sessions.scene_commands import PickOut


class Picking:
    """Picks objects out of the objects of a scene."""

    def __init__(self, scene: SceneState) -> None:
        self._scene = scene
        self._finder = LexiconFinder()

    def open(self, id: str, done: Callable[[int], None]) -> None:
        """Call ``done`` with the session of an object as a whole, once it can be clicked.

        Floor and walls of a room are left out; undo brings them back.

        Raises:
            CommandError: where it has no geometry.
        """
        scene, item = self._scene, self._scene.items[id]
        copy = item.copy
        if copy is None or scene.world_from_copy(item) is None:
            raise CommandError(scene.missing_reason(item) or "there is nothing to pick out of it")

        (record,) = scene.services.store.open_objects([(copy, None, id)])
        live = scene.services.hub.session(record.id)
        if live.state.seq:
            done(record.id)
            return

        def keep(border: Removal | None) -> None:
            if border is not None and not live.state.seq:
                live.do(cmd.LeaveOut(border.elements, border.count, "floor and walls"), "scene")
            done(record.id)

        job = scene.services.workers.reading.submit(
            scene_tasks.prepare_for_picking,
            item,
            scene.services.workspace,
            on_progress=scene.jobs.progress("copy"),
            priority=8,
            preempted_by=CLICKS,
            most_seconds=READ_SECONDS,
        )
        scene.start("copy", job, keep, files=(item.path or copy,))
        scene.changed()

    def take_out(
        self,
        obj: ObjectContext,
        id: str,
        part: int,
        name: str,
        who: str,
        done: Callable[[str], None],
    ) -> None:
        """Make a part of the object ``id``, open as ``obj``, an object of its own.

        ``done`` gets its id.

        Raises:
            CommandError: where the part is empty, or the object was read in another frame.
        """
        scene, item, doc = self._scene, self._scene.items[id], obj.document
        world = scene.world_from_copy(item)
        if item.copy is None or world is None:
            raise CommandError(f"{id} isn't in the scene any more")
        if not part:
            raise CommandError("part 0 is the rest: select the part that you clicked")
        if doc.up_axis is not None or doc.unit_scale != 1.0:
            raise CommandError("it was read with other axes or units than the scene: undo that")
        words = clean_text(name, 60, "what it is") or "object"

        def keep(crop: Crop) -> None:
            stands = world @ pose(np.asarray(crop.position))
            fresh = self._free(words)
            command = PickOut(
                id,
                fresh,
                words,
                str(crop.path),
                str(crop.rest),
                crop.count,
                *_position_and_rotation(stands),
                *_position_and_rotation(world),
            )
            scene.live.do(command, who)
            done(fresh)

        pick_out(obj, part, words, item.copy, keep)

    def _free(self, name: str) -> str:
        taken = {*self._scene.items, *(p.object for p in self._scene.document.picked)}
        return next(i for n in range(1, len(taken) + 2) if (i := f"{name} {n}") not in taken)

    def arranged(self, items: Iterable[SceneItem]) -> dict[str, SceneItem]:
        """Return the objects of the scene by id, with those that were picked out of them."""
        out = {item.obj.id: item for item in items}
        for pick in self._scene.document.picked:
            old = out.get(pick.object)
            if old is None or pick.id in out:
                continue  # the scene's file changed since
            rest = replace(
                old.obj,
                world_from_object=_pose(pick.rest_position, pick.rest_wxyz),
                scale=np.ones(3),
                fit=None,
                anchor="origin",
            )
            out[pick.object] = replace(
                old, obj=rest, path=Path(pick.rest), copy=self._copy(pick.rest), truth=None
            )
            out[pick.id] = SceneItem(
                SceneObject(
                    pick.id,
                    pick.name,
                    _pose(pick.position, pick.wxyz),
                    np.ones(3),
                    asset=f"{self._scene.record.path.name}#{pick.id}",
                    room=old.obj.room,
                    base=old.obj.base,
                ),
                self._decision(pick.name),
                Path(pick.path),
                self._copy(pick.path),
            )
        return out

    def _decision(self, name: str) -> Decision:
        (found,) = self._finder.find([ObjectDescription(name)])
        return replace(found, articulable=True, reason="a person picked it out", confidence=1.0)

    def _copy(self, path: str) -> Path:
        key = hashlib.sha256(path.encode()).hexdigest()[:12]
        return self._scene.services.workspace / "scenes" / f"{Path(path).stem}-{key}"


def _position_and_rotation(world: FloatArray) -> tuple[Position, Quaternion]:
    x, y, z = world[:3, 3].tolist()
    return (x, y, z), quaternion_wxyz(world)


def _pose(position: Position, wxyz: Quaternion) -> FloatArray:
    w, x, y, z = wxyz
    return pose(np.asarray(position), rotation_from_quaternion(np.array([x, y, z, w])))
