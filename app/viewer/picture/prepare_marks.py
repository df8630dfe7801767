"""Marks of a scan being prepared: removed points, the crop box, the rotation handle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from viser import transforms as vtf

from app.viewer.picture import palette
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.tab import Tab

Array = npt.NDArray[np.float64]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
_DOT = 0.0015
"""Size of removed points, in diagonals: small enough to look through."""
_CORNERS = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)], float)
_EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit])


class PrepareMarks:
    """Marks in one tab's scene.

    Args:
        turned: gets the (3, 3) rotation, in the asset's frame, at which the handle was let go.
    """

    def __init__(self, tab: Tab, picture: ObjectPicture, turned: Callable[[Array], None]) -> None:
        self._tab, self._picture, self._turned = tab, picture, turned
        self._drawn: tuple[Any, ...] = ()
        self._removed: Any = None
        self._box: Any = None
        self._handle: Any = None

    def forget(self) -> None:
        """Note that the picture was cleared, and the marks with it."""
        self._drawn, self._removed, self._box, self._handle = (), None, None, None

    def draw(
        self, box: Box | None, frame: Array | None = None, *, removed: bool, handle: bool
    ) -> None:
        """Show the crop box and the other marks that are requested.

        Args:
            box: in a frame, (4, 4) from the asset's.
        """
        obj = self._tab.selection.object
        asset = None if obj is None else obj.asset
        frame = np.eye(4) if frame is None else frame
        now = (id(asset), box, removed, handle, frame.tobytes())
        if asset is None or now == self._drawn:
            return
        self._drawn = now
        for old in (self._removed, self._box, self._handle):
            if old is not None:
                old.remove()
        self.forget()
        self._drawn = now
        scene, turn = self._tab.client.scene, np.linalg.inv(frame)
        if removed and asset.removed is not None:
            self._removed = scene.add_point_cloud(
                "/removed", asset.removed, palette.MARKED, point_size=_DOT * asset.diagonal,
                point_shape="circle", precision="float32",
            )  # fmt: skip
        if box is not None:
            low, high = np.array(box)
            corners = (low + _CORNERS * (high - low)) @ turn[:3, :3].T + turn[:3, 3]
            self._box = scene.add_line_segments(
                "/crop", corners[_EDGES].astype(np.float32), palette.SELECTED,
                thickness=2.0, thickness_units="screen",
            )  # fmt: skip
        if handle:
            self._add_handle(asset, self._picture.shown_upright[:3, :3].T)

    def _add_handle(self, asset: Any, rotation: Array) -> None:
        middle = np.median(asset.display_centers, axis=0)
        start = vtf.SO3.from_matrix(rotation)
        self._handle = handle = self._tab.client.scene.add_transform_controls(
            "/turn", scale=0.35 * asset.diagonal, position=middle, wxyz=start.wxyz,
            disable_axes=True, disable_sliders=True, depth_test=False,
        )  # fmt: skip

        @handle.on_update
        def _(event: Any) -> None:
            turn = vtf.SO3(np.asarray(handle.wxyz)) @ start.inverse()
            scan = self._picture.scan
            if event.phase == "end":
                self._tab.act(lambda: self._turned(np.asarray(turn.as_matrix(), np.float64)))
            elif scan is not None:
                scan.wxyz = turn.wxyz
                scan.position = middle - turn.as_matrix() @ middle
