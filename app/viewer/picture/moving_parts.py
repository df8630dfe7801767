"""The parts of an object, drawn one by one so that joints can move them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import viser
from viser import transforms as vtf

from app.server.display_tasks import PartPayload
from app.viewer.picture.label_overlay import OPACITY, add_overlay_mesh, overlay_colors
from app.viewer.picture.scene_rays import hit_distance, nearly_hit
from model.geometry.picking import TOLERANCE


class MovingParts:
    """One frame a part in one client's scene.

    Args:
        point_size: of a cloud, metres.
    """

    def __init__(self, client: viser.ClientHandle, point_size: float = 0.0) -> None:
        self._client = client
        self._point_size = point_size
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
            if payload.part and payload.vertices is not None and payload.faces is not None:
                add_overlay_mesh(
                    scene,
                    f"{name}/tint",
                    payload.part,
                    payload.vertices,
                    payload.faces,
                    OPACITY * 0.8,
                )
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
                return payload.points if payload.vertices is None else payload.vertices
        return None

    def posed(
        self, hidden: frozenset[int]
    ) -> list[tuple[npt.NDArray[np.floating], npt.NDArray[Any] | None]]:
        """(V, 3) vertices or points of the parts where they are now, and (F, 3) faces or None."""
        out = []
        for payload in self._payloads or ():
            shape = payload.points if payload.vertices is None else payload.vertices
            if shape is not None and payload.part not in hidden:
                pose = self._poses.get(f"link_{payload.part}", np.eye(4))
                out.append((shape @ pose[:3, :3].T + pose[:3, 3], payload.faces))
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
            if payload.part in hidden:
                continue
            shape = payload.points if payload.vertices is None else payload.vertices
            if shape is None or not len(shape):
                continue
            rest = np.linalg.inv(self._poses.get(f"link_{payload.part}", np.eye(4)))
            start = rest[:3, :3] @ np.asarray(origin, np.float64) + rest[:3, 3]
            along = rest[:3, :3] @ np.asarray(direction, np.float64)
            faces = None if payload.faces is None else payload.faces.astype(np.uint32)
            distance = measure(start, along, shape, faces)
            if distance < nearest:
                nearest, found = distance, payload.part
        return found

    def pretend(self, parts: Iterable[int]) -> None:
        """Frames without geometry, to measure how fast poses are sent."""
        scene = self._client.scene
        self._frames = {k: scene.add_frame(f"/part/{k}", show_axes=False) for k in parts}
