"""Nodes of a scene in a browser: merged surroundings, instances of assets, scans; and rays that are
cast on them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import viser
from viser import transforms as vtf

from app.server.scene_state import Work
from app.server.scene_tasks import BOX, Shape
from app.viewer.picture import palette
from model.core.geometry import Material, Mesh
from model.geometry.picking import DEFAULT_PIXEL_ANGLE, TOLERANCE, rings_around
from model.io.write import mesh_to_glb

Array = npt.NDArray[np.float64]
NEAR_RAY = 0.015
"""Share of a cloud's diagonal: points nearer than this to the ray are hit."""
_WIDE = float(np.tan((TOLERANCE + 1) * DEFAULT_PIXEL_ANGLE))
"""Share of the distance: points farther than this from a ray are beyond the tolerance."""


def hit_distance(
    origin: Array,
    direction: Array,
    vertices: npt.NDArray[np.float32],
    faces: npt.NDArray[np.uint32] | None,
) -> float:
    """Multiples of ``direction`` up to the first hit; infinity where there is none.

    Args:
        vertices: (V, 3), of a cloud its points.
        faces: (F, 3), or None for a cloud.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    reach = 0.0 if faces is not None else NEAR_RAY * float(np.linalg.norm(high - low))
    if not meets_boxes(origin, direction, np.array([[low - reach, high + reach]]))[0]:
        return np.inf
    if faces is None:
        return _cloud_hit(origin, direction, vertices.astype(np.float64), reach)
    return _mesh_hit(origin, direction, vertices.astype(np.float64)[faces])


def nearly_hit(
    origin: Array,
    direction: Array,
    vertices: npt.NDArray[np.float32],
    faces: npt.NDArray[np.uint32] | None,
) -> tuple[int, float]:
    """By how many pixels a ray passes a mesh at most, and multiples of it up to there.

    Both are infinite (and beyond the tolerance) where it passes farther away; clouds have a
    tolerance in :func:`hit_distance`.
    """
    missed = TOLERANCE + 1, np.inf
    if faces is None:
        return missed
    triangles = vertices.astype(np.float64)[faces]
    middle = triangles.mean(axis=1)
    reach = np.linalg.norm(triangles - middle[:, None], axis=2).max(axis=1)
    unit = direction / np.linalg.norm(direction)
    away = middle - origin
    along = away @ unit
    off = np.linalg.norm(away - along[:, None] * unit, axis=1)
    near = triangles[off <= 1.01 * reach + _WIDE * np.maximum(along + reach, 0.0)]
    if not len(near):
        return missed
    for pixels, ring in enumerate(rings_around(direction), start=1):
        distance = min(_mesh_hit(origin, d, near) for d in ring)
        if np.isfinite(distance):
            return pixels, distance
    return missed


def meets_boxes(origin: Array, direction: Array, boxes: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """(N,) which of the (N, 2, 3) axis-parallel boxes a ray goes through."""
    enter, leave = through_box(origin, direction, boxes[:, 0], boxes[:, 1])
    return leave >= np.maximum(enter, 0.0)


def through_box(origin: Array, direction: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """(N,) multiples of ``direction`` at which rays enter and leave axis-parallel boxes."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origin) / direction, (high - origin) / direction
    return np.fmax.reduce(np.fmin(a, b), axis=1), np.fmin.reduce(np.fmax(a, b), axis=1)


def within_tolerance(origin: Array, boxes: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(N, 2, 3) boxes that are wider by what a ray from ``origin`` may pass them by."""
    far = np.abs(boxes - origin).max(axis=1)  # (N, 3) to the farther side
    wide = _WIDE * np.linalg.norm(far, axis=1)[:, None]
    return np.stack([boxes[:, 0] - wide, boxes[:, 1] + wide], axis=1)


def _mesh_hit(origin: Array, direction: Array, triangles: Array) -> float:
    """Möller and Trumbore, 1997, both sides of every triangle."""
    a = triangles[:, 0]
    e1, e2 = triangles[:, 1] - a, triangles[:, 2] - a
    p = np.cross(direction, e2)
    det = (e1 * p).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / det
        s = origin - a
        u = (s * p).sum(axis=1) * inverse
        q = np.cross(s, e1)
        v = (q @ direction) * inverse
        t = (e2 * q).sum(axis=1) * inverse
    hit = (np.abs(det) > 1e-14) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return float(t[hit].min()) if hit.any() else np.inf


def _cloud_hit(origin: Array, direction: Array, points: Array, reach: float) -> float:
    length = float(np.linalg.norm(direction))
    unit = direction / length
    along = (points - origin) @ unit
    off = np.linalg.norm(points - origin - along[:, None] * unit, axis=1)
    hit = (off < reach) & (along > 0)
    return float(along[hit].min()) / length if hit.any() else np.inf


GHOST_OPACITY = 0.14
TINT = 0.6
"""Share of a state's color in the points of a scan."""


@dataclass(eq=False)
class Placement:
    """Pose and scale of an object: a vertex v is at ``world @ (scale * v)``."""

    world: Array
    scale: Array

    def of(self, points: npt.NDArray[np.floating[Any]]) -> Array:
        """(N, 3) the object's points in the scene's frame."""
        return np.asarray((points * self.scale) @ self.world[:3, :3].T + self.world[:3, 3])


@dataclass(frozen=True)
class Look:
    """Appearance of the scene.

    Attributes:
        status: object → its state.
        original_colors: draw everything as in the source; else the static objects alone.
        ghosted: the object that is edited among ghosts, or None.
        chosen: the object whose parts have colors of their own, or None.
    """

    status: Mapping[str, str]
    original_colors: bool
    ghosted: str | None
    chosen: str | None = None

    def part(self, id: str, link: str) -> palette.Rgb | None:
        """The color of the selected object's part; None of everything else."""
        number = link.removeprefix("link_")
        if id != self.chosen or self.ghosted is not None or not number.isdigit():
            return None
        return palette.part_color(int(number))


@dataclass(frozen=True, eq=False)
class Group:
    """Objects that look alike.

    Attributes:
        ids: the objects.
        shape: of each.
        placements: of each, while nothing moves.
        work, link: whose part it is; None and "" of a whole object.
    """

    ids: tuple[str, ...]
    shape: Shape
    placements: Sequence[Placement]
    work: Work | None = None
    link: str = ""


class Node:
    """Something that was sent, with the objects that it draws.

    Attributes:
        rest: where they are while nothing moves. now: where they are.
        work, link: see :class:`Group`.
    """

    def __init__(self, client: viser.ClientHandle, name: str, group: Group) -> None:
        self._client, self._name = client, name
        self.ids, self.shape, self.work, self.link = group.ids, group.shape, group.work, group.link
        self.rest, self.now = list(group.placements), list(group.placements)

    @property
    def handles(self) -> list[Any]:
        """All that was sent."""
        raise NotImplementedError

    def paint(self, look: Look) -> None:
        """Give it this look."""
        raise NotImplementedError

    def _place(self) -> None:
        raise NotImplementedError

    def move(self, posed: Array | None) -> None:
        """Pose it by ``posed_from_rest``, or let it rest."""
        if posed is None and all(a is b for a, b in zip(self.rest, self.now, strict=True)):
            return
        self.now = [s if posed is None else Placement(s.world @ posed, s.scale) for s in self.rest]
        self._place()

    def remove(self) -> None:
        """Take it off the picture."""
        for handle in self.handles:
            handle.remove()

    def boxes(self) -> npt.NDArray[Any]:
        """(N, 2, 3) where each of its objects is."""
        at = np.stack([corners_of(self.shape, s) for s in self.now])
        return np.stack([at.min(1), at.max(1)], axis=1)

    def hit(self, k: int, origin: Array, direction: Array) -> float:
        """Distance along a ray to object ``k``; infinity for a miss."""
        local, along = self._ray_in_object(k, origin, direction)
        return hit_distance(local, along, self.shape.vertices, self._faces(k))

    def nearly_hit(self, k: int, origin: Array, direction: Array) -> tuple[int, float]:
        """By how many pixels a ray passes object ``k``, and how far along; see the function."""
        local, along = self._ray_in_object(k, origin, direction)
        return nearly_hit(local, along, self.shape.vertices, self._faces(k))

    def _ray_in_object(self, k: int, origin: Array, direction: Array) -> tuple[Array, Array]:
        placement = self.now[k]
        turn = placement.world[:3, :3]
        local = ((origin - placement.world[:3, 3]) @ turn) / placement.scale
        return local, (direction @ turn) / placement.scale

    def _faces(self, k: int) -> npt.NDArray[np.uint32] | None:
        return self.shape.faces


class Surroundings(Node):
    """Static meshes in one: a browser draws few nodes faster than many."""

    def __init__(
        self, client: viser.ClientHandle, name: str, solid: Sequence[tuple[str, Shape, Placement]]
    ) -> None:
        vertices, faces, colors, boxes = [], [], [], []
        self._slices: list[slice] = []
        count = start = 0
        for _, shape, placement in solid:
            assert shape.faces is not None
            at = placement.of(shape.vertices)
            vertices.append(at.astype(np.float32))
            boxes.append([at.min(0), at.max(0)])
            faces.append(shape.faces + np.uint32(count))
            colors.append(_colors(shape, len(shape.faces)))
            self._slices.append(slice(start, start + len(shape.faces)))
            count, start = count + len(at), start + len(shape.faces)
        whole = Shape(
            np.zeros((2, 3)),
            np.concatenate(vertices),
            np.concatenate(faces),
            np.concatenate(colors),
        )
        here = [Placement(np.eye(4), np.ones(3)) for _ in solid]
        super().__init__(client, name, Group(tuple(i for i, _, _ in solid), whole, here))
        self.solid, self._boxes = list(solid), np.array(boxes)
        self._original = client.scene.add_glb(
            f"{name}/own", colored_glb(whole), cast_shadow=False, receive_shadow=False
        )
        self._ghost: Any = None

    @property
    def handles(self) -> list[Any]:
        """See :class:`Node`."""
        return [self._original, *([] if self._ghost is None else [self._ghost])]

    @property
    def ghost(self) -> Any:
        """Node shown while an object is edited, or None if that never happened."""
        return self._ghost

    def paint(self, look: Look) -> None:
        """See :class:`Node`."""
        ghost = look.ghosted is not None
        if ghost and self._ghost is None:
            assert self.shape.faces is not None
            self._ghost = self._client.scene.add_mesh_simple(
                f"{self._name}/ghost",
                self.shape.vertices,
                self.shape.faces,
                color=palette.SCENE_GHOST,
                opacity=GHOST_OPACITY,
                flat_shading=True,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
        self._original.visible = not ghost
        if self._ghost is not None:
            self._ghost.visible = ghost

    def boxes(self) -> npt.NDArray[Any]:
        """See :class:`Node`."""
        return self._boxes

    def _faces(self, k: int) -> npt.NDArray[np.uint32] | None:
        assert self.shape.faces is not None
        return self.shape.faces[self._slices[k]]

    def _place(self) -> None:
        raise AssertionError("what is static doesn't move")


class Instances(Node):
    """Instances of a mesh, which is sent once."""

    def __init__(self, client: viser.ClientHandle, name: str, group: Group) -> None:
        super().__init__(client, name, group)
        self._original: Any = None
        self._flat: Any = None
        self._painted: Any = None
        self._hidden: str | None = None

    @property
    def handles(self) -> list[Any]:
        """See :class:`Node`."""
        return [h for h in (self._original, self._flat) if h is not None]

    def paint(self, look: Look) -> None:
        """See :class:`Node`."""
        ghost = look.ghosted is not None
        original_colors = look.original_colors and not ghost
        if original_colors and self._original is None:
            self._original = self._send_original()
        if not original_colors and self._flat is None:
            self._flat = self._send_flat()
        for handle, wanted in (
            (self._original, original_colors),
            (self._flat, not original_colors),
        ):
            if handle is not None:
                handle.visible = wanted
        if not original_colors:
            tones = [palette.SCENE_GHOST if ghost else self._tone(look, i) for i in self.ids]
            if (tones, ghost) != self._painted:
                self._painted = tones, ghost
                self._flat.batched_colors = np.array(tones, np.uint8)
                self._flat.opacity = GHOST_OPACITY if ghost else None
        if look.ghosted != self._hidden:
            self._hidden = look.ghosted
            scales = self._scales()
            for handle in self.handles:
                handle.batched_scales = scales

    def _tone(self, look: Look, id: str) -> palette.Rgb:
        part = look.part(id, self.link)
        return palette.SCENE_ALBEDO[look.status[id]] if part is None else palette.albedo(part)

    def _send_original(self) -> Any:
        return self._client.scene.add_batched_glb(
            f"{self._name}/own",
            colored_glb(self.shape),
            self._turns(),
            self._positions(),
            batched_scales=self._scales(),
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _send_flat(self) -> Any:
        assert self.shape.faces is not None
        return self._client.scene.add_batched_meshes_simple(
            f"{self._name}/flat", self.shape.vertices, self.shape.faces, self._turns(),
            self._positions(), batched_scales=self._scales(),
            batched_colors=np.full((len(self.ids), 3), 180, np.uint8), lod="off",
            flat_shading=True, side="double", cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _place(self) -> None:
        for handle in self.handles:
            handle.batched_wxyzs = self._turns()
            handle.batched_positions = self._positions()

    def _turns(self) -> npt.NDArray[np.float32]:
        return np.array([wxyz_of(s.world) for s in self.now], np.float32)

    def _positions(self) -> npt.NDArray[np.float32]:
        return np.array([s.world[:3, 3] for s in self.now], np.float32)

    def _scales(self) -> npt.NDArray[np.float32]:
        scales = [s.scale * (i != self._hidden) for i, s in zip(self.ids, self.now, strict=True)]
        return np.array(scales, np.float32)


class Scans(Node):
    """Point clouds, one for each object."""

    def __init__(self, client: viser.ClientHandle, name: str, group: Group) -> None:
        super().__init__(client, name, group)
        self._colors = _colors(self.shape, len(self.shape.vertices))
        self._painted: list[Any] = ["own"] * len(self.rest)
        self._handles: list[Any] = [
            client.scene.add_point_cloud(
                f"{name}/{k}",
                (self.shape.vertices * placement.scale).astype(np.float32),
                self._colors,
                precision="float32",
                point_size=self.point_size(k),
                point_shape="circle",
                wxyz=wxyz_of(placement.world),
                position=placement.world[:3, 3],
            )
            for k, placement in enumerate(self.rest)
        ]

    @property
    def handles(self) -> list[Any]:
        """See :class:`Node`."""
        return self._handles

    def paint(self, look: Look) -> None:
        """See :class:`Node`."""
        for k, (id, handle) in enumerate(zip(self.ids, self._handles, strict=True)):
            status = look.status[id]
            part = look.part(id, self.link)
            wanted = "own" if look.original_colors or status == "static" else part or status
            handle.visible = look.ghosted is None  # their ghosts are one cloud, see ghosts.py
            if handle.visible and wanted != self._painted[k]:
                self._painted[k] = wanted
                handle.colors = self._toned(wanted)

    def point_size(self, k: int) -> float:
        """Diameter of a point of object ``k``, metres."""
        return self.shape.spacing * float(np.abs(self.rest[k].scale).max())

    def points_in_place(self, k: int) -> Array:
        """(N, 3) object ``k``'s points in the scene's frame."""
        return self.now[k].of(self.shape.vertices)

    def _toned(self, wanted: Any) -> npt.NDArray[np.uint8]:
        if wanted == "own":
            return self._colors
        color = palette.SCENE_COLORS[wanted] if isinstance(wanted, str) else wanted
        tone = np.asarray(color, np.float64)
        return (TINT * tone + (1 - TINT) * self._colors).astype(np.uint8)

    def _place(self) -> None:
        for handle, placement in zip(self._handles, self.now, strict=True):
            handle.wxyz = wxyz_of(placement.world)
            handle.position = placement.world[:3, 3]


def send(client: viser.ClientHandle, name: str, group: Group) -> Node:
    """Send a shape with all its placements."""
    kind = Scans if group.shape.faces is None else Instances
    return kind(client, name, group)


def first_under(nodes: Sequence[Node], origin: Array, direction: Array) -> str | None:
    """The object that a ray meets first, or None.

    What the ray itself passes by counts within a few pixels where it meets nothing.
    """
    best, hit = np.inf, None
    for node in nodes:
        for k in np.flatnonzero(meets_boxes(origin, direction, node.boxes())):
            t = node.hit(int(k), origin, direction)
            if t < best:
                best, hit = t, node.ids[k]
    if hit is not None:
        return hit
    nearest = TOLERANCE + 1, np.inf
    for node in nodes:
        boxes = within_tolerance(origin, node.boxes())
        for k in np.flatnonzero(meets_boxes(origin, direction, boxes)):
            passed = node.nearly_hit(int(k), origin, direction)
            if passed < nearest:
                nearest, hit = passed, node.ids[k]
    return hit


def colored_glb(shape: Shape) -> bytes:
    """A shape with faces in their own colors; a vertex is there once for each of its colors."""
    assert shape.faces is not None
    rgb = _colors(shape, len(shape.faces)).astype(np.int64)
    packed = (rgb[:, 0] << 16) | (rgb[:, 1] << 8) | rgb[:, 2]
    key = (shape.faces.astype(np.int64) << 24) | packed[:, None]
    unique, corner = np.unique(key, return_inverse=True)
    rgba = np.stack([unique >> 16 & 255, unique >> 8 & 255, unique & 255, 0 * unique + 255], 1)
    mesh = Mesh(
        shape.vertices[unique >> 24].astype(np.float64),
        corner.reshape(-1, 3).astype(np.int32),
        materials=(Material("own", (255, 255, 255, 255)),),
        vertex_colors=rgba.astype(np.uint8),
    )
    return mesh_to_glb(mesh, smooth=False)


def _colors(shape: Shape, count: int) -> npt.NDArray[np.uint8]:
    if shape.colors is not None:
        return shape.colors
    return np.tile(np.asarray(palette.SCENE_COLORS["static"], np.uint8), (count, 1))


def corners_of(shape: Shape, placement: Placement, margin: float = 0.0) -> npt.NDArray[Any]:
    """(8, 3) corners of an object's box in the scene's frame, ``margin`` of its size around it."""
    low, high = np.sort(shape.bounds * placement.scale, axis=0)
    reach = margin * float(np.linalg.norm(high - low))
    local = (low + high) / 2 + BOX.vertices.astype(np.float64) * (high - low + 2 * reach)
    return np.asarray(local @ placement.world[:3, :3].T + placement.world[:3, 3])


def wxyz_of(transform: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float64]:
    """The rotation as a quaternion."""
    return np.asarray(vtf.SO3.from_matrix(transform[:3, :3]).wxyz, np.float64)
