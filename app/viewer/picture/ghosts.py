"""The scans around the object of a scene that is worked on: one cloud of pale points.

Nothing shows through a point, so those between the eye and the object are left out. What these are
follows the camera, once it rests: each time the cloud is sent anew.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
import viser

from app.server.scene_tasks import Shape
from app.viewer.picture import palette
from app.viewer.picture.scene_nodes import Node, Placement, Scans, through_box

Array = npt.NDArray[np.float64]

MOST = 60_000
"""Points, so that it is soon sent."""
POINT_SIZE = 0.4
"""Share of the scans' point size: ghosts let through what lies behind them."""
_RESTS = 0.2
"""Seconds without a movement after which the camera counts as resting."""
_MARGIN = 0.02
"""Share of the object's size, around its box."""

log = logging.getLogger(__name__)


class Ghosts:
    """The cloud of one tab.

    Args:
        name: of its node.
        eye: where the camera is, (3,) in the frame of ``name``'s parent.
    """

    def __init__(self, client: viser.ClientHandle, name: str, eye: Callable[[], Array]) -> None:
        self._client, self._name, self._eye = client, name, eye
        self._lock = threading.Lock()
        self._drawn: tuple[Any, ...] = (None,)
        self._points: Array | None = None
        self._box: tuple[Array, Placement] = np.zeros((2, 3)), Placement(np.eye(4), np.ones(3))
        self._kept = np.zeros(0, bool)
        self._handle: Any = None
        self._news = threading.Event()
        self._closed = False
        client.camera.on_update(lambda _: self._news.set())
        threading.Thread(target=self._follow, name="ghosts", daemon=True).start()

    def draw(
        self, id: str | None, nodes: Iterable[Node], at: tuple[Shape, Placement] | None
    ) -> None:
        """Show the scans around an object; nothing where that is None.

        Args:
            nodes: all that is drawn.
            at: the object's shape and placement.
        """
        scans = [node for node in nodes if isinstance(node, Scans)]
        drawn = (None,) if id is None or at is None else (id, *scans)
        if drawn == self._drawn:
            return
        self._drawn = drawn
        self._hide()
        if at is None or id is None:
            return
        each = [(n, k) for n in scans for k, other in enumerate(n.ids) if other != id]
        if each:
            points = np.concatenate([n.points_in_place(k) for n, k in each])
            size = float(np.median([n.point_size(k) for n, k in each]))
            self._show(points, POINT_SIZE * size, at[0].bounds, at[1])

    def _show(self, points: Array, size: float, bounds: Array, placement: Placement) -> None:
        if len(points) > MOST:
            points = points[np.random.default_rng(0).choice(len(points), MOST, replace=False)]
        with self._lock:
            self._points, self._box = points, (bounds, placement)
            kept = self._kept = ~before(self._eye(), points, bounds, placement)
            self._handle = self._client.scene.add_point_cloud(
                self._name,
                points[kept].astype(np.float16),
                palette.SCAN_GHOST,
                precision="float16",
                point_size=size,
                point_shape="circle",
            )

    def _hide(self) -> None:
        with self._lock:
            handle, self._handle, self._points = self._handle, None, None
        if handle is not None:
            handle.remove()

    def close(self) -> None:
        """The tab is gone."""
        self._closed = True
        self._news.set()

    def _follow(self) -> None:
        while not self._closed:
            self._news.wait()
            while not self._closed:
                self._news.clear()
                if not self._news.wait(_RESTS):
                    break
            try:
                self._update()
            except Exception:  # a closing tab must not end the server
                if not self._closed:
                    log.exception("the ghosts of a scene couldn't be drawn")

    def _update(self) -> None:
        with self._lock:
            if self._closed or self._points is None:
                return
            kept = ~before(self._eye(), self._points, *self._box)
            if np.array_equal(kept, self._kept):
                return
            self._kept = kept
            self._handle.points = self._points[kept].astype(np.float16)


def before(eye: Array, points: Array, bounds: Array, placement: Placement) -> npt.NDArray[np.bool_]:
    """(N,) which points are between an eye and an object's box.

    Args:
        eye: (3,), points: (N, 3), in one frame.
        bounds: (2, 3) of the object's asset.
        placement: of that asset.
    """
    turn = placement.world[:3, :3] / placement.scale
    start = (eye - placement.world[:3, 3]) @ turn
    along = (points - placement.world[:3, 3]) @ turn - start
    low, high = np.sort(bounds, axis=0)
    reach = _MARGIN * float(np.linalg.norm(high - low))
    enter, leave = through_box(start, along, low - reach, high + reach)
    return (leave >= enter) & (enter > 1.0)
