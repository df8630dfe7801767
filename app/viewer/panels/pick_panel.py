"""Taking an object out of the one that is open in the scene, such as a whole room."""

from __future__ import annotations

from collections.abc import Callable

import viser

from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.words import scene as words
from sessions import commands as cmd


class PickPanel:
    """Above the usual tools while an object of the scene is there to be picked from."""

    def __init__(self, tab: Tab, take_out: Callable[[str], None]) -> None:
        """Make the widgets; ``take_out`` gets the new object's name."""
        self._tab = tab
        gui = tab.client.gui
        self._how = gui.add_markdown(words.EXTRACT_HELP, visible=False)
        self._back = gui.add_button(
            words.RESTORE_ROOM, color="gray", visible=False,
            hint=words.RESTORE_ROOM_HINT,
        )  # fmt: skip
        self._name = gui.add_text(words.OBJECT_NAME, "", hint=words.OBJECT_NAME_HINT, visible=False)
        self._take = gui.add_button(
            words.EXTRACT, icon=viser.Icon.SCISSORS, color="green", visible=False
        )
        self._back.on_click(lambda _: tab.act(lambda: tab.do(cmd.LeaveOut(None))))
        self._take.on_click(lambda _: tab.act(lambda: take_out(self._name.value)))

    def draw(self) -> None:
        """Bring it up to date."""
        picking, obj = self._tab.selection.picking, self._tab.selection.object
        for handle in (self._how, self._name, self._take):
            put(handle, "visible", picking)
        if not picking:  # the next object has another name
            put(self._name, "value", "")
        doc = None if obj is None else obj.document
        put(self._back, "visible", picking and doc is not None and doc.left_out is not None)
        ready = picking and doc is not None and doc.segmentation is not None
        put(self._take, "disabled", not ready)
