"""Nodes of an object in a browser: the overlay of labels on its scan, its hidden parts, and its
parts drawn one by one so that joints can move them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import viser
from viser import transforms as vtf

from app.server.display_tasks import OpenedAsset, PartPayload
from app.server.page import hide_on_page
from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.picture.scene_nodes import hit_distance, nearly_hit
from model.geometry.picking import TOLERANCE

MARK_OPACITY = 0.85

Labels = npt.NDArray[np.int16]


class LabelOverlay:
    """The label overlay of one object in one client's scene.

    Args:
        scan: the drawn object; of a cloud it is the scan itself that is colored.

    Attributes:
        labels: (D,) those that were drawn last, or None.
        part_colors: part → color and opacity over a mesh.
    """

    def __init__(self, client: viser.ClientHandle, asset: OpenedAsset, scan: Any) -> None:
        self.labels: Labels | None = None
        self.part_colors: dict[int, palette.Tint] = {}
        self._client = client
        self._asset = asset
        self._scan = scan
        self._meshes: dict[int, Any] = {}
        self._mesh_vertices: dict[int, npt.NDArray[np.int32]] = {}
        self._hidden: frozenset[int] = frozenset()
        self._plain = False
        self._marked: npt.NDArray[np.bool_] | None = None
        self._mark: Any = None
        self._left_out: npt.NDArray[np.bool_] | None = None
        self._order = asset.glb_order
        self._visible = True
        self._offset: npt.NDArray[np.float32] | None = None
        if asset.glb is not None:
            self._offset = _pushed_out(asset, 4e-4 * asset.diagonal)
        hide_on_page(client, None)  # what the page hid was of another object

    def show(self, labels: Labels | None, hidden: frozenset[int], plain: bool = False) -> None:
        """Color the parts and hide the hidden ones. Sends only the parts that changed.

        Args:
            plain: color a scan by its parts alone, not over its own colors.
        """
        same = self._same(labels) and plain == self._plain
        if not same or hidden != self._hidden:
            self._hidden, self._plain = hidden, plain
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
                "/marked",
                self._offset[used],
                faces.reshape(-1, 3).astype(np.uint32),
                color=palette.MARKED,
                opacity=MARK_OPACITY,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )

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
        colors = overlay_colors(self._asset.display_colors, labels, self._plain)
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
        assert asset.display_faces is not None and asset.display_colors is not None
        mine = np.zeros(0, bool) if labels is None or part == 0 else labels == part
        faces = asset.display_faces[mine] if mine.any() else None
        if faces is not None:
            self.part_colors[part] = palette.tint(part, asset.display_colors[mine].mean(0))
        known = self._mesh_vertices.get(part)
        if faces is not None and known is not None:
            place = known[faces]
            if (place >= 0).all():
                # Its vertices are in the browser already: only the faces are sent.
                color, opacity = self.part_colors[part]
                put(self._meshes[part], color=color, opacity=opacity)
                self._meshes[part].faces = place.astype(np.uint32)
                return
        if part in self._meshes:
            self._meshes.pop(part).remove()
            del self._mesh_vertices[part]
        if faces is None:
            return
        assert self._offset is not None
        used, inverse = np.unique(faces, return_inverse=True)
        place = np.full(len(self._offset), -1, np.int32)
        place[used] = np.arange(len(used))
        self._mesh_vertices[part] = place
        self._meshes[part] = add_overlay_mesh(
            self._client.scene,
            f"/tint/{part}",
            self.part_colors[part],
            self._offset[used],
            inverse.reshape(-1, 3),
        )


def add_overlay_mesh(
    scene: viser.SceneApi,
    name: str,
    tint: palette.Tint,
    vertices: npt.NDArray[np.float32],
    faces: npt.NDArray[Any],
) -> Any:
    """Draw a tint over a part's (F, 3) faces; returns the handle."""
    return scene.add_mesh_simple(
        name,
        vertices,
        faces.astype(np.uint32),
        color=tint[0],
        opacity=tint[1],
        side="double",
        cast_shadow=False,
        receive_shadow=False,
    )


def overlay_colors(
    colors: npt.NDArray[np.uint8], labels: Labels | None, plain: bool = False
) -> npt.NDArray[np.uint8]:
    """Blend the parts' colors into those of a scan; (N, 3) uint8. The base keeps its own; where
    all is ``plain``, it is gray, and the parts' colors are opaque.
    """
    out = np.array(colors)
    for part in () if labels is None else np.unique(labels[labels > (-1 if plain else 0)]):
        mine = labels == part
        own = colors[mine].astype(np.float32)
        color, weight = palette.tint(int(part), own.mean(0)) if part else (palette.SCAN_GHOST, 1.0)
        weight = 1.0 if plain else weight
        # The scan's texture shows through the tint.
        shade = 0.55 + 0.45 * own.mean(1, keepdims=True) / max(float(own.mean()), 1.0)
        out[mine] = np.clip(own * (1 - weight) + np.array(color) * weight * shade, 0, 255)
    return out


def _pushed_out(asset: OpenedAsset, distance: float) -> npt.NDArray[np.float32]:
    """(V, 3) displayed vertices moved along their normals: part colors win over the surface."""
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


class MovingParts:
    """One frame a part in one client's scene.

    Args:
        point_size: of a cloud, metres.
        part_colors: part → color and opacity over a mesh.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        point_size: float = 0.0,
        part_colors: Mapping[int, palette.Tint] | None = None,
    ) -> None:
        self._client, self._point_size, self._part_colors = client, point_size, part_colors or {}
        self._payloads: list[PartPayload] | None = None
        self._frames: dict[int, viser.FrameHandle] = {}
        self._poses: Mapping[str, npt.NDArray[np.float64]] = {}

    def draw(self, payloads: list[PartPayload]) -> bool:
        """Draw the parts, invisible at first; False where they are drawn already."""
        if payloads is self._payloads:
            return False
        gone, self._frames = self._frames, {}
        for frame in gone.values():
            frame.remove()
        self._payloads = payloads
        self._frames = {payload.part: self._draw_part(payload) for payload in payloads}
        return True

    def _draw_part(self, payload: PartPayload) -> viser.FrameHandle:
        name, scene = f"/part/{payload.part}", self._client.scene
        frame = scene.add_frame(name, show_axes=False, visible=False)
        if payload.glb is not None:
            scene.add_glb(f"{name}/mesh", payload.glb, cast_shadow=False)
            if (k := payload.part) and payload.vertices is not None and payload.faces is not None:
                tint = self._part_colors.get(k, palette.tint(k, palette.BASE_COLOR))
                add_overlay_mesh(scene, f"{name}/tint", tint, payload.vertices, payload.faces)
            return frame
        assert payload.points is not None and payload.colors is not None
        labels = np.full(len(payload.points), payload.part, np.int16)
        scene.add_point_cloud(
            f"{name}/cloud",
            payload.points,
            overlay_colors(payload.colors, labels),
            point_size=self._point_size,
            point_shape="circle",
            precision="float32",
        )
        return frame

    def set_visible(self, visible: bool, hidden: frozenset[int]) -> None:
        """Show the parts, but for the hidden ones, or none."""
        for part, frame in self._frames.items():
            frame.visible = visible and part not in hidden

    def pose(self, posed_from_rest: Mapping[str, npt.NDArray[np.float64]]) -> None:
        """Move the drawn parts and their axes; one message for all."""
        self._poses = posed_from_rest
        with self._client.atomic():
            for part, frame in self._frames.items():
                transform = posed_from_rest.get(f"link_{part}")
                if transform is None:
                    continue
                frame.wxyz = vtf.SO3.from_matrix(transform[:3, :3]).wxyz
                frame.position = transform[:3, 3]

    @property
    def payloads(self) -> list[PartPayload] | None:
        """Payloads of the last drawing."""
        return self._payloads

    @property
    def drawn(self) -> tuple[int, ...]:
        """The parts that have a frame."""
        return tuple(self._frames)

    def points(self, part: int) -> npt.NDArray[np.floating] | None:
        """(N, 3) vertices or points of a drawn part at rest, or None."""
        for payload in self._payloads or ():
            if payload.part == part:
                return payload.shape
        return None

    def posed(
        self, hidden: frozenset[int]
    ) -> list[tuple[npt.NDArray[np.floating], npt.NDArray[Any] | None]]:
        """(V, 3) vertices or points of the parts where they are now, and (F, 3) faces or None."""
        out = []
        for payload in self._payloads or ():
            if payload.part not in hidden:
                pose = self._poses.get(f"link_{payload.part}", np.eye(4))
                out.append((payload.shape @ pose[:3, :3].T + pose[:3, 3], payload.faces))
        return out

    def pick(
        self, origin: npt.ArrayLike, direction: npt.ArrayLike, hidden: frozenset[int]
    ) -> int | None:
        """The part that a ray, (3,) and (3,), meets first where the parts are now, or None.

        What the ray itself passes by counts within a few pixels where it meets nothing.
        """
        found = self._first(hit_distance, np.inf, origin, direction, hidden)
        if found is None:
            none = TOLERANCE + 1, np.inf
            found = self._first(nearly_hit, none, origin, direction, hidden)
        return found

    def _first(
        self,
        measure: Callable[..., Any],
        none: Any,
        origin: npt.ArrayLike,
        direction: npt.ArrayLike,
        hidden: frozenset[int],
    ) -> int | None:
        """The part with the smallest ``measure``, less than ``none``."""
        nearest, found = none, None
        for payload in self._payloads or ():
            if payload.part in hidden or not len(payload.shape):
                continue
            rest = np.linalg.inv(self._poses.get(f"link_{payload.part}", np.eye(4)))
            start = rest[:3, :3] @ np.asarray(origin, np.float64) + rest[:3, 3]
            along = rest[:3, :3] @ np.asarray(direction, np.float64)
            faces = None if payload.faces is None else payload.faces.astype(np.uint32)
            distance = measure(start, along, payload.shape, faces)
            if distance < nearest:
                nearest, found = distance, payload.part
        return found
