"""Extracting objects: from a scan and what of it is excluded, or out of an object of the scene,
such as a whole room.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from app.server.open_object import OpenObject
from app.server.preparing import cut_out, leave_out
from app.viewer.panels.widgets import put
from app.viewer.picture.stage import may_be_a_room
from app.viewer.tab import Tab, plain
from app.viewer.words import annotate as words
from app.viewer.words import scene as scene_words
from model.core.errors import CommandError
from sessions import commands as cmd


class SourcePanel:
    """A folder below the annotation tools, closed until somebody needs it."""

    def __init__(self, tab: Tab, open_object: Callable[[int], None]) -> None:
        """Make the folder; ``open_object`` gets the id of what was cut out."""
        self._tab, self._open = tab, open_object
        self._drawn: Any = None
        gui = tab.client.gui
        self._folder = gui.add_folder(words.EXTRACT_FOLDER, expand_by_default=False)
        with self._folder:
            self._room_note = gui.add_markdown("")
            self._leave_out = gui.add_button_group(
                words.EXCLUDE, words.EXCLUDE_ACTIONS, hint=words.EXCLUDE_HINT
            )
            self._back = gui.add_button(words.RESTORE_ALL, color="gray", visible=False)
            self._cut_out = gui.add_button(
                words.EXTRACT, color="gray", hint=words.EXTRACT_HINT, visible=not tab.in_scene
            )
        self._leave_out.on_click(lambda e: tab.act(lambda: self.leave_out(e.target.value)))
        self._back.on_click(lambda _: tab.act(self.restore))
        self._cut_out.on_click(lambda _: tab.act(self.cut_out))

    def leave_out(self, what: str = words.EXCLUDE_ACTIONS[0]) -> None:
        """Exclude floor and walls, or the selected part."""
        tab, part = self._tab, self._tab.selection.part
        obj = tab.selection.need_object()
        one = what == words.EXCLUDE_ACTIONS[1]
        if one and not part:
            raise CommandError(words.EXCLUDE_BASE)
        leave_out(obj, part if one else None, tab.user)

    def restore(self) -> None:
        """Restore the excluded geometry."""
        self._tab.do(cmd.LeaveOut(None))

    def cut_out(self) -> None:
        """Extract the selected part as an object and open it."""
        tab, part = self._tab, self._tab.selection.part
        if tab.in_scene:
            raise CommandError(words.EXTRACT_IN_SCENE)
        if not part:
            raise CommandError(words.EXTRACT_BASE)

        def open_it(object_id: int) -> None:
            tab.act(lambda: self._open(object_id))

        cut_out(tab.selection.need_object(), part, tab.user, open_it)

    def draw(self, obj: OpenObject) -> None:
        """Bring the folder up to date."""
        doc, asset = obj.document, obj.asset
        history = doc.left_out, doc.crops, doc.placement
        scan = asset is not None and (asset.element_kind == "point" or may_be_a_room(asset.bounds))
        now = (obj.record.id, scan, *history)
        if now == self._drawn:
            return
        self._drawn = now
        put(self._folder, visible=scan or any(history))
        put(self._room_note, content=_room_note(obj, self._tab.in_scene))
        put(self._back, visible=doc.left_out is not None)


def _room_note(obj: OpenObject, in_scene: bool) -> str:
    doc = obj.document
    if doc.placement is not None:
        scene = plain(doc.placement.scene.rpartition("/")[2])
        return words.extracted_from(scene, doc.placement.position)
    lines = []
    if doc.left_out is not None:
        lines.append(words.excluded(plain(doc.left_out.what), doc.left_out.count))
    if doc.crops:
        lines.append(words.extracted(", ".join(plain(c.name) for c in doc.crops)))
    if in_scene:
        return "\n\n".join(lines)
    return "\n\n".join(lines) or words.EXTRACT_HELP


class PickPanel:
    """Above the usual tools while an object of the scene is there to be picked from."""

    def __init__(self, tab: Tab, take_out: Callable[[str], None]) -> None:
        """Make the widgets; ``take_out`` gets the new object's name."""
        self._tab = tab
        gui = tab.client.gui
        self._how = gui.add_markdown(scene_words.EXTRACT_HELP, visible=False)
        self._back = gui.add_button(
            scene_words.RESTORE_ROOM,
            color="gray",
            visible=False,
            hint=scene_words.RESTORE_ROOM_HINT,
        )
        self._name = gui.add_text(
            scene_words.OBJECT_NAME, "", hint=scene_words.OBJECT_NAME_HINT, visible=False
        )
        self._take = gui.add_button(
            scene_words.EXTRACT, icon=viser.Icon.SCISSORS, color="green", visible=False
        )
        self._back.on_click(lambda _: tab.act(lambda: tab.do(cmd.LeaveOut(None))))
        self._take.on_click(lambda _: tab.act(lambda: take_out(self._name.value)))

    def draw(self) -> None:
        """Bring it up to date."""
        picking, obj = self._tab.selection.picking, self._tab.selection.object
        for handle in (self._how, self._name, self._take):
            put(handle, visible=picking)
        if not picking:  # the next object has another name
            put(self._name, value="")
        doc = None if obj is None else obj.document
        put(self._back, visible=picking and doc is not None and doc.left_out is not None)
        ready = picking and doc is not None and doc.segmentation is not None
        put(self._take, disabled=not ready)
