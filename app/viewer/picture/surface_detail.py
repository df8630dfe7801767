"""Light in the surface and lines along its edges, for objects without a texture."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from app.server.display_tasks import OpenedAsset
from app.server.jobs import Job
from app.server.light_tasks import LitMesh, lit_mesh
from app.server.open_object import OpenObject
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.tab import Tab

_PRIORITY: Final = -1
"""After all that a person waits for."""
_EDGE_COLOR: Final = (38, 42, 48)
_EDGE_PIXELS: Final = 1.2


class SurfaceDetail:
    """Surface detail of the open object in one tab; workers compute it after the first drawing.

    Attributes:
        edges_on: whether edges are drawn.
    """

    def __init__(self, tab: Tab, picture: ObjectPicture) -> None:
        self._tab, self._picture = tab, picture
        self.edges_on = True
        self._asset: OpenedAsset | None = None
        self._lit: LitMesh | None = None
        self._shown = False
        self._key: Any = None

    @property
    def lit(self) -> bool:
        """True if the light in the surface is drawn."""
        return self._shown

    def draw(self, obj: OpenObject, moving: bool) -> None:
        """Bring light and edges up to date."""
        asset = obj.asset
        if asset is not self._asset:
            self._asset, self._lit, self._shown, self._key = asset, None, False, None
            if asset is not None and asset.glb is not None:
                job = obj.lane.geometry.submit(lit_mesh, asset.folder, priority=_PRIORITY)
                job.add_done_callback(lambda done: self._done(done, asset))
        if self._lit is None:
            return
        if not self._shown:
            self._shown = True
            self._picture.show_lit(self._lit.glb, self._lit.glb_order)
        self._draw_edges(obj, self._lit, moving)

    def _done(self, job: Job[LitMesh | None], asset: OpenedAsset) -> None:
        if job.error is None:  # without it, the picture stays as it is
            self._tab.act(lambda: self._take(job.result(0), asset))

    def _take(self, lit: LitMesh | None, asset: OpenedAsset) -> None:
        if asset is self._asset:
            self._lit = lit
            self._tab.invalidate()

    def _draw_edges(self, obj: OpenObject, lit: LitMesh, moving: bool) -> None:
        hidden, labels = self._tab.selection.hidden, obj.labels
        key = (self.edges_on, moving, hidden, id(labels), id(self._picture.parts.payloads))
        if key == self._key:
            return
        self._key = key
        scene, edges = self._tab.client.scene, lit.edges
        of_edge = None if labels is None else labels[edges.face]
        shown = np.full(len(edges.face), self.edges_on)
        if of_edge is not None:
            shown &= ~np.isin(of_edge, list(hidden))
        names: dict[str, Any] = {"/edges": shown & (not moving)}
        for part in self._picture.parts.drawn:
            mine = shown & moving if of_edge is None else shown & moving & (of_edge == part)
            names[f"/part/{part}/edges"] = mine
        with self._tab.client.atomic():
            for name, which in names.items():
                if which.any():
                    scene.add_line_segments(
                        name, edges.points[which], _EDGE_COLOR, thickness=_EDGE_PIXELS,
                        thickness_units="screen",
                    )  # fmt: skip
                elif scene.get_handle_by_name(name) is not None:
                    scene.remove_by_name(name)
