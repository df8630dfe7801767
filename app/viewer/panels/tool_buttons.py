"""The tools' buttons, and the switch of the preview."""

from __future__ import annotations

from app.server.tool_tasks import NEXT_MASK, ToolRequest
from app.viewer.input.pointing import Pointing
from app.viewer.tab import Tab
from app.viewer.words import annotate as words

_TOOLS = {label: tool for row in words.TOOL_ROWS for label, tool in row.tools.items()}


class ToolButtons:
    """A row of buttons for each kind of tool.

    Attributes:
        touch: whether taps add clicks.
    """

    def __init__(self, tab: Tab, pointing: Pointing) -> None:
        self._tab, self._pointing = tab, pointing
        gui = tab.client.gui
        self.touch = False
        with gui.add_folder(words.TOOLS):
            rows = [
                gui.add_button_group(row.label, tuple(row.tools), hint=row.hint)
                for row in words.TOOL_ROWS
            ]
            self._preview = gui.add_checkbox(words.PREVIEW, True, hint=words.PREVIEW_HINT)
            touch = gui.add_checkbox(words.TOUCH, False, hint=words.TOUCH_HINT)
        for row in rows:
            row.on_click(lambda e: tab.act(lambda: self.use(e.target.value)))
        tab.on_update(self._preview, self._preview_set)
        tab.on_update(touch, lambda: setattr(self, "touch", touch.value))

    def use(self, label: str) -> None:
        """Start the tool of a button on the selected part."""
        selection, pointing = self._tab.selection, self._pointing
        if selection.step != "Annotate":
            selection.set_step("Annotate")
        tool = _TOOLS[label]
        if tool in ("lasso", "brush"):
            pointing.set_tool(tool)  # type: ignore[arg-type]
        elif tool in ("merge", "rectangle", "cut"):
            pointing.arm(tool)  # type: ignore[arg-type]
        elif tool == NEXT_MASK:
            pointing.tools.next_mask(1)
        else:
            pointing.tools.use(ToolRequest(tool, selection.part), label)

    def toggle_preview(self) -> None:
        """Switch the preview under the pointer on or off."""
        self._preview.value = not self._preview.value
        self._preview_set()

    def _preview_set(self) -> None:
        self._pointing.hover.on = self._preview.value
        self._pointing.hover.forget()
        self._tab.invalidate()
