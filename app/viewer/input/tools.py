"""Tools that change the selected part."""

from __future__ import annotations

from collections.abc import Callable

from app.server.tool_tasks import NEXT_MASK, ToolRequest
from app.viewer.tab import Tab
from app.viewer.text import percent
from app.viewer.words import annotate as words
from model.core.progress import Cancelled
from sessions.document import RegionRef

_NEW_PARTS = ("same shape", "mirror", "propose", "split")


class Tools:
    """Runs tools for one tab.

    Args:
        begins: called before a tool works.
    """

    def __init__(self, tab: Tab, begins: Callable[[], None]) -> None:
        self._tab, self._begins = tab, begins

    def next_mask(self, step: int) -> None:
        """Take another mask for the last click: the next one, or with -1 the one before."""
        self.use(ToolRequest(NEXT_MASK, self._tab.selection.part, step), words.NEXT)

    def use(self, request: ToolRequest, label: str) -> None:
        """Run a tool and show its result."""
        tab, selection = self._tab, self._tab.selection
        self._begins()
        obj = selection.need_object()
        before = {p.part for p in obj.document.prompts}
        try:
            found = obj.segmenting.use_tool(request, tab.user)
        except Cancelled:
            tab.notify(label, words.CANCELLED, "gray")
            return
        cut_off = {p.part for p in obj.document.prompts} - before
        if request.tool in ("cut", "rectangle") and cut_off and not selection.picking:
            selection.choose_part(min(cut_off))  # what is named next is what was cut off
        if not found:
            tab.notify(label, words.NOTHING_FOUND.get(request.tool, words.NO_CHANGE), "gray")
        elif request.tool in _NEW_PARTS:
            tab.notify(label, words.found(found), "green")
        elif request.tool == "connected":
            self._say_connected()

    def _say_connected(self) -> None:
        """Show how much the last prompt added."""
        obj = self._tab.selection.need_object()
        asset, last = obj.need_asset(), obj.document.prompts[-1]
        if isinstance(last, RegionRef):
            share = percent(last.count / asset.element_count)
            self._tab.say(words.connected(last.count, asset.element_kind, share))
