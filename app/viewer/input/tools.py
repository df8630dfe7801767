"""Tools that work on the chosen part, and what is said of their results."""

from __future__ import annotations

from collections.abc import Callable

from app.server.tool_tasks import NEXT_MASK, ToolRequest
from app.viewer.tab import Tab
from app.viewer.text import percent
from model.core.progress import Cancelled
from sessions.document import RegionRef

_NEW_PARTS = ("same shape", "mirror", "propose", "split")
_NOTHING = {
    "split": "The part is one piece",
    "same shape": "Nothing else looks like this part",
    "leftovers": "There are no crumbs",
    "mirror": "Nothing lies on the other side, or it is a part already",
    "propose": "Nothing more shows by itself: click on a part",
    NEXT_MASK: "There is no other mask: click on the part first",
    "merge": "That is the chosen part itself: choose the part to keep, then click the other",
}


class Tools:
    """Runs tools for one tab.

    Args:
        begins: called before a tool works.
    """

    def __init__(self, tab: Tab, begins: Callable[[], None]) -> None:
        self._tab, self._begins = tab, begins

    def next_mask(self, step: int) -> None:
        """Take another mask for the last click: the next one, or with -1 the one before."""
        self.use(ToolRequest(NEXT_MASK, self._tab.selection.part, step), "Next mask")

    def use(self, request: ToolRequest, label: str) -> None:
        """Let a tool work, and say what came of it."""
        tab, selection = self._tab, self._tab.selection
        self._begins()
        obj = selection.need_object()
        before = {p.part for p in obj.document.prompts}
        try:
            found = obj.segmenting.use_tool(request, tab.user)
        except Cancelled:
            tab.notify(label, "Cancelled: nothing was changed", "gray")
            return
        cut_off = {p.part for p in obj.document.prompts} - before
        if request.tool in ("cut", "rectangle") and cut_off and not selection.picking:
            selection.choose_part(min(cut_off))  # what is named next is what was cut off
        if not found:
            tab.notify(label, _NOTHING.get(request.tool, "It found nothing to change"), "gray")
        elif request.tool in _NEW_PARTS:
            tab.notify(label, f"{found} new part{'s'[: found != 1]}; undo takes them back", "green")
        elif request.tool == "connected":
            self._say_connected()

    def _say_connected(self) -> None:
        """Say below the picture how much joined the part with the last prompt."""
        obj = self._tab.selection.need_object()
        asset, last = obj.need_asset(), obj.document.prompts[-1]
        if isinstance(last, RegionRef):
            share = percent(last.count / asset.element_count)
            kind = f"{asset.element_kind}{'s'[: last.count != 1]}"
            self._tab.say(f"Took what is connected: {last.count:,} {kind}, {share} of all")
