"""Picture of an object in one browser tab. Draws differences only; decides nothing.

Node names are flat (``/part/<id>``), since viser's node names are its scene tree: link poses come
from forward kinematics on the server, not from nesting.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
import viser

from app.server.display_tasks import OpenedAsset, PartPayload, front_direction
from app.viewer.picture import palette
from app.viewer.picture.marks import CommentMarks, JointMarks, Overlays
from app.viewer.picture.object_nodes import LabelOverlay, MovingParts
from app.viewer.picture.scene_nodes import wxyz_of
from app.viewer.picture.stage import (
    LIGHT_ROOT,
    SCENE_ROOT,
    add_ball,
    add_floor,
    aim,
    fitting_distance,
    may_be_a_room,
    set_stage,
    view_direction,
)
from model.geometry.display import spacing
from model.segmentation.prompts import Click

PROMPT_RADIUS = 0.0075
View = Literal["front", "side", "top"]
_VIEWS: Final[dict[View, tuple[float, float]]] = {
    "front": (0.0, 0.0),
    "side": (1e3, 0.0),
    "top": (0.0, 1e2),
}
"""Offsets aside and above the front."""
_OTHER_SHAPE = 0.02
"""Share of the aspect: a larger change, as where panels open, asks for another distance."""


class ObjectPicture:
    """The 3D scene of one client: the object as a whole, or its parts while joints move.

    Attributes:
        parts: of the object, as they move.
        marks: of its joints.
        overlays: short-lived marks over it.
        touch: the box for fingers, or None.
        scan: the drawn object, or None.
        overlay: its labels and marks, or None.
        dark: whether the floor is drawn for a dark backdrop.
        plain: whether scans are colored by their parts alone.
    """

    def __init__(self, client: viser.ClientHandle, in_scene: bool = False) -> None:
        self._client = client
        self._scene = client.scene
        self._in_scene = in_scene
        self.dark = self.plain = False
        self._forget()

    def _forget(self) -> None:
        """Nothing is drawn."""
        self._asset: OpenedAsset | None = None
        self.scan: Any = None
        self.overlay: LabelOverlay | None = None
        self._frame = np.eye(4)
        self._framed_at: tuple[npt.NDArray[np.float64], float, View | None] | None = None
        self._prompts: dict[int, tuple[Click, Any]] = {}
        self._moving = False
        self.parts = MovingParts(self._client)
        self.marks = JointMarks(self._client)
        self.overlays = Overlays(self._client)
        self.comments = CommentMarks(self._client)
        self.touch: Any = None

    # --- the object

    def clear(self) -> None:
        """Take the object off the picture; a scene around it stays."""
        for name in list(self._scene._handle_from_node_name):
            if not name.startswith((SCENE_ROOT, LIGHT_ROOT)):
                self._scene.remove_by_name(name)
        self._forget()

    def show_asset(self, asset: OpenedAsset, *, keep_view: bool = False) -> None:
        """Draw a newly opened object and aim the camera at it, unless the view is to stay."""
        self.clear()
        self._asset, size = asset, 0.0
        scene = self._scene
        set_stage(scene)
        if not self._in_scene:  # which has a floor of its own
            self._show_ground(asset)
        if asset.glb is not None:
            self.scan = scene.add_glb("/scan", asset.glb, cast_shadow=False)
        else:
            assert asset.display_points is not None and asset.display_colors is not None
            size = spacing(asset.display_points)
            self.scan = scene.add_point_cloud(
                "/scan",
                asset.display_points,
                asset.display_colors,
                point_size=size,
                point_shape="circle",
                precision="float32",
            )
        self.overlay = LabelOverlay(self._client, asset, self.scan)
        self.parts = MovingParts(self._client, size, self.overlay.part_colors)
        self.marks = JointMarks(self._client, asset.diagonal)
        self.overlays = Overlays(self._client, asset.diagonal)
        self.comments = CommentMarks(self._client, asset.diagonal)
        if not keep_view:
            self.frame_camera()

    def show_lit(self, glb: bytes, order: npt.NDArray[np.int32]) -> None:
        """Draw the object's mesh with its light; (T,) the displayed face of each triangle."""
        if self.overlay is None:
            return
        self.scan = self._scene.add_glb("/scan", glb, cast_shadow=False, visible=not self._moving)
        self.overlay.redrawn(order)

    @property
    def shown_upright(self) -> npt.NDArray[np.float64]:
        """(4, 4) from the asset's frame to the one that is shown upright."""
        return self._frame

    def preview(self, object_from_asset: npt.NDArray[np.float64] | None) -> None:
        """Show the object as if it were in another frame, (4, 4); None is its own.

        The camera turns, not the object: what is picked stays where the asset has it.
        """
        frame = np.eye(4) if object_from_asset is None else object_from_asset
        if self._asset is None or np.allclose(frame, self._frame, atol=1e-9):
            return
        self._frame = frame
        if not self._in_scene:
            self._show_ground(self._asset)
        self.frame_camera()

    def _framed(self, asset: OpenedAsset) -> npt.NDArray[np.float64]:
        """(2, 3) bounds in the frame that is shown."""
        if np.array_equal(self._frame, np.eye(4)):
            return asset.bounds
        points = asset.display_centers @ self._frame[:3, :3].T + self._frame[:3, 3]
        return np.percentile(points, [1, 99], axis=0)

    def _show_ground(self, asset: OpenedAsset) -> None:
        diagonal = asset.diagonal
        low, high = self._framed(asset)
        asset_from_shown = np.linalg.inv(self._frame)
        middle = np.array([*((low + high) / 2)[:2], float(low[2]) - 1e-3 * diagonal, 1.0])
        span = float(max(high[0] - low[0], high[1] - low[1], 0.2 * diagonal))
        place, wxyz = (asset_from_shown @ middle)[:3], wxyz_of(asset_from_shown)
        add_floor(self._scene, "/ground", span, place, wxyz, fade=8, dark=self.dark)

    def frame_camera(self, view: View | None = None) -> None:
        """Aim at the whole object: by default from the front, the side and above."""
        if self._asset is None:
            return
        asset, camera = self._asset, self._client.camera
        bounds = self._framed(asset)
        front = asset.front
        if bounds is not asset.bounds:
            faces, points = asset.display_faces, asset.display_vertices
            points = asset.display_centers if points is None else points
            front = front_direction(points @ self._frame[:3, :3].T, faces)
        # Into a room one looks from above: its walls are in the way.
        above = 1.2 if may_be_a_room(bounds) else 0.45
        direction = view_direction(front, above=above)
        if view is not None:
            direction = view_direction(front, *_VIEWS[view])
        asset_from_shown = np.linalg.inv(self._frame)
        center = (asset_from_shown @ [*bounds.mean(0), 1.0])[:3]
        distance = 1.08 * fitting_distance(camera, float(np.linalg.norm(np.ptp(bounds, axis=0))))
        turn = asset_from_shown[:3, :3]
        position = center + distance * (turn @ direction)
        aim(self._client, position, center, least_near=1e-4, up=tuple(turn[:, 2].tolist()))
        self._framed_at = position, float(camera.aspect or 0.0), view

    def refit(self) -> None:
        """Aim again where the picture got another shape and nobody has moved the camera since."""
        if self._framed_at is None:
            return
        (position, aspect, view), camera = self._framed_at, self._client.camera
        near = 1e-3 * float(np.linalg.norm(position - camera.look_at))
        if abs(camera.aspect - aspect) < _OTHER_SHAPE * aspect:
            return
        if np.linalg.norm(position - camera.position) < near:
            self.frame_camera(view)
        else:
            self._framed_at = None

    # --- labels and parts

    def show_labels(self, labels: npt.NDArray[np.int16] | None, hidden: frozenset[int]) -> None:
        """Color the parts. Sends only those that changed."""
        if self.overlay is not None:
            self.overlay.show(labels, hidden, self.plain)

    @property
    def labels(self) -> npt.NDArray[np.int16] | None:
        """The labels that were drawn last."""
        return None if self.overlay is None else self.overlay.labels

    def show_parts(
        self, payloads: list[PartPayload] | None, moving: bool, hidden: frozenset[int]
    ) -> None:
        """Draw the parts one by one where they are ``moving``, else the scan as a whole."""
        if self.overlay is None:
            return
        if moving and payloads is not None and self.parts.draw(payloads):
            self._moving = False
        moving = moving and payloads is not None
        with self._client.atomic():
            if moving != self._moving:
                self._moving = moving
                self.scan.visible = not moving
                self.overlay.set_visible(not moving)
            self.parts.set_visible(moving, hidden)

    def posed_parts(
        self, hidden: frozenset[int]
    ) -> list[tuple[npt.NDArray[np.floating], npt.NDArray[Any] | None]] | None:
        """(V, 3) vertices or points of each part where it is drawn now, and (F, 3) faces or None;
        None where the object is drawn as a whole."""
        return self.parts.posed(hidden) if self._moving else None

    # --- prompts

    def show_prompts(self, clicks: Sequence[tuple[int, Click]], visible: bool) -> None:
        """Draw prompt points: part color where positive, black where negative."""
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
            size = radius if click.positive else 0.8 * radius
            color = palette.part_color(click.part) if click.positive else palette.NEGATIVE
            ball = add_ball(self._scene, f"/prompt/{index}", click.position, size, color)
            self._prompts[index] = (click, ball)

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
