"""Taking an object out of the one that is open in the scene, such as a whole room."""

from __future__ import annotations

from collections.abc import Callable

import viser

from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from sessions import commands as cmd

_HOW = (
    "**Pick an object out:** click it, once more where something is missing, Shift+click what is "
    "too much; or Alt+drag a box round it. Then say what it is and take it out."
)


class PickPanel:
    """Above the usual tools while an object of the scene is there to be picked from."""

    def __init__(self, tab: Tab, take_out: Callable[[str], None]) -> None:
        """Make the widgets; ``take_out`` gets the new object's name."""
        self._tab = tab
        gui = tab.client.gui
        self._how = gui.add_markdown(_HOW, visible=False)
        self._back = gui.add_button(
            "Put floor and walls back", color="gray", visible=False,
            hint="They are left out while you pick; doors and windows may be among them",
        )  # fmt: skip
        self._name = gui.add_text(
            "It is a", "", hint="refrigerator, cabinet, oven, …", visible=False
        )
        self._take = gui.add_button(
            "Take it out of the room", icon=viser.Icon.SCISSORS, color="green", visible=False
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
