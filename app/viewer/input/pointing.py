"""The pointer in the picture: clicks, boxes, strokes, and tools that ask for places or parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import viser

from app.server.open_object import OpenObject
from app.server.page import (
    ArtiworldAnswerMessage,
    ArtiworldHoverMessage,
    ArtiworldStrokeMessage,
    ArtiworldToolMessage,
    set_page_state,
)
from app.server.segmenting_tasks import Shape
from app.server.tool_tasks import ToolRequest
from app.viewer.input.queries import Hover, Point, PointerQueries, Tools
from app.viewer.input.views import Measuring
from app.viewer.picture.motion import Motion
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.tab import AT_REST, Step, Tab, percent
from app.viewer.words import annotate as words
from app.viewer.words import joints as joint_words
from app.viewer.words import prepare as prepare_words
from app.viewer.words.common import NO_JOINTS
from app.viewer.words.review import HINT_PIN
from model.geometry.picking import Camera, Stroke
from model.segmentation.prompts import Click
from sessions import commands as cmd

Armed = Literal[
    "", "cut", "rectangle", "merge", "measure", "parent", "comment", "floor", "edge", "length"
]
Tool = Literal["click", "lasso", "brush"]
_CUTS = {"cut": words.CUT, "rectangle": words.CUT_RECTANGLE}
_STEPS: Final = {"previous": -1, "next": 1}
"""Arrow keys while what a tool found waits → the step to another piece."""
_EVERYWHERE: Final = ("measure", "parent", "comment")
"""Tools that are also available in steps in which parts move."""
_PLACES: Final = {"floor": 3, "edge": 2, "length": 2}
"""Tool of the prepare step → its number of places."""
_IN_VAIN = 2
"""Clicks that brought hardly anything, after which other tools are pointed to."""
_FACE_APART = 0.02
"""Share of the object's diagonal: clicks that are nearer mean the same place."""


def shares_face(click: Click, earlier: list[Click], apart: float) -> bool:
    """True if an earlier click elsewhere on the clicked face gives it another label.

    Args:
        apart: metres; nearer clicks are about the same place.
    """
    return any(
        e.element == click.element
        and (e.part, e.positive) != (click.part, click.positive)
        and (e.positive or click.positive)
        and float(np.linalg.norm(np.subtract(e.position, click.position))) > apart
        for e in earlier
        if e.element is not None
    )


@dataclass(frozen=True)
class PointerActions:
    """Callbacks of the pointer and of the page's own keys.

    Attributes:
        show_keys, show_messages: show the sheet of keys, and of the latest messages.
        answer: gets the digit that was pressed together with Shift.
        dismiss: closes what Escape closes; whether anything was open.
        withdraw: takes back an acceptance that waits.
        parent_chosen: gets the child link of a joint, and the link that is to carry it.
        places_chosen: gets what was asked for in the prepare step, and its places.
        click_comment: gets a ray; whether it hit the marker of a comment.
        comment_placed: gets the place that a comment is about.
        click_scene: gets a ray's origin and direction while the whole scene is shown; else False.
    """

    show_keys: Callable[[], None]
    show_messages: Callable[[], None]
    name_by_key: Callable[[int], None]
    dismiss: Callable[[], bool]
    withdraw: Callable[[], None]
    click_scene: Callable[[Point, Point], bool]
    places_chosen: Callable[[str, tuple[Point, ...]], None]
    parent_chosen: Callable[[str, str], None]
    click_comment: Callable[[Point, Point], bool]
    comment_placed: Callable[[Point], None]


class Pointing:
    """Meaning of clicks and drags in the picture.

    Attributes:
        armed: "cut" waits for places along a cut, "rectangle" for two corners, "merge" for a part,
            "measure" for the ends of a distance, "parent" for the part that carries the selected
            joint, "comment" for the place of a comment, "floor", "edge" and "length" for places of
            those; "" for nothing.
        tool: what a drag draws.
        hover: the preview of a click.
        tools: that change the selected part.
    """

    def __init__(
        self, tab: Tab, picture: ObjectPicture, motion: Motion, queries: PointerQueries
    ) -> None:
        self._tab, self._picture, self._motion, self._queries = tab, picture, motion, queries
        self._selection = tab.selection
        self.armed: Armed = ""
        self.tool: Tool = "click"
        self.hover = Hover(tab, picture, queries, self._clicking)
        self.tools = Tools(tab, self._tool_begins, picture)
        self._measuring = Measuring(tab, picture)
        self._places: list[tuple[Point, int]] = []
        self._shifted = False
        self._frame: dict[str, Point] | None = None
        self._sent: dict[str, Any] = {}
        self._actions: PointerActions | None = None
        tab.selection.on_open(self.begin)
        tab.selection.on_step(self._step_begins)

    def _tool_begins(self) -> None:
        self.tools.drop()
        self.hover.forget()

    def _clicking(self) -> bool:
        """True while a click would be a prompt."""
        idle = not self.armed and not self.tools.finds
        return self._selection.step == "Annotate" and idle and self.tool == "click"

    def _step_begins(self, step: Step) -> None:
        if step != self._selection.step:
            self.disarm()

    def listen(self, actions: PointerActions) -> None:
        """Subscribe to the messages of the browser."""
        self._actions = actions
        tab, scene = self._tab, self._tab.client.scene

        @scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            self.clicked(event, True)

        @scene.on_click(modifier="shift")
        def _(event: viser.SceneClickEvent) -> None:
            self.clicked(event, False)

        @scene.on_rect_select(modifier="alt")
        def _(event: viser.SceneRectSelectEvent) -> None:
            camera = self._queries.camera()
            tab.act(lambda: self._box_drawn(event.screen_min, event.screen_max, camera, True))

        @scene.on_rect_select(modifier="alt+shift")
        def _(event: viser.SceneRectSelectEvent) -> None:
            camera = self._queries.camera()
            tab.act(lambda: self._box_drawn(event.screen_min, event.screen_max, camera, False))

        endpoint = tab.client._websock_connection
        endpoint.register_handler(ArtiworldHoverMessage, lambda _, m: self.hover.moved(m))
        endpoint.register_handler(ArtiworldStrokeMessage, lambda _, m: self._stroked(m))
        endpoint.register_handler(ArtiworldToolMessage, lambda _, m: self._tool_key(m.tool))
        endpoint.register_handler(
            ArtiworldAnswerMessage, lambda _, m: tab.act(lambda: actions.name_by_key(int(m.number)))
        )

    def begin(self, *, same: bool = False) -> None:
        """Another object: nothing is armed, nothing is previewed.

        Args:
            same: it is the same one with other faces; a tool stays armed.
        """
        self._places, self._frame, self._shifted = [], None, False
        self._measuring.clear()
        if not same:
            self.armed = ""
        self._tool_begins()

    def close(self) -> None:
        """The tab is gone."""
        self.hover.close()

    # --- what the page shows

    def set_page_state(self) -> None:
        """Send the page's script the tool and the hint below the picture."""
        selection = self._selection
        drawing = selection.step in AT_REST and selection.object is not None
        asking = self.armed in _EVERYWHERE and selection.object is not None
        hint = self._hint() if drawing or asking else ""
        state = {
            "tool": self.tool,
            "drawing": drawing,
            "hover": drawing and self.hover.on and selection.step == "Annotate",
            "frame": self._frame if drawing and self.armed == "rectangle" else None,
            "finds": bool(self.tools.finds),
            "anchor": drawing and self.armed in _CUTS and bool(self._places),
            "hint": hint,
        }
        news = {k: v for k, v in state.items() if self._sent.get(k) != v}
        if news:
            self._sent = state
            set_page_state(self._tab.client, **news)

    def _hint(self) -> str:
        if self.tools.finds:
            return self.tools.hint
        if self.armed == "measure":
            return self._measuring.hint
        if self.armed == "parent":
            return joint_words.HINT_PARENT
        if self.armed == "comment":
            return HINT_PIN
        if self._selection.step == "Prepare":
            return prepare_words.HINTS.get(self.armed) or prepare_words.HINT_STROKES.get(
                self.tool, ""
            )
        if self.armed == "merge":
            return words.HINT_MERGE
        if self.armed == "cut":
            left = self._needed - len(self._places)
            return words.hint_points(left) if self._places else words.HINT_CUT
        if self.armed == "rectangle":
            return words.HINT_OPPOSITE if self._places else words.HINT_CORNER
        if self.tools.label:
            return words.hint_label(self.tools.label)
        return words.HINT_STROKES.get(self.tool) or self._mask_hint()

    def _mask_hint(self) -> str:
        """Which of the masks for the last click is shown, or what helps where clicks don't."""
        obj = self._selection.need_object()
        shown = obj.segmenting.mask_shown(obj.document, self._selection.part)
        if shown is not None:
            return words.hint_mask(shown.rank + 1, shown.total, percent(shown.share))
        last = obj.document.prompts[-1] if obj.document.prompts else None
        if obj.segmenting.ineffective_clicks >= _IN_VAIN and isinstance(last, Click):
            return words.HINT_INEFFECTIVE
        return ""

    # --- tools

    def set_tool(self, tool: Tool) -> None:
        """Set what a drag draws; the same tool again goes back to clicks."""
        self.tool = "click" if tool == self.tool else tool
        self.armed, self._places, self._shifted = "", [], False
        self._show_places()
        self._tab.invalidate()

    def _show_places(self) -> None:
        self._picture.overlays.show_places(tuple(p for p, _ in self._places))

    def arm(self, what: Armed) -> None:
        """Let the next clicks be places of a cut, or a part to merge."""
        step: Step = "Prepare" if what in _PLACES else "Annotate"
        if what not in _EVERYWHERE and self._selection.step != step:
            self._selection.set_step(step)
        self.armed = "" if what == self.armed else what
        self.tool, self._places, self._shifted = "click", [], False
        self._show_places()
        self._measuring.clear()
        self._tool_begins()
        self._tab.invalidate()

    def next_cut(self) -> None:
        """A cut along a line, then a rectangle, then none; of a scan floor and upright edge."""
        if self._selection.step == "Prepare":
            self.arm("edge" if self.armed in ("floor", "edge") else "floor")
        else:
            self.arm("rectangle" if self.armed in _CUTS else "cut")

    def disarm(self) -> None:
        """Back to plain clicks."""
        self.tools.drop()
        if self.armed or self.tool != "click":
            self.armed, self.tool, self._places, self._shifted = "", "click", [], False
            self._show_places()
            self._measuring.clear()
            self._tab.invalidate()

    def _tool_key(self, tool: str) -> None:
        actions, act = self._actions, self._tab.act
        assert actions is not None
        if tool == "help":
            act(actions.show_keys)
        elif tool == "messages":
            act(actions.show_messages)
        elif tool in _STEPS:
            act(lambda: self.tools.step(_STEPS[tool]))
        elif tool in ("click", "lasso", "brush"):
            # The page has switched already: that is no news for it.
            self._sent["tool"] = tool
            act(lambda: self._switch(tool, actions))  # type: ignore[arg-type]

    def _switch(self, tool: Tool, actions: PointerActions) -> None:
        ends = actions.dismiss()
        ends = (
            ends or bool(self.armed or self.tools.finds or self.tools.label) or self.tool != "click"
        )
        self.disarm()
        self.tool = tool
        if tool == "click":
            self.tools.forget_label()
        if tool == "click" and not ends:  # Escape, with nothing else to leave
            actions.withdraw()

    # --- clicks

    def clicked(self, event: Any, positive: bool) -> None:
        """Take a click's ray from the browser."""
        origin = tuple(float(v) for v in event.ray_origin)
        direction = tuple(float(v) for v in event.ray_direction)
        self._tab.act(lambda: self.click(origin, direction, positive))  # type: ignore[arg-type]

    def click(self, origin: Point, direction: Point, positive: bool) -> None:
        """A click in the picture: a prompt while annotating, else the choice of a joint."""
        selection = self._selection
        if self._actions is not None and self._actions.click_scene(origin, direction):
            return
        obj = selection.need_object()
        if obj.asset is None:
            return
        self.tools.drop()
        asked = self._actions
        if not self.armed and asked is not None and asked.click_comment(origin, direction):
            return
        if self.armed == "measure":
            if not self._measuring.click(origin, direction):
                self._tab.say(words.NOTHING_THERE)
            return
        if selection.step not in AT_REST and any(self._motion.q.values()):
            # What the workers pick from is at rest, which what is seen isn't.
            self._choose_joint_of(self._picture.parts.pick(origin, direction, selection.hidden))
            return
        now = self._situation()
        part = selection.part
        if selection.step == "Annotate" and self.armed not in (*_CUTS, "merge"):
            self.hover.forget()
            aim = self._queries.aim(origin, direction)
            name = self.tools.label if positive else ""
            asked = obj.segmenting.click(aim, part, positive, self._tab.user, name or None)
            self._queries.answer(asked, lambda click: self._prompted(click, now))
        else:
            self._queries.pick(
                obj.asset, origin, direction, lambda hit: self._hit(hit, now, direction, positive)
            )

    def _situation(self) -> tuple[Any, ...]:
        """Context of a click; its answer counts only while that stays the same."""
        selection = self._selection
        obj = selection.need_object()
        return obj, obj.asset, selection.step, self.armed

    def _is_still(self, situation: tuple[Any, ...]) -> bool:
        """True if an answer still belongs to the displayed state; else notify the user."""
        if self._selection.object is not None and self._situation() == situation:
            return True
        self._tab.notify(*words.CLICK_PASSED, "yellow")
        return False

    def _prompted(self, click: Click | None, situation: tuple[Any, ...]) -> None:
        """Say what became of a click. It counts for its object, wherever the person is by now."""
        obj, asset, *_ = situation
        if click is not None and obj.asset is asset:
            if asset.element_kind == "face":
                self._tell_of_shared_face(obj, click)
        elif self._is_still(situation):
            self._tab.say(words.NOTHING_THERE)

    def _hit(self, hit: Any, situation: tuple[Any, ...], direction: Point, positive: bool) -> None:
        """Take what a click hit."""
        _, _, step, armed = situation
        if not self._is_still(situation):
            return
        if hit is None:
            self._tab.say(words.NOTHING_THERE)
        elif armed == "comment":
            self.disarm()
            assert self._actions is not None
            self._actions.comment_placed(tuple(float(v) for v in hit.position))  # type: ignore[arg-type]
        elif step not in AT_REST:
            self._choose_joint_at(hit.element)
        else:
            self._use_at(hit, direction, positive)

    def _use_at(self, hit: Any, direction: Point, positive: bool) -> None:
        """Take a place that a tool waits for."""
        self.hover.forget()
        position = tuple(float(v) for v in hit.position)
        element = int(hit.element)
        if self._selection.step == "Prepare":
            self._place_chosen(position, element)  # type: ignore[arg-type]
        elif self.armed in _CUTS:
            self._cut_at(position, element, direction, positive)  # type: ignore[arg-type]
        else:
            self._merge_at(element)

    def _place_chosen(self, position: Point, element: int) -> None:
        """Take a place that the prepare step asked for."""
        if self.armed not in _PLACES or self._actions is None:
            return
        self._places.append((position, element))
        self._show_places()
        if len(self._places) == _PLACES[self.armed]:
            asked, places = self.armed, tuple(p for p, _ in self._places)
            self.disarm()
            self._actions.places_chosen(asked, places)

    def _choose_joint_at(self, element: int) -> None:
        """Choose the joint whose part holds an element of the source."""
        part = self._selection.need_object().part_of(element)
        if part is not None:
            self._choose_joint_of(part)

    def _choose_joint_of(self, part: int | None) -> None:
        """Select the joint that moves a part."""
        tree = self._selection.need_object().document.tree
        link, child = f"link_{part}", self._selection.child
        if self.armed == "parent" and part is not None and child is not None and self._actions:
            self.disarm()
            self._actions.parent_chosen(child, link)
            return
        if tree is None or part is None:
            self._tab.say(words.NOTHING_THERE if part is None else NO_JOINTS)
        elif link not in tree.joint_of:
            self._tab.say(words.BASE_IS_FIXED)
        else:
            self._selection.choose_joint(link)

    def _tell_of_shared_face(self, obj: OpenObject, click: Click) -> None:
        """Point to the cutting tools where two parts share one triangle."""
        clicks = [p for p in obj.document.prompts if isinstance(p, Click)]
        if shares_face(click, clicks, _FACE_APART * obj.need_asset().diagonal):
            self._tab.notify(*words.SHARED_TRIANGLE, "yellow")

    def _cut_at(self, position: Point, element: int, direction: Point, plain: bool) -> None:
        self._shifted = self._shifted or not plain
        self._places.append((position, element))
        self._show_places()
        if len(self._places) < self._needed:
            self._frame = self._rectangle_frame(position, direction)
            self._tab.invalidate()
            return
        places, self._places = self._places, []
        tool, exact, self._frame = self.armed, self._shifted, None
        self._shifted = False
        if tool == "cut":  # doors and drawers come in rows: the rectangle stays for the next one
            self.armed = ""
        self._show_places()
        request = ToolRequest(
            tool,
            self._selection.part,
            places=tuple(p for p, _ in places),
            element=places[0][1],
            view=direction,
            exact=exact,
        )
        self.tools.use(request, _CUTS[tool])
        self._tab.invalidate()

    def _rectangle_frame(self, corner: Point, view: Point) -> dict[str, Point] | None:
        """Frame for drawing the rectangle that the pointer spans, or None."""
        if self.armed != "rectangle":
            return None
        asset = self._selection.need_object().need_asset()
        found = self._queries.rectangle_frame(asset, corner, view)
        if found is None:
            return None  # the workers are busy: the cut itself can wait for them
        return {"corner": corner, "out": found[0], "across": found[1]}

    @property
    def _needed(self) -> int:
        """Places that the cut takes."""
        return 3 if self.armed == "cut" and self._shifted else 2

    def _merge_at(self, element: int) -> None:
        self.armed = ""
        part = self._selection.need_object().part_of(element)
        if part is not None:
            self.merge(part)
        else:
            self._tab.notify(words.MERGE, words.NO_PARTS, "gray")

    def merge(self, other: int) -> None:
        """Join part ``other`` to the selected one."""
        self.armed = ""
        request = ToolRequest("merge", self._selection.part, other=other)
        self.tools.use(request, words.merge_with(other))

    # --- boxes and strokes

    def _box_drawn(self, low: Any, high: Any, camera: Camera, positive: bool) -> None:
        one_piece = positive and self._selection.picking
        self._drawn(camera, (low, high), positive, "box", one_piece=one_piece)

    def _stroked(self, message: ArtiworldStrokeMessage) -> None:
        camera = self._queries.camera()
        self._tab.act(lambda: self._stroke_drawn(message, camera))

    def _stroke_drawn(self, message: ArtiworldStrokeMessage, camera: Camera) -> None:
        stroke = Stroke(message.tool, message.path, message.radius)  # type: ignore[arg-type]
        self._drawn(camera, stroke, message.positive, stroke.kind)

    def _drawn(
        self, camera: Camera, shape: Shape, positive: bool, tool: str, *, one_piece: bool = False
    ) -> None:
        """Add everything visible in a shape to the selected part, or remove it."""
        selection = self._selection
        obj = selection.need_object()
        if obj.asset is None or selection.step not in AT_REST:
            return
        if selection.step == "Prepare" and not positive:
            obj.preparing.restore(camera, shape, self._tab.user)
            return
        now, part = self._situation(), selection.part
        self._queries.within(
            obj.asset,
            camera,
            shape,
            lambda ref, count: self._selected(now, part, ref, count, positive, tool),
            one_piece=one_piece,
        )

    def _selected(
        self, situation: tuple[Any, ...], part: int, ref: str, count: int, positive: bool, tool: str
    ) -> None:
        """Take what is in a box or under a stroke, for the object and part that were meant."""
        obj, asset, step, _ = situation
        if obj.asset is not asset:
            self._tab.notify(*words.CLICK_PASSED, "yellow")
            return
        if not count:
            self._tab.notify(*words.nothing_under(tool), "gray")
            return
        self.hover.forget()
        if step == "Prepare":
            obj.preparing.remove(ref, prepare_words.by_hand(tool), self._tab.user)
            return
        if positive and part == self._selection.part and self.tools.label:
            obj.do(cmd.AddPart(part, self.tools.label), self._tab.user)
        obj.do(cmd.AddRegion(part, ref, positive, count, tool), self._tab.user)
