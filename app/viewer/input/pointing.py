"""The pointer in the picture: clicks, boxes, strokes, and tools that ask for places or parts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import viser

from app.server import picking_tasks, tool_tasks
from app.server.pointer_messages import (
    ArtiworldAnswerMessage,
    ArtiworldHoverMessage,
    ArtiworldStrokeMessage,
    ArtiworldToolMessage,
    tell_page,
)
from app.viewer.input.hover import Hover
from model.geometry.picking import Camera
from model.geometry.strokes import Stroke
from model.segmentation.prompts import Click
from sessions import commands as cmd

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

PICK_SECONDS = 30.0
FRAME_SECONDS = 5.0
Point = tuple[float, float, float]
Armed = Literal["", "cut", "rectangle", "merge"]
Tool = Literal["click", "lasso", "brush"]
_CUTS = {"cut": "Cut", "rectangle": "Cut a rectangle"}
_STROKE_HINTS = {
    "lasso": "Lasso: draw round what joins the part · Shift takes away · Esc ends",
    "brush": "Brush: paint what joins the part · Shift takes away · [ ] size · Esc ends",
}


_IN_VAIN = 2
"""Clicks that brought hardly anything, after which other tools are pointed to."""
_FACE_APART = 0.02
"""Of the object's diagonal: clicks that are nearer mean the same place."""


def shares_face(click: Click, earlier: list[Click], apart: float) -> bool:
    """Whether an earlier click elsewhere on the clicked face says something else of it.

    Args:
        apart: metres; nearer clicks say it of the same place.
    """
    return any(
        e.element == click.element
        and (e.part, e.positive) != (click.part, click.positive)
        and (e.positive or click.positive)
        and float(np.linalg.norm(np.subtract(e.position, click.position))) > apart
        for e in earlier
        if e.element is not None
    )


class Pointing:
    """What a click or a drag in the picture means now.

    Attributes:
        armed: "cut" waits for places along a cut, "rectangle" for two corners, "merge" for a part;
            "" for nothing.
        tool: what a drag draws.
    """

    def __init__(self, app: ClientApp) -> None:
        self._app = app
        self.armed: Armed = ""
        self.tool: Tool = "click"
        self.hover = Hover(app)
        self._places: list[tuple[Point, int]] = []
        self._shifted = False
        self._frame: dict[str, Point] | None = None
        self._told: dict[str, Any] = {}

    def listen(self) -> None:
        """Hear what the browser sends."""
        app, scene = self._app, self._app.client.scene

        @scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            self.clicked(event, True)

        @scene.on_click(modifier="shift")
        def _(event: viser.SceneClickEvent) -> None:
            self.clicked(event, False)

        @scene.on_rect_select(modifier="alt")
        def _(event: viser.SceneRectSelectEvent) -> None:
            camera = self.camera()
            app.act(lambda: self.box_select(event.screen_min, event.screen_max, camera, True))

        @scene.on_rect_select(modifier="alt+shift")
        def _(event: viser.SceneRectSelectEvent) -> None:
            camera = self.camera()
            app.act(lambda: self.box_select(event.screen_min, event.screen_max, camera, False))

        endpoint = app.client._websock_connection
        endpoint.register_handler(ArtiworldHoverMessage, lambda _, m: self.hover.moved(m))
        endpoint.register_handler(ArtiworldStrokeMessage, lambda _, m: self._stroked(m))
        endpoint.register_handler(ArtiworldToolMessage, lambda _, m: self._tool_key(m.tool))
        endpoint.register_handler(
            ArtiworldAnswerMessage, lambda _, m: app.act(lambda: app.commands.answer(int(m.number)))
        )

    def begin(self, *, same: bool = False) -> None:
        """Another object: nothing is armed, nothing is previewed.

        Args:
            same: it is the same one with other faces; a tool stays armed.
        """
        self._places, self._frame, self._shifted = [], None, False
        if not same:
            self.armed = ""
        self.hover.forget()

    def close(self) -> None:
        """The tab is gone."""
        self.hover.close()

    # --- what the page shows

    def tell_page(self) -> None:
        """Let the page's script know what a drag means, and what to write below the picture."""
        app = self._app
        drawing = app.stage == "Annotate" and app.object is not None
        hint = self._hint() if drawing else ""
        state = {
            "tool": self.tool,
            "drawing": drawing,
            "hover": drawing and self.hover.on,
            "frame": self._frame if drawing and self.armed == "rectangle" else None,
            "anchor": drawing and self.armed in _CUTS and bool(self._places),
            "hint": hint,
        }
        news = {k: v for k, v in state.items() if self._told.get(k) != v}
        if news:
            self._told = state
            tell_page(app.client, **news)

    def _hint(self) -> str:
        if self.armed == "merge":
            return "Merge: click the part that joins the chosen one · Esc ends"
        if self.armed == "cut":
            if not self._places:
                return (
                    "Cut: click where the cut begins (Shift+click: through three places) · "
                    "K again: a rectangle · Esc ends"
                )
            left = self._needed - len(self._places)
            return f"Cut: {left} more place{'s'[: left != 1]} · Esc ends"
        if self.armed == "rectangle":
            if not self._places:
                return "Cut a rectangle: click one corner of a door or drawer · Esc ends"
            return "Cut a rectangle: click the opposite corner (Shift: don't snap) · Esc ends"
        return _STROKE_HINTS.get(self.tool) or self._mask_hint()

    def _mask_hint(self) -> str:
        """Which of the masks for the last click is shown, or what helps where clicks don't."""
        app = self._app
        obj = app.need_object()
        shown = obj.segmenting.mask_shown(obj.document, app.part)
        if shown is not None:
            return f"Mask {shown.number + 1} of {shown.total} · Tab: the next one · Shift+Tab: back"
        last = obj.document.prompts[-1] if obj.document.prompts else None
        if obj.segmenting.in_vain >= _IN_VAIN and isinstance(last, Click):
            return "Clicks change little here · Tab: another mask · L: draw it · K: cut it off"
        return ""

    # --- tools

    def set_tool(self, tool: Tool) -> None:
        """What a drag draws; the same tool again goes back to clicks."""
        self.tool = "click" if tool == self.tool else tool
        self.armed, self._places, self._shifted = "", [], False
        self._app.scene.overlays.show_places(())
        self._app.invalidate()

    def arm(self, what: Armed) -> None:
        """Let the next clicks be places of a cut, or a part to merge."""
        app = self._app
        if app.stage != "Annotate":
            app.set_stage("Annotate")
        self.armed = "" if what == self.armed else what
        self.tool, self._places, self._shifted = "click", [], False
        app.scene.overlays.show_places(())
        self.hover.forget()
        app.invalidate()

    def next_cut(self) -> None:
        """A cut along a line, then a rectangle, then none."""
        self.arm("rectangle" if self.armed in _CUTS else "cut")

    def disarm(self) -> None:
        """Back to plain clicks."""
        if self.armed or self.tool != "click":
            self.armed, self.tool, self._places, self._shifted = "", "click", [], False
            self._app.scene.overlays.show_places(())
            self._app.invalidate()

    def _tool_key(self, tool: str) -> None:
        app = self._app
        if tool == "help":
            app.act(app.commands.show_keys)
        elif tool in ("click", "lasso", "brush"):
            # The page has switched already: that is no news for it.
            self._told["tool"] = tool

            def switch() -> None:
                ends = app.rejecting.asking or bool(self.armed) or self.tool != "click"
                ends = app.commands.close_keys() or ends
                app.rejecting.cancel()
                self.disarm()
                self.tool = tool  # type: ignore[assignment]
                if tool == "click" and not ends:  # Escape, with nothing else to leave
                    app.commands.take_back()

            app.act(switch)

    # --- clicks

    def clicked(self, event: Any, positive: bool) -> None:
        """A click's ray came from the browser."""
        origin = tuple(float(v) for v in event.ray_origin)
        direction = tuple(float(v) for v in event.ray_direction)
        self._app.act(lambda: self.click(origin, direction, positive))  # type: ignore[arg-type]

    def click(self, origin: Point, direction: Point, positive: bool) -> None:
        """A click in the picture: a prompt while annotating, else the choice of a joint."""
        app = self._app
        if app.overview is not None:
            app.overview.click(origin, direction)
            return
        obj = app.need_object()
        if obj.asset is None:
            return
        if app.stage != "Annotate" and any(app.motion.q.values()):
            # What the workers pick from is at rest, which what is seen isn't.
            part = app.scene.parts.pick(origin, direction, app.hidden)
            app.commands.choose_joint_of(part)
            return
        hit = app.app_state.workers.geometry.submit(
            picking_tasks.pick,
            obj.asset.folder,
            origin,
            direction,
            self.hidden_now(),
            priority=20,
        ).result(PICK_SECONDS)
        if hit is None:
            tell_page(app.client, said="Nothing there")
            return
        if app.stage != "Annotate":
            app.commands.choose_joint_at(hit.element)
            return
        self.hover.forget()
        position = tuple(float(v) for v in hit.position)
        element = int(hit.element)
        if self.armed in _CUTS:
            self._cut_at(position, element, direction, positive)  # type: ignore[arg-type]
        elif self.armed == "merge":
            self._merge_at(element)
        else:
            click = Click(position, app.part, positive, element)  # type: ignore[arg-type]
            if obj.asset.element_kind == "face":
                self._tell_of_shared_face(click, _FACE_APART * obj.asset.diagonal)
            app.do(cmd.AddClick(click))

    def _tell_of_shared_face(self, click: Click, apart: float) -> None:
        """A triangle is all one part: who clicks it for two wants it cut."""
        prompts = self._app.need_object().document.prompts
        if shares_face(click, [p for p in prompts if isinstance(p, Click)], apart):
            self._app.notify(
                "One triangle holds both clicks",
                "It goes with the last one. To cut it along the border: K for a straight line, "
                "K twice for a rectangle",
                "yellow",
            )

    def _cut_at(self, position: Point, element: int, direction: Point, plain: bool) -> None:
        app = self._app
        self._shifted = self._shifted or not plain
        self._places.append((position, element))
        app.scene.overlays.show_places(tuple(p for p, _ in self._places))
        if len(self._places) < self._needed:
            self._frame = self._rectangle_frame(position, direction)
            app.invalidate()
            return
        places, self._places = self._places, []
        tool, exact, self._frame = self.armed, self._shifted, None
        self._shifted = False
        if tool == "cut":  # doors and drawers come in rows: the rectangle stays for the next one
            self.armed = ""
        app.scene.overlays.show_places(())
        request = tool_tasks.ToolRequest(
            tool,
            app.part,
            places=tuple(p for p, _ in places),
            element=places[0][1],
            view=direction,
            exact=exact,
        )
        app.annotate_panel.use(request, _CUTS[tool])
        app.invalidate()

    def _rectangle_frame(self, corner: Point, view: Point) -> dict[str, Point] | None:
        """What the page needs to draw the rectangle that the pointer spans."""
        if self.armed != "rectangle":
            return None
        app_state, asset = self._app.app_state, self._app.need_object().need_asset()
        try:
            out, across = app_state.workers.segmentation.submit(
                tool_tasks.frame_at, asset.folder, corner, view, priority=15, works_on=asset.folder
            ).result(FRAME_SECONDS)
        except TimeoutError:
            return None  # the workers are busy: the cut itself can wait for them
        return {"corner": corner, "out": out, "across": across}

    @property
    def _needed(self) -> int:
        """Places that the cut takes."""
        return 3 if self.armed == "cut" and self._shifted else 2

    def _merge_at(self, element: int) -> None:
        self.armed = ""
        part = self._app.need_object().part_of(element)
        if part is not None:
            self.merge(part)
        else:
            self._app.notify("Merge", "There are no parts yet: click on one first", "gray")

    def merge(self, other: int) -> None:
        """Part ``other`` joins the chosen one."""
        self.armed = ""
        app = self._app
        app.annotate_panel.use(
            tool_tasks.ToolRequest("merge", app.part, other=other), f"Merge with part {other}"
        )

    # --- boxes and strokes

    def box_select(self, low: Any, high: Any, camera: Camera, positive: bool) -> None:
        """Everything visible in a rectangle goes to the chosen part."""
        app = self._app
        obj = app.need_object()
        if obj.asset is None or app.stage != "Annotate":
            return
        ref, count = app.app_state.workers.geometry.submit(
            picking_tasks.select_box, obj.asset.folder, app.app_state.workspace, camera, low, high,
            one_piece=positive and app.picking_out, hidden=self.hidden_now(), priority=20,
        ).result(PICK_SECONDS)  # fmt: skip
        self._add_region(ref, count, positive, "box")

    def _stroked(self, message: ArtiworldStrokeMessage) -> None:
        camera = self.camera()
        self._app.act(lambda: self.stroke(message, camera))

    def stroke(self, message: ArtiworldStrokeMessage, camera: Camera) -> None:
        """Everything visible in a lasso or under a brush goes to the chosen part.

        Raises:
            GeometryError: for a stroke that is none.
        """
        app = self._app
        obj = app.need_object()
        if obj.asset is None or app.stage != "Annotate":
            return
        stroke = Stroke(message.tool, message.path, message.radius)  # type: ignore[arg-type]
        ref, count = app.app_state.workers.geometry.submit(
            picking_tasks.select_stroke,
            obj.asset.folder,
            app.app_state.workspace,
            camera,
            stroke,
            self.hidden_now(),
            priority=20,
        ).result(PICK_SECONDS)
        self._add_region(ref, count, message.positive, stroke.kind)

    def _add_region(self, ref: str, count: int, positive: bool, tool: str) -> None:
        app = self._app
        if not count:
            app.notify(f"Nothing under the {tool}", "Draw over the object", "gray")
            return
        self.hover.forget()
        app.do(cmd.AddRegion(app.part, ref, positive, count, tool))

    def hidden_now(self) -> picking_tasks.Hidden | None:
        """What the pointer passes, being hidden; None where nothing is."""
        app = self._app
        labelled = app.need_object().document.segmentation
        if labelled is None or not app.hidden:
            return None
        return picking_tasks.Hidden(
            app.app_state.workspace, labelled.labels, tuple(sorted(app.hidden))
        )

    def camera(self) -> Camera:
        """The camera of this tab now."""
        view = self._app.client.camera
        return Camera(
            position=np.asarray(view.position, np.float64),
            world_from_camera=np.asarray(view.wxyz, np.float64),
            fov=float(view.fov),
            aspect=float(view.aspect),
        )
