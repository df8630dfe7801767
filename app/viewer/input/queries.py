"""Questions to the workers about places in the picture."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from app.server import picking_tasks, tool_tasks
from app.server.display_tasks import OpenedAsset
from app.server.jobs import PREVIEWS, Job
from app.server.lanes import Lane
from app.server.segmenting import stored_prompts
from app.viewer.tab import Tab
from app.viewer.words import annotate as words
from model.geometry.picking import Camera, Stroke
from model.segmentation.prompts import Click
from sessions.command_log import PICK
from sessions.document import Document

Point = tuple[float, float, float]
Selected = Callable[[str, int], None]
"""Gets the reference and the number of selected elements."""
PATIENCE = 2.0
"""Seconds that a click holds up what its person does next; then it waits aside for its answer."""
FRAME_SECONDS = 5.0
PREVIEW_SECONDS = 10.0
PICK_PRIORITY, FRAME_PRIORITY = 20, 15


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
        job = self._lane.geometry.submit(
            picking_tasks.pick, asset.folder, origin, direction, self._hidden(),
            priority=PICK_PRIORITY, repeated=True,
        )  # fmt: skip
        self._answer(job, then)

    def _answer(self, job: Job[Any], then: Callable[[Any], None]) -> None:
        """Give a job's result to ``then``: now, or as an action of its own once it is there."""
        obj, begun = self._tab.selection.need_object(), time.time()
        job.add_done_callback(lambda _: obj.record_job(PICK, begun, time.time() - begun))
        try:
            found = job.result(PATIENCE)
        except TimeoutError:
            self._tab.say(words.CLICK_WAITS)
            job.add_done_callback(lambda done: self._tab.act(lambda: then(done.result(0))))
        else:
            then(found)

    def pick_preview(self, asset: OpenedAsset, place: tuple[float, float]) -> Any:
        """The same under the pointer, at (x, y) of the picture; only the newest one is answered."""
        origin, direction = self.camera().ray(place)
        return self._lane.geometry.submit(
            picking_tasks.pick, asset.folder, tuple(origin), tuple(direction), self._hidden(),
            key=("hover", self._tab.client.client_id), priority=PREVIEWS,
        ).result(PREVIEW_SECONDS)  # fmt: skip

    def preview(self, asset: OpenedAsset, doc: Document, click: Click) -> Any:
        """The elements that a click would add to its part and remove from others."""
        return self._lane.segmentation.submit(
            tool_tasks.hover, asset.folder, self._workspace, self._segmenter, stored_prompts(doc),
            click, key=("hover", self._tab.client.client_id), priority=PREVIEWS,
            works_on=asset.folder,
        ).result(PREVIEW_SECONDS)  # fmt: skip

    def box(
        self, asset: OpenedAsset, camera: Camera, low: Any, high: Any, then: Selected,
        *, one_piece: bool,
    ) -> None:  # fmt: skip
        """Give ``then`` the visible elements in a rectangle of the picture."""
        job = self._lane.geometry.submit(
            picking_tasks.select_box, asset.folder, self._workspace, camera, low, high,
            one_piece=one_piece, hidden=self._hidden(), priority=PICK_PRIORITY, repeated=True,
        )  # fmt: skip
        self._answer(job, lambda found: then(*found))

    def stroke(self, asset: OpenedAsset, camera: Camera, stroke: Stroke, then: Selected) -> None:
        """Give ``then`` the visible elements in a lasso or under a brush."""
        job = self._lane.geometry.submit(
            picking_tasks.select_stroke, asset.folder, self._workspace, camera, stroke,
            self._hidden(), priority=PICK_PRIORITY, repeated=True,
        )  # fmt: skip
        self._answer(job, lambda found: then(*found))

    def rectangle_frame(self, asset: OpenedAsset, corner: Point, view: Point) -> Any:
        """Normal and first side of a rectangle to cut, or None while the workers are busy."""
        try:
            return self._lane.segmentation.submit(
                tool_tasks.frame_at, asset.folder, corner, view, priority=FRAME_PRIORITY,
                works_on=asset.folder,
            ).result(FRAME_SECONDS)  # fmt: skip
        except TimeoutError:
            return None

    def _hidden(self) -> picking_tasks.Hidden | None:
        """The parts that rays pass through; None where nothing is hidden."""
        selection = self._tab.selection
        labelled = selection.need_object().document.segmentation
        if labelled is None or not selection.hidden:
            return None
        return picking_tasks.Hidden(
            self._workspace, labelled.labels, tuple(sorted(selection.hidden))
        )
