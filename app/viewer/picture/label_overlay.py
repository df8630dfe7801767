"""The overlay of labels on the scan of an object, and its hidden parts.

Only what changed is sent: of hidden parts one bit a displayed face or point.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import viser

from app.server.display_tasks import OpenedAsset
from app.server.pointer_messages import hide_on_page
from app.viewer.picture import palette

OPACITY = 0.5
CLOUD_OPACITY = 0.55
MARK_OPACITY = 0.85

Labels = npt.NDArray[np.int16]


class LabelOverlay:
    """The label overlay of one object in one client's scene.

    Args:
        scan: the drawn object; of a cloud it is the scan itself that is colored.

    Attributes:
        labels: (D,) those that were drawn last, or None.
    """

    def __init__(self, client: viser.ClientHandle, asset: OpenedAsset, scan: Any) -> None:
        self.labels: Labels | None = None
        self._client = client
        self._asset = asset
        self._scan = scan
        self._meshes: dict[int, Any] = {}
        self._mesh_vertices: dict[int, npt.NDArray[np.int32]] = {}
        self._hidden: frozenset[int] = frozenset()
        self._marked: npt.NDArray[np.bool_] | None = None
        self._mark: Any = None
        self._left_out: npt.NDArray[np.bool_] | None = None
        self._order = asset.glb_order
        self._visible = True
        self._offset: npt.NDArray[np.float32] | None = None
        if asset.glb is not None:
            self._offset = _pushed_out(asset, 4e-4 * asset.diagonal)
        hide_on_page(client, None)  # what the page hid was of another object

    def show(self, labels: Labels | None, hidden: frozenset[int]) -> None:
        """Color the parts and hide the hidden ones. Sends only the parts that changed."""
        same = self._same(labels)
        if not same or hidden != self._hidden:
            self._hidden = hidden
            if self._asset.display_points is None:
                self._draw_meshes(labels, hidden)
            elif not same:
                self._color_cloud(labels)
            self._leave_out(labels, hidden)
        self.labels = labels  # last: they are drawn by now

    def redrawn(self, order: npt.NDArray[np.int32]) -> None:
        """The page draws the mesh with other triangles: (T,) the displayed face of each."""
        self._order, self._left_out = order, None
        hide_on_page(self._client, None)
        self._leave_out(self.labels, self._hidden)

    def mark(self, marked: npt.NDArray[np.bool_] | None) -> None:
        """Show (D,) elements in grey; None or none of them marks nothing."""
        marked = marked if marked is not None and marked.any() else None
        before, self._marked = self._marked, marked
        if marked is before or (
            marked is not None and before is not None and np.array_equal(marked, before)
        ):
            return
        asset = self._asset
        if asset.display_points is not None:
            self._color_cloud(self.labels)
            return
        if self._mark is not None:
            self._mark.remove()
            self._mark = None
        if marked is not None:
            assert asset.display_faces is not None and self._offset is not None
            used, faces = np.unique(asset.display_faces[marked], return_inverse=True)
            self._mark = self._client.scene.add_mesh_simple(
                "/marked", self._offset[used], faces.reshape(-1, 3).astype(np.uint32),
                color=palette.MARKED, opacity=MARK_OPACITY, side="double", cast_shadow=False,
                receive_shadow=False,
            )  # fmt: skip

    def set_visible(self, visible: bool) -> None:
        """Show or hide the overlay of a mesh."""
        self._visible = visible
        for part, tint in self._meshes.items():
            tint.visible = visible and part not in self._hidden

    def _same(self, labels: Labels | None) -> bool:
        if labels is None or self.labels is None:
            return labels is self.labels
        return labels is self.labels or np.array_equal(labels, self.labels)

    def _draw_meshes(self, labels: Labels | None, hidden: frozenset[int]) -> None:
        before = self.labels
        now = set() if labels is None else {int(i) for i in np.unique(labels)}
        with self._client.atomic():
            for part in set(self._meshes) | now:
                same = (
                    before is not None
                    and labels is not None
                    and part in self._meshes
                    and np.array_equal(before == part, labels == part)
                )
                if not same:
                    self._draw_mesh(part, labels)
                if part in self._meshes:
                    self._meshes[part].visible = part not in hidden and self._visible

    def _color_cloud(self, labels: Labels | None) -> None:
        assert self._asset.display_colors is not None
        colors = overlay_colors(self._asset.display_colors, labels)
        if self._marked is not None:
            own = (1 - MARK_OPACITY) * colors[self._marked]
            colors[self._marked] = own + MARK_OPACITY * np.array(palette.MARKED)
        self._scan.colors = colors

    def _leave_out(self, labels: Labels | None, hidden: frozenset[int]) -> None:
        """Let the page draw the scan without the hidden parts."""
        out = None
        if labels is not None and hidden:
            out = np.isin(labels, list(hidden))
            if self._order is not None:
                out = out[self._order]
            out = out if out.any() else None
        before, self._left_out = self._left_out, out
        if out is not before and not (
            out is not None and before is not None and np.array_equal(out, before)
        ):
            hide_on_page(self._client, out)

    def _draw_mesh(self, part: int, labels: Labels | None) -> None:
        asset = self._asset
        assert asset.display_faces is not None
        faces = None if labels is None or part == 0 else asset.display_faces[labels == part]
        known = self._mesh_vertices.get(part)
        if faces is not None and len(faces) and known is not None:
            place = known[faces]
            if (place >= 0).all():
                # Its vertices are in the browser already: only the faces are sent.
                self._meshes[part].faces = place.astype(np.uint32)
                return
        if part in self._meshes:
            self._meshes.pop(part).remove()
            del self._mesh_vertices[part]
        if faces is None or not len(faces):
            return
        assert self._offset is not None
        used, inverse = np.unique(faces, return_inverse=True)
        place = np.full(len(self._offset), -1, np.int32)
        place[used] = np.arange(len(used))
        self._mesh_vertices[part] = place
        self._meshes[part] = add_overlay_mesh(
            self._client.scene,
            f"/tint/{part}",
            part,
            self._offset[used],
            inverse.reshape(-1, 3),
            OPACITY,
        )


def add_overlay_mesh(
    scene: viser.SceneApi,
    name: str,
    part: int,
    vertices: npt.NDArray[np.float32],
    faces: npt.NDArray[Any],
    opacity: float,
) -> Any:
    """Draw a part's color over its (F, 3) faces; returns the handle."""
    return scene.add_mesh_simple(
        name,
        vertices,
        faces.astype(np.uint32),
        color=palette.part_color(part),
        opacity=opacity,
        side="double",
        cast_shadow=False,
        receive_shadow=False,
    )


def overlay_colors(colors: npt.NDArray[np.uint8], labels: Labels | None) -> npt.NDArray[np.uint8]:
    """Blend the parts' colors into those of a scan; (N, 3) uint8. The base keeps its own."""
    if labels is None:
        return np.array(colors)
    top = int(labels.max()) + 1 if len(labels) else 1
    table = np.array([palette.part_color(i) for i in range(top)], np.float32)
    weight = np.full(top, CLOUD_OPACITY, np.float32)
    weight[0] = 0.0
    w = weight[labels][:, None]
    # Brightness of the scan is kept, so that its texture shows through the tint.
    shade = 0.55 + 0.45 * (colors.mean(axis=1, keepdims=True) / 160.0)
    return np.clip(colors * (1 - w) + table[labels] * w * shade, 0, 255).astype(np.uint8)


def _pushed_out(asset: OpenedAsset, distance: float) -> npt.NDArray[np.float32]:
    """(V, 3) displayed vertices moved along their normals, so that tints win over the surface."""
    assert asset.display_vertices is not None and asset.display_faces is not None
    v, f = asset.display_vertices, asset.display_faces
    t = v[f]
    normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    total = np.zeros_like(v)
    for corner in range(3):
        for k in range(3):
            total[:, k] += np.bincount(f[:, corner], normal[:, k], len(v)).astype(np.float32)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return (v + distance * unit).astype(np.float32)
