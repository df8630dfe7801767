"""Questions to the workers about places in the picture, the preview of a click under the pointer,
and tools that change the selected part.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from app.server import segmenting_tasks, tool_tasks
from app.server.display_tasks import OpenedAsset
from app.server.jobs import PREVIEWS, Job
from app.server.open_object import OpenObject
from app.server.page import ArtiworldHoverMessage
from app.server.segmenting import POINTING, Take, stored_prompts
from app.server.tool_tasks import NEXT_MASK, RegionOffer, ToolRequest
from app.server.workers import Lane
from app.viewer.picture import palette
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.tab import Tab, percent
from app.viewer.words import annotate as words
from model.core.errors import ArtiworldError
from model.core.progress import Cancelled
from model.geometry.picking import Camera
from model.segmentation.prompts import Click
from sessions.command_log import PICK
from sessions.document import Document, RegionRef

Point = tuple[float, float, float]
T = TypeVar("T")
Selected = Callable[[str, int], None]
"""Gets the reference and the number of selected elements."""
PATIENCE = 2.0
"""Seconds that a click holds up what its person does next; then it waits aside for its answer."""
FRAME_SECONDS = 5.0
PREVIEW_SECONDS = 10.0
FRAME_PRIORITY = 15


class PointerQueries:
    """Picks elements by rays, boxes and strokes for one tab.

    Args:
        workspace: where arrays are stored.
        segmenter: answers previews.
    """

    def __init__(self, tab: Tab, workspace: Path, segmenter: str) -> None:
        self._tab = tab
        self._workspace, self._segmenter = workspace, segmenter

    @property
    def _lane(self) -> Lane:
        """The workers that answer."""
        return self._tab.selection.need_object().lane

    def camera(self) -> Camera:
        """The camera of this tab now."""
        view = self._tab.client.camera
        return Camera(
            position=np.asarray(view.position, np.float64),
            world_from_camera=np.asarray(view.wxyz, np.float64),
            fov=float(view.fov),
            aspect=float(view.aspect),
        )

    def pick(
        self, asset: OpenedAsset, origin: Point, direction: Point, then: Callable[[Any], None]
    ) -> None:
        """Give ``then`` the first visible element on a ray, or None."""
        aim = self.aim(origin, direction)
        job = self._lane.geometry.submit(
            segmenting_tasks.pick, asset.folder, *aim, priority=POINTING, repeated=True
        )
        self.answer(job, then)

    def aim(self, origin: Point, direction: Point) -> segmenting_tasks.Aim:
        """A ray and the parts that it passes through."""
        return origin, direction, self._hidden()

    def answer(self, asked: Job[T] | Future[T], then: Callable[[T], None]) -> None:
        """Give a result to ``then``: now, or as an action of its own once it is there."""
        obj, begun = self._tab.selection.need_object(), time.time()
        asked.add_done_callback(lambda _: obj.jobs.record(PICK, begun, time.time() - begun))
        try:
            found = asked.result(PATIENCE)
        except TimeoutError:
            self._tab.say(words.CLICK_WAITS)
            asked.add_done_callback(lambda done: self._tab.act(lambda: then(done.result(0))))
        else:
            then(found)

    def pick_preview(self, asset: OpenedAsset, place: tuple[float, float]) -> Any:
        """The same under the pointer, at (x, y) of the picture; only the newest one is answered."""
        origin, direction = self.camera().ray(place)
        return self._lane.geometry.submit(
            segmenting_tasks.pick,
            asset.folder,
            tuple(origin),
            tuple(direction),
            self._hidden(),
            key=("hover", self._tab.client.client_id),
            priority=PREVIEWS,
        ).result(PREVIEW_SECONDS)

    def preview(self, asset: OpenedAsset, doc: Document, click: Click) -> Any:
        """The elements that a click would add to its part and remove from others."""
        return self._lane.segmentation.submit(
            tool_tasks.hover,
            asset.folder,
            self._workspace,
            self._segmenter,
            stored_prompts(doc),
            click,
            key=("hover", self._tab.client.client_id),
            priority=PREVIEWS,
            works_on=asset.folder,
        ).result(PREVIEW_SECONDS)

    def within(
        self,
        asset: OpenedAsset,
        camera: Camera,
        shape: segmenting_tasks.Shape,
        then: Selected,
        *,
        one_piece: bool,
    ) -> None:
        """Give ``then`` the visible elements in a box, in a lasso or under a brush."""
        seen = asset.folder, self._workspace, camera, shape, self._hidden()
        job = self._lane.geometry.submit(
            segmenting_tasks.select, *seen, one_piece=one_piece, priority=POINTING, repeated=True
        )
        self.answer(job, lambda found: then(*found))

    def rectangle_frame(self, asset: OpenedAsset, corner: Point, view: Point) -> Any:
        """Normal and first side of a rectangle to cut, or None while the workers are busy."""
        try:
            return self._lane.segmentation.submit(
                tool_tasks.frame_at,
                asset.folder,
                corner,
                view,
                priority=FRAME_PRIORITY,
                works_on=asset.folder,
            ).result(FRAME_SECONDS)
        except TimeoutError:
            return None

    def _hidden(self) -> segmenting_tasks.Hidden | None:
        """The parts that rays pass through; None where nothing is hidden."""
        selection = self._tab.selection
        labelled = selection.need_object().document.segmentation
        if labelled is None or not selection.hidden:
            return None
        return segmenting_tasks.Hidden(
            self._workspace, labelled.labels, tuple(sorted(selection.hidden))
        )


log = logging.getLogger(__name__)
_AGAIN = 0.25
"""Seconds until a place that could not be answered yet is asked again; the pointer may rest."""


class Hover:
    """The preview of one tab, on a thread of its own: only the newest place counts.

    Args:
        clicking: whether a click now would be a prompt.

    Attributes:
        on: whether previews are shown.
        seconds: from the message to the preview, of the last one; for measuring.
    """

    def __init__(
        self,
        tab: Tab,
        picture: ObjectPicture,
        queries: PointerQueries,
        clicking: Callable[[], bool],
    ) -> None:
        self._tab, self._picture, self._queries = tab, picture, queries
        self._clicking = clicking
        self.on = True
        self.seconds: float | None = None
        self._place: tuple[float, float] | None = None
        self._came = 0.0
        self._news = threading.Event()
        self._closed = False
        self._shown: tuple[int, int, str] | None = None
        self._thread: threading.Thread | None = None

    def moved(self, message: ArtiworldHoverMessage) -> None:
        """The pointer rests elsewhere. Called on the event loop: it only takes a note."""
        inside = message.inside and math.isfinite(message.x) and math.isfinite(message.y)
        self._place = (message.x, message.y) if inside else None
        self._came = time.perf_counter()
        if self._thread is None and not self._closed:
            self._thread = threading.Thread(target=self._loop, name="hover", daemon=True)
            self._thread.start()
        self._news.set()

    def forget(self) -> None:
        """Show nothing until the pointer moves again."""
        self._place = None
        self._news.set()

    def close(self) -> None:
        """The tab is gone."""
        self._closed = True
        self._news.set()

    def _loop(self) -> None:
        settled = True
        while not self._closed:
            self._news.wait(None if settled else _AGAIN)
            self._news.clear()
            settled = True
            try:
                settled = self._show()
            except Cancelled:
                pass  # something newer came
            except TimeoutError:
                settled = False  # the workers have more urgent things to do
            except ArtiworldError as error:
                log.debug("no preview: %s", error)
            except Exception:  # a preview that fails must not end the previews
                if not self._closed:
                    log.exception("the preview failed")

    def _show(self) -> bool:
        """Answer the newest place; False where that has to wait for the object."""
        selection, place, came = self._tab.selection, self._place, self._came
        obj = selection.object
        if obj is None or obj.asset is None or place is None or not self._ready(obj):
            self._clear()
            return not (self.on and place is not None and obj is not None and obj.busy)
        hit = self._queries.pick_preview(obj.asset, place)
        if hit is None:
            self._clear()
            return True
        element, part, doc = int(hit.element), selection.part, obj.document
        wanted = (element, part, doc.key)
        if wanted == self._shown:
            return True
        x, y, z = (float(v) for v in hit.position)
        preview = self._queries.preview(obj.asset, doc, Click((x, y, z), part, True, element))
        if self._place is None or obj is not selection.object or obj.document.key != doc.key:
            return True  # clicked or left meanwhile
        self._shown = wanted
        self._picture.overlays.show_hover(preview.gained, preview.lost, palette.part_color(part))
        self.seconds = time.perf_counter() - came
        return True

    def _ready(self, obj: OpenObject) -> bool:
        """True if a click here and now would be a prompt that is answered at once."""
        busy = {"open", "encode", "segment", "room", "tool"} & set(obj.busy)
        return self.on and self._clicking() and not busy

    def _clear(self) -> None:
        if self._shown is not None:
            self._shown = None
            self._picture.overlays.show_hover(None, None, palette.BASE_COLOR)


_NEW_PARTS = ("mirror", "propose", "split")


class Tools:
    """Runs tools for one tab.

    Args:
        begins: called before a tool works.
    """

    def __init__(self, tab: Tab, begins: Callable[[], None], picture: ObjectPicture) -> None:
        self._tab, self._begins, self._picture = tab, begins, picture
        self._take: Take | None = None
        self.finds: list[RegionOffer] = []
        self._at = 0
        self._label = "", 0

    @property
    def label(self) -> str:
        """Name that was picked for the part that the next click makes, or ""."""
        (name, part), selection = self._label, self._tab.selection
        obj = selection.object
        waits = obj is not None and selection.part == part
        return name if waits and obj is not None and obj.document.part(part) is None else ""

    def pick_label(self, name: str) -> None:
        """Have the next click make a part of that name; the same again makes one without."""
        selection = self._tab.selection
        document, part = selection.need_object().document, selection.part
        if not part or document.part(part) is not None:
            part = document.next_part
        self._label = ("" if name == self.label else name), part
        selection.choose_part(part)

    def forget_label(self) -> None:
        """Have the next click make a part without a name."""
        self._label = "", 0

    @property
    def hint(self) -> str:
        """Keys for the parts found that wait to be taken."""
        return words.hint_finds(self._at + 1, len(self.finds))

    def step(self, by: int) -> None:
        """Go to another one of the parts found, 0 shows the same again."""
        if self.finds:
            self._at = (self._at + by) % len(self.finds)
        overlays = self._picture.overlays
        overlays.show_finds([f.points for f in self.finds if f.points is not None], self._at)
        self._tab.invalidate()

    def leave_out(self) -> None:
        """Drop the part found that is shown."""
        del self.finds[self._at]
        self.step(0)

    def take(self) -> None:
        """Make parts of what was found."""
        take, finds = self._take, self.finds
        self.drop()
        if take is not None and finds:
            take(finds, self._tab.user)
            self._tab.notify(words.SAME_SHAPE, words.found(len(finds)), "green")

    def drop(self) -> None:
        """Nothing found waits any longer."""
        if self.finds:
            self.finds, self._take = [], None
            self.step(0)

    def next_mask(self, step: int) -> None:
        """Take another mask for the last click, or go to another part found: the next one, or
        with -1 the one before.
        """
        if self.finds:
            self.step(step)
            return
        self.use(ToolRequest(NEXT_MASK, self._tab.selection.part, step), words.NEXT)

    def use(self, request: ToolRequest, label: str) -> None:
        """Run a tool and show its result."""
        tab, selection = self._tab, self._tab.selection
        self._begins()
        obj, request = selection.need_object(), replace(request, name=self.label or None)
        before = {p.part for p in obj.document.prompts}
        try:
            if request.tool == "same shape":
                offers, _, self._take = obj.segmenting.find(request)
                self.finds, self._at = offers if isinstance(offers, list) else [], 0
                self.step(0)
                found = len(self.finds)
            else:
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
