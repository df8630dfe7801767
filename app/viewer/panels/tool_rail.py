"""The rail of icons beside the picture: undo, motion, and the tools of the annotate step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import viser

from app.server.open_object import OpenObject
from app.server.tool_tasks import NEXT_MASK, ToolRequest
from app.viewer.input.pointing import Pointing
from app.viewer.panels.markup import Place, Presses, button, icon
from app.viewer.tab import AT_REST, Tab
from app.viewer.words import annotate as words
from app.viewer.words import common, view
from app.viewer.words.tour import TOUR, TOUR_TIP

_TOOLS = {label: tool for row in words.TOOL_ROWS for tool, label in row.items()}
_ICONS: Final[dict[str, Any]] = {
    "lasso": viser.Icon.LASSO,
    "brush": viser.Icon.BRUSH,
    "cut": viser.Icon.SLICE,
    "rectangle": viser.Icon.MARQUEE_2,
    NEXT_MASK: viser.Icon.LAYERS_DIFFERENCE,
    "connected": viser.Icon.AFFILIATE,
    "grow": viser.Icon.CIRCLE_PLUS,
    "shrink": viser.Icon.CIRCLE_MINUS,
    "same shape": viser.Icon.COPY,
    "mirror": viser.Icon.FLIP_VERTICAL,
    "propose": viser.Icon.SPARKLES,
    "merge": viser.Icon.ARROWS_JOIN,
    "split": viser.Icon.ARROWS_SPLIT,
    "leftovers": viser.Icon.PUZZLE,
}


@dataclass(frozen=True)
class RailActions:
    """Callbacks of the icons that every step has."""

    undo: Callable[[], None]
    redo: Callable[[], None]
    play: Callable[[], None]
    reset_pose: Callable[[], None]
    show_keys: Callable[[], None]
    tour: Callable[[], None]
    isolate: Callable[[], None]


class ToolRail:
    """Icons that name themselves and their key under the pointer.

    Attributes:
        touch: whether taps add clicks.
    """

    def __init__(
        self, tab: Tab, presses: Presses, pointing: Pointing, actions: RailActions
    ) -> None:
        self._tab, self._pointing = tab, pointing
        self._place = Place(tab, "tools")
        self.touch = False
        self._view: dict[str, Callable[[], None]] = {
            common.HISTORY_ACTIONS[0]: actions.undo,
            common.HISTORY_ACTIONS[1]: actions.redo,
            common.PLAY: actions.play,
            common.RESET_POSE: actions.reset_pose,
            common.KEYS_BUTTON: actions.show_keys,
            TOUR: actions.tour,
            view.MEASURE: lambda: pointing.arm("measure"),
            view.ISOLATE: actions.isolate,
            words.PREVIEW: self.toggle_preview,
            words.TOUCH: self._toggle_touch,
        }
        presses.on("tool", self.use)
        presses.on("mask", lambda step: self._turn(int(step)))
        presses.on("view", lambda label: self._view[label]())

    def use(self, label: str) -> None:
        """Start the tool of an icon on the selected part."""
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

    def _turn(self, step: int) -> None:
        """Take a larger mask (1) or a smaller one (-1): Alt and the wheel."""
        if self._tab.selection.object is not None and self._tab.selection.step == "Annotate":
            self._pointing.tools.next_mask(step)

    def toggle_preview(self) -> None:
        """Switch the preview under the pointer on or off."""
        hover = self._pointing.hover
        hover.on = not hover.on
        hover.forget()
        self._tab.invalidate()

    def _toggle_touch(self) -> None:
        self.touch = not self.touch

    def draw(self, obj: OpenObject | None) -> None:
        """Bring the icons up to date; there are none where nothing is open."""
        if obj is None or obj.problem is not None:
            self._place.show("")
            return
        step, moves = self._tab.selection.step, obj.document.tree is not None
        groups = [[
            _view(common.HISTORY_ACTIONS[0], viser.Icon.ARROW_BACK_UP, common.UNDO_TIP),
            _view(common.HISTORY_ACTIONS[1], viser.Icon.ARROW_FORWARD_UP, common.REDO_TIP),
        ]]  # fmt: skip
        if moves and step not in AT_REST:
            groups.append([
                _view(common.PLAY, viser.Icon.PLAYER_PLAY),
                _view(common.RESET_POSE, viser.Icon.REFRESH),
            ])  # fmt: skip
        if step == "Annotate":
            groups += [
                [self._tool(label, tool) for tool, label in row.items()] for row in words.TOOL_ROWS
            ]
            on = self._pointing.hover.on
            groups.append([
                _view(words.PREVIEW, viser.Icon.EYE, words.PREVIEW_HINT, on),
                _view(words.TOUCH, viser.Icon.HAND_FINGER, words.TOUCH_HINT, self.touch),
            ])  # fmt: skip
        if step != "Prepare":
            alone = bool(self._tab.selection.hidden)
            measuring = self._pointing.armed == "measure"
            groups.append([
                _view(view.MEASURE, viser.Icon.RULER_2, view.MEASURE_TIP, measuring),
                _view(view.ISOLATE, viser.Icon.FOCUS_2, view.ISOLATE_TIP, alone),
            ])  # fmt: skip
        groups.append([
            _view(common.KEYS_BUTTON, viser.Icon.KEYBOARD),
            _view(TOUR, viser.Icon.SCHOOL, TOUR_TIP),
        ])  # fmt: skip
        self._place.show("".join(f'<div class="aw-group">{"".join(g)}</div>' for g in groups))

    def _tool(self, label: str, tool: str) -> str:
        now = tool in (self._pointing.tool, self._pointing.armed)
        return button(
            "tool", label, label, content=icon(_ICONS[tool]), tip=words.TOOL_TIPS[tool],
            pressed=now if tool in ("lasso", "brush", "cut", "rectangle", "merge") else None,
        )  # fmt: skip


def _view(label: str, picture: Any, tip: str = "", pressed: bool | None = None) -> str:
    return button("view", label, label, content=icon(picture), tip=tip or label, pressed=pressed)
