"""What one browser tab draws of an object. Draws differences only; decides nothing.

Node names are flat (``/part/<id>``), since viser's node names are its scene tree: link poses come
from forward kinematics on the server, not from nesting.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import viser
from viser import transforms as vtf

from app.display_tasks import OpenedAsset, PartPayload
from app.judging import JointCheck
from app.viewer import palette
from app.viewer.overlays import Overlays
from model.geometry.display import spacing
from model.kinematics.joint import Joint
from model.segmentation.prompts import Click

FIELD_OF_VIEW = 0.7
TINT_OPACITY = 0.5
CLOUD_TINT = 0.55
PROMPT_RADIUS = 0.0075
SCENE_ROOT = "/world"
"""Node above all that belongs to a scene around the object."""


@dataclass(frozen=True)
class AxisMark:
    """One axis to draw: an arrow through ``origin`` along ``axis`` in its parent's pose."""

    key: str
    origin: tuple[float, float, float]
    axis: tuple[float, float, float]
    length: float
    color: palette.Rgb
    thick: bool


class SceneView:
    """The 3D scene of one client."""

    def __init__(self, client: viser.ClientHandle, in_scene: bool = False) -> None:
        self._client = client
        self._scene = client.scene
        self._in_scene = in_scene
        self._asset: OpenedAsset | None = None
        self._scan: Any = None
        self._labels: npt.NDArray[np.int16] | None = None
        self._tints: dict[int, Any] = {}
        self._tint_vertices: dict[int, npt.NDArray[np.int32]] = {}
        self._prompts: dict[int, tuple[Click, Any]] = {}
        self._parts: dict[int, dict[str, Any]] = {}
        self._payloads: list[PartPayload] | None = None
        self._axes: dict[str, tuple[AxisMark, Any]] = {}
        self._contacts: list[Any] = []
        self._contact_key: Any = None
        self._moment: list[Any] = []
        self._hidden: frozenset[int] = frozenset()
        self._moving = False
        self._offset: npt.NDArray[np.float32] | None = None
        self._overlays = Overlays(client)
        self.touch: Any = None

    # --- the object

    def clear(self) -> None:
        """Take the object off the picture; a scene around it stays."""
        for name in list(self._scene._handle_from_node_name):
            if not name.startswith(SCENE_ROOT):
                self._scene.remove_by_name(name)
        self.__init__(self._client, self._in_scene)

    def show_asset(self, asset: OpenedAsset) -> None:
        """Draw a newly opened object and aim the camera at it."""
        self.clear()
        self._asset = asset
        scene, diagonal = self._scene, asset.diagonal
        set_stage(scene)
        if not self._in_scene:  # which has a floor of its own
            self._show_ground(asset)
        if asset.glb is not None:
            self._scan = scene.add_glb("/scan", asset.glb, cast_shadow=False)
            self._offset = _pushed_out(asset, 4e-4 * diagonal)
        else:
            assert asset.display_points is not None and asset.display_colors is not None
            self._scan = scene.add_point_cloud(
                "/scan",
                asset.display_points,
                asset.display_colors,
                point_size=spacing(asset.display_points),
                point_shape="circle",
                precision="float32",
            )
        self.frame_camera()

    def _show_ground(self, asset: OpenedAsset) -> None:
        diagonal = asset.diagonal
        low, high = asset.bounds
        span = float(max(high[0] - low[0], high[1] - low[1], 0.2 * diagonal))
        cell = 10.0 ** np.floor(np.log10(span)) / 2
        self._scene.add_grid(
            "/ground",
            width=4 * span,
            height=4 * span,
            position=(*((low + high) / 2)[:2], float(low[2]) - 1e-3 * diagonal),
            cell_size=float(cell),
            section_size=float(2 * cell),
            cell_color=(205, 210, 216),
            section_color=(184, 190, 198),
            infinite_grid=True,
            fade_distance=8 * span,
        )

    def frame_camera(self) -> None:
        """Aim from the front, the side and above, with the whole object in the picture."""
        if self._asset is None:
            return
        asset, camera = self._asset, self._client.camera
        low, high = asset.bounds
        center = (low + high) / 2
        front = np.asarray(asset.front)
        side = np.cross(front, (0.0, 0.0, 1.0))
        direction = front + 0.5 * side + np.array([0.0, 0.0, 0.45])
        direction /= np.linalg.norm(direction)
        aspect = max(min(camera.aspect or 1.5, 2.5), 0.4)
        half = min(FIELD_OF_VIEW / 2, np.arctan(np.tan(FIELD_OF_VIEW / 2) * aspect))
        distance = 0.5 * asset.diagonal / np.sin(half) * 1.08
        with self._client.atomic():
            camera.fov = FIELD_OF_VIEW
            camera.up_direction = (0.0, 0.0, 1.0)
            camera.position = center + distance * direction
            camera.look_at = center  # after the position, which carries the old one along
            camera.near = max(distance * 1e-3, 1e-4)
            camera.far = distance * 100

    # --- labels

    def show_labels(self, labels: npt.NDArray[np.int16] | None, hidden: frozenset[int]) -> None:
        """Tint the parts. Sends only the parts that changed."""
        asset = self._asset
        if asset is None:
            return
        if self._same(labels) and hidden == self._hidden:
            self._labels = labels
            return
        before, self._hidden = self._labels, hidden
        if asset.display_points is not None:
            self._tint_cloud(asset, labels, hidden)
            self._labels = labels
            return
        now = set() if labels is None else {int(i) for i in np.unique(labels)}
        with self._client.atomic():
            for part in set(self._tints) | now:
                same = (
                    before is not None
                    and labels is not None
                    and part in self._tints
                    and np.array_equal(before == part, labels == part)
                )
                if not same:
                    self._tint_mesh(part, labels)
                if part in self._tints:
                    self._tints[part].visible = part not in hidden and not self._moving
        self._labels = labels

    @property
    def labels(self) -> npt.NDArray[np.int16] | None:
        """The labels that were drawn last."""
        return self._labels

    def _same(self, labels: npt.NDArray[np.int16] | None) -> bool:
        if labels is None or self._labels is None:
            return labels is self._labels
        return labels is self._labels or np.array_equal(labels, self._labels)

    def _tint_cloud(
        self,
        asset: OpenedAsset,
        labels: npt.NDArray[np.int16] | None,
        hidden: frozenset[int],
    ) -> None:
        assert asset.display_colors is not None
        colors = tinted(asset.display_colors, labels)
        if labels is not None and hidden:
            colors[np.isin(labels, list(hidden))] = 250
        self._scan.colors = colors

    def _tint_mesh(self, part: int, labels: npt.NDArray[np.int16] | None) -> None:
        asset = self._asset
        assert asset is not None and asset.display_faces is not None
        faces = None if labels is None or part == 0 else asset.display_faces[labels == part]
        known = self._tint_vertices.get(part)
        if faces is not None and len(faces) and known is not None:
            place = known[faces]
            if (place >= 0).all():
                # Its vertices are in the browser already: only the faces are sent.
                self._tints[part].faces = place.astype(np.uint32)
                return
        if part in self._tints:
            self._tints.pop(part).remove()
            del self._tint_vertices[part]
        if faces is None or not len(faces):
            return
        assert self._offset is not None
        used, inverse = np.unique(faces, return_inverse=True)
        place = np.full(len(self._offset), -1, np.int32)
        place[used] = np.arange(len(used))
        self._tint_vertices[part] = place
        self._tints[part] = self._scene.add_mesh_simple(
            f"/tint/{part}",
            self._offset[used],
            inverse.reshape(-1, 3).astype(np.uint32),
            color=palette.part_color(part),
            opacity=TINT_OPACITY,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    # --- prompts

    def show_prompts(self, clicks: Sequence[tuple[int, Click]], visible: bool) -> None:
        """Draw prompt points: part colour where positive, black where negative."""
        asset = self._asset
        if asset is None:
            return
        wanted = dict(clicks) if visible else {}
        for index in [i for i, (c, _) in self._prompts.items() if wanted.get(i) != c]:
            self._prompts.pop(index)[1].remove()
        radius = PROMPT_RADIUS * asset.diagonal
        for index, click in wanted.items():
            if index in self._prompts:
                continue
            handle = self._scene.add_icosphere(
                f"/prompt/{index}",
                radius=radius if click.positive else 0.8 * radius,
                color=palette.part_color(click.part) if click.positive else palette.NEGATIVE,
                subdivisions=2,
                position=click.position,
                cast_shadow=False,
                receive_shadow=False,
            )
            self._prompts[index] = (click, handle)

    def show_hover(
        self,
        gained: npt.NDArray[np.float32] | None,
        lost: npt.NDArray[np.float32] | None,
        color: palette.Rgb,
    ) -> None:
        """Preview what a click would give to a part and take from it."""
        if self._asset is not None:
            self._overlays.show_hover(gained, lost, color, self._asset.diagonal)

    def show_places(self, places: tuple[tuple[float, float, float], ...]) -> None:
        """Mark the places that a cut goes through."""
        if self._asset is not None:
            self._overlays.show_places(places, self._asset.diagonal)

    # --- parts that move

    def show_parts(self, payloads: list[PartPayload] | None, moving: bool) -> None:
        """Draw the parts one by one (``moving``), or the scan as a whole."""
        if moving and payloads is not None and payloads is not self._payloads:
            self._draw_parts(payloads)
        moving = moving and self._payloads is not None and payloads is not None
        if moving == self._moving or self._scan is None:
            return
        self._moving = moving
        with self._client.atomic():
            self._scan.visible = not moving
            for part, tint in self._tints.items():
                tint.visible = not moving and part not in self._hidden
            for part, handles in self._parts.items():
                handles["frame"].visible = moving and part not in self._hidden

    def _draw_parts(self, payloads: list[PartPayload]) -> None:
        assert self._asset is not None
        for handles in self._parts.values():
            handles["frame"].remove()
        self._parts.clear()
        self._payloads = payloads
        self._moving = False
        size = 0.0
        if self._asset.display_points is not None:
            size = spacing(self._asset.display_points)
        for payload in payloads:
            self._parts[payload.part] = self._draw_part(payload, size)

    def _draw_part(self, payload: PartPayload, point_size: float) -> dict[str, Any]:
        name, color = f"/part/{payload.part}", palette.part_color(payload.part)
        out: dict[str, Any] = {"frame": self._scene.add_frame(name, show_axes=False, visible=False)}
        if payload.glb is not None:
            out["mesh"] = self._scene.add_glb(f"{name}/mesh", payload.glb, cast_shadow=False)
            if payload.part and payload.vertices is not None and payload.faces is not None:
                out["tint"] = self._scene.add_mesh_simple(
                    f"{name}/tint",
                    payload.vertices,
                    payload.faces.astype(np.uint32),
                    color=color,
                    opacity=TINT_OPACITY * 0.6,
                    side="double",
                    cast_shadow=False,
                    receive_shadow=False,
                )
            return out
        assert payload.points is not None and payload.colors is not None
        labels = np.full(len(payload.points), payload.part, np.int16)
        out["cloud"] = self._scene.add_point_cloud(
            f"{name}/cloud",
            payload.points,
            tinted(payload.colors, labels),
            point_size=point_size,
            point_shape="circle",
            precision="float32",
        )
        return out

    def hide_parts(self, hidden: frozenset[int]) -> None:
        """Which parts stay out of the picture while joints move."""
        for part, handles in self._parts.items():
            handles["frame"].visible = self._moving and part not in hidden

    def pose(self, posed_from_rest: Mapping[str, npt.NDArray[np.float64]]) -> None:
        """Move the drawn parts and their axes; one message for all."""
        with self._client.atomic():
            for part, handles in self._parts.items():
                transform = posed_from_rest.get(f"link_{part}")
                if transform is None:
                    continue
                frame = handles["frame"]
                frame.wxyz = vtf.SO3.from_matrix(transform[:3, :3]).wxyz
                frame.position = transform[:3, 3]

    def pretend_parts(self, parts: Iterable[int]) -> None:
        """Frames without geometry, to measure how fast poses are sent."""
        self._parts = {
            k: {"frame": self._scene.add_frame(f"/part/{k}", show_axes=False)} for k in parts
        }

    # --- axes and contacts

    def show_axes(self, marks: Iterable[AxisMark]) -> None:
        """Draw joint axes as arrows; only those that changed are sent."""
        wanted = {m.key: m for m in marks}
        for key in [k for k, (m, _) in self._axes.items() if wanted.get(k) != m]:
            self._axes.pop(key)[1].remove()
        diagonal = self._asset.diagonal if self._asset is not None else 1.0
        for key, mark in wanted.items():
            if key in self._axes:
                continue
            origin, axis = np.asarray(mark.origin), np.asarray(mark.axis)
            width = diagonal * (0.0042 if mark.thick else 0.0026)
            ends = np.stack([origin - 0.5 * mark.length * axis, origin + 0.62 * mark.length * axis])
            self._axes[key] = (
                mark,
                self._scene.add_arrows(
                    f"/axis/{key}",
                    ends[None].astype(np.float32),
                    mark.color,
                    shaft_radius=width,
                    head_radius=2.6 * width,
                    head_length=6.5 * width,
                ),
            )

    def show_contacts(self, checks: Sequence[JointCheck], visible: bool) -> None:
        """Mark where a sweep hits something."""
        hits = tuple(c.where for c in checks) if visible else ()
        if hits == self._contact_key or self._asset is None:
            return
        self._contact_key = hits
        for handle in self._contacts:
            handle.remove()
        radius = 0.009 * self._asset.diagonal
        self._contacts = [
            self._scene.add_icosphere(
                f"/contact/{k}",
                radius=radius,
                color=palette.CONTACT,
                subdivisions=2,
                opacity=0.85,
                position=where,
                cast_shadow=False,
                receive_shadow=False,
            )
            for k, where in enumerate(hits)
        ]

    def show_moment(self, where: tuple[float, float, float] | None, text: str) -> None:
        """Mark one contact so that it is seen through the parts; None takes the mark away."""
        for handle in self._moment:
            handle.remove()
        self._moment = []
        if where is None or self._asset is None:
            return
        radius = 0.016 * self._asset.diagonal
        ball = self._scene.add_icosphere(
            "/moment",
            radius=radius,
            color=palette.CONTACT,
            subdivisions=2,
            opacity=0.9,
            position=where,
            cast_shadow=False,
            receive_shadow=False,
        )
        # Labels are drawn over everything, the ball is inside of what meets there.
        cross = self._scene.add_label("/moment/cross", "✖", anchor="center-center")
        label = self._scene.add_label(
            "/moment/label", text, position=(0.0, 0.0, 2.5 * radius), anchor="bottom-center"
        )
        self._moment = [cross, label, ball]

    def show_touch_pad(self, wanted: bool) -> Any:
        """An invisible box that a finger can tap, since scene clicks don't fire on touch."""
        if wanted and self.touch is None and self._asset is not None:
            low, high = self._asset.bounds
            margin = 0.02 * self._asset.diagonal
            size = high - low + 2 * margin
            self.touch = self._scene.add_box(
                "/touch",
                dimensions=size,
                position=(low + high) / 2,
                opacity=0.0,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
        elif not wanted and self.touch is not None:
            self.touch.remove()
            self.touch = None
        return self.touch


def set_stage(scene: viser.SceneApi) -> None:
    """Light and backdrop."""
    scene.configure_default_lights(cast_shadow=False)
    scene.set_background_image(_backdrop(), format="png")


def _backdrop() -> npt.NDArray[np.uint8]:
    """A soft vertical gradient, so that white scans stand out."""
    t = np.linspace(0.0, 1.0, 128)[:, None, None]
    top, bottom = np.array([222.0, 228.0, 236.0]), np.array([243.0, 244.0, 246.0])
    return np.repeat(top + t * (bottom - top), 4, axis=1).astype(np.uint8)


def axis_length(payloads: Sequence[PartPayload] | None, joint: Joint, diagonal: float) -> float:
    """A length that lets the arrow stand out of its part at both ends."""
    part = joint.child.removeprefix("link_")
    for payload in payloads or ():
        if str(payload.part) == part:
            points = payload.vertices if payload.vertices is not None else payload.points
            if points is not None and len(points):
                along = points @ np.asarray(joint.axis, np.float32)
                return float(np.clip(1.25 * np.ptp(along), 0.12 * diagonal, 1.1 * diagonal))
    return 0.3 * diagonal


def tinted(
    colors: npt.NDArray[np.uint8], labels: npt.NDArray[np.int16] | None
) -> npt.NDArray[np.uint8]:
    """Scan colours with the parts' colours laid over; (N, 3) uint8. The base keeps its own."""
    if labels is None:
        return np.array(colors)
    top = int(labels.max()) + 1 if len(labels) else 1
    table = np.array([palette.part_color(i) for i in range(top)], np.float32)
    weight = np.full(top, CLOUD_TINT, np.float32)
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
