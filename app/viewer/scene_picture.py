"""A whole scene as one browser tab draws it; below one frame, so that all of it can be moved.

Static objects are merged into few meshes. The others are drawn as instances of their asset, which
is sent once however often it stands there; once a working copy has joints, its parts are.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import viser
from viser import transforms as vtf

from app.scene_desk import SceneDesk
from app.scene_rows import Row, Work
from app.scene_tasks import SceneItem, Shape
from app.viewer import palette
from app.viewer.scene_rays import hit_distance, meets_boxes
from app.viewer.scene_view import FIELD_OF_VIEW, SCENE_ROOT, set_stage

ROOT = SCENE_ROOT
GHOST_OPACITY = 0.14
POINT_SHARE = 0.006
Array = npt.NDArray[np.float64]
Ids = tuple[str, ...]

_CORNERS = np.array([[i >> k & 1 for k in range(3)] for i in range(8)], np.float32) - 0.5
_BOX = Shape(
    np.array([[-0.5] * 3, [0.5] * 3]),
    _CORNERS,
    np.array([[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
              [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]], np.uint32),
)  # fmt: skip
_EDGES = np.array([[a, a | bit] for bit in (1, 2, 4) for a in range(8) if not a & bit])


@dataclass(eq=False)
class Stand:
    """Where an object stands: a vertex v is at ``world @ (scale * v)``."""

    world: Array
    scale: Array


@dataclass(eq=False)
class Node:
    """Something that was sent, with the objects that it draws.

    Attributes:
        handles: one for all instances, or of a cloud one for each.
        rest: where its instances are while nothing moves.
        now: where they are.
        faces: of merged objects, each one's faces.
        boxes: of merged objects, (N, 2, 3) each one's place.
    """

    ids: Ids
    shape: Shape
    handles: list[Any]
    rest: list[Stand]
    now: list[Stand]
    work: Work | None = None
    link: str = ""
    faces: list[slice] | None = None
    boxes: npt.NDArray[Any] | None = None


class ScenePicture:
    """The scene of one client."""

    def __init__(self, client: viser.ClientHandle, desk: SceneDesk) -> None:
        self._client = client
        self._desk = desk
        self._root: Any = None
        # The tab's threads draw, animate and pick at the same time.
        self._lock = threading.RLock()
        self._nodes: dict[tuple[Any, ...], Node] = {}
        self._chunks = 0
        self._floor: tuple[float, float] | None = None
        self._outline: list[Any] = []
        self._outlined: Any = None
        self._looks: Any = None
        self.ghosted: str | None = None
        self.camera: tuple[Any, ...] | None = None

    # --- what stands where

    def stand(self, item: SceneItem) -> tuple[Shape, Stand] | None:
        """An object's shape and place; None where it isn't known (yet)."""
        if item.obj.box is not None:
            return _BOX, Stand(item.obj.world_from_object, np.asarray(item.obj.box))
        shape = None if item.path is None else self._desk.shapes.get(item.path)
        if not isinstance(shape, Shape):
            return None
        placed = item.obj.placed(shape.bounds)
        return shape, Stand(placed.world_from_asset, placed.scale)

    def bounds(self, ids: Sequence[str] | None = None) -> Array | None:
        """(2, 3) of objects in the scene's frame; of all where None."""
        every: list[Array] = []
        for id, item in self._desk.items.items():
            if ids is None or id in ids:
                found = self.stand(item)
                if found is not None:
                    every.append(_corners(*found))
        if not every:
            return None
        points = np.concatenate(every)
        return np.stack([points.min(0), points.max(0)])

    # --- drawing

    @property
    def shown(self) -> frozenset[str]:
        """The objects that were sent."""
        with self._lock:
            return frozenset(i for node in self._nodes.values() for i in node.ids)

    def draw(self, rows: Sequence[Row], selected: str | None) -> None:
        """Send what changed: shapes that arrived, states, what is selected."""
        if self._root is None:
            set_stage(self._client.scene)
            self._root = self._client.scene.add_frame(ROOT, show_axes=False)
        status = {r.id: r.status for r in rows}
        with self._lock, self._client.atomic():
            self._draw_static({i for i, s in status.items() if s == "static"})
            self._draw_instances(self._wanted(status))
            self._draw_looks(status)
            self._draw_outline(selected)
        self._draw_floor()

    def _wanted(self, status: Mapping[str, str]) -> dict[tuple[Any, ...], list[str]]:
        out: dict[tuple[Any, ...], list[str]] = {}
        for id, where in status.items():
            item = self._desk.items[id]
            found = self.stand(item)
            if found is None or where == "missing":
                continue
            if where == "static" and found[0].faces is not None:
                continue  # merged
            work = self._desk.work(id)
            if work is None or work.drawn is None or work.document.tree is None:
                out.setdefault(("whole", item.path), []).append(id)
            else:
                for link in work.drawn.shapes:
                    out.setdefault(("part", work.id, work.drawn.labels, link), []).append(id)
        return out

    def _draw_static(self, ids: set[str]) -> None:
        shown: set[str] = set()
        for key in [k for k in self._nodes if k[0] == "static"]:
            node = self._nodes[key]
            gone = [i for i in node.ids if i not in ids]
            if gone:
                node = self._nodes[key] = self._without(node, gone)
            shown |= set(node.ids)
        fresh = [i for i in self._desk.items if i in ids and i not in shown]
        solid: list[tuple[str, Shape, Stand]] = []
        for id in fresh:
            found = self.stand(self._desk.items[id])
            if found is not None and found[0].faces is not None:
                solid.append((id, *found))
        if solid:
            self._chunks += 1
            self._nodes["static", self._chunks] = self._merged(solid)

    def _merged(self, solid: list[tuple[str, Shape, Stand]]) -> Node:
        vertices, faces, slices, boxes = [], [], [], []
        count = start = 0
        for _, shape, stand in solid:
            assert shape.faces is not None
            at = (shape.vertices * stand.scale) @ stand.world[:3, :3].T + stand.world[:3, 3]
            vertices.append(at.astype(np.float32))
            boxes.append([at.min(0), at.max(0)])
            faces.append(shape.faces + np.uint32(count))
            slices.append(slice(start, start + len(shape.faces)))
            count, start = count + len(at), start + len(shape.faces)
        whole = Shape(np.zeros((2, 3)), np.concatenate(vertices), np.concatenate(faces))
        assert whole.faces is not None
        handle = self._client.scene.add_mesh_simple(
            f"{ROOT}/static/{self._chunks}", whole.vertices, whole.faces,
            color=palette.SCENE_ALBEDO["static"], flat_shading=True, side="double",
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip
        self._looks = None
        here = [Stand(np.eye(4), np.ones(3)) for _ in solid]
        ids = tuple(i for i, _, _ in solid)
        return Node(ids, whole, [handle], here, here, faces=slices, boxes=np.array(boxes))

    def _without(self, node: Node, gone: list[str]) -> Node:
        assert node.shape.faces is not None and node.faces is not None
        kept = [k for k, i in enumerate(node.ids) if i not in gone]
        faces = [node.shape.faces[node.faces[k]] for k in kept]
        ends = np.cumsum([0, *map(len, faces)])
        shape = Shape(
            node.shape.bounds, node.shape.vertices,
            np.concatenate(faces) if faces else np.zeros((0, 3), np.uint32),
        )  # fmt: skip
        handle = node.handles[0]
        if faces:
            handle.faces = shape.faces
        handle.visible = bool(faces)
        slices = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        here = node.rest[: len(kept)]
        ids, boxes = tuple(node.ids[k] for k in kept), node.boxes
        boxes = None if boxes is None else boxes[kept]
        return Node(ids, shape, [handle], here, here, faces=slices, boxes=boxes)

    def _draw_instances(self, wanted: dict[tuple[Any, ...], list[str]]) -> None:
        for key in [k for k in self._nodes if k[0] in ("whole", "part") and k not in wanted]:
            for handle in self._nodes.pop(key).handles:
                handle.remove()
        for key, ids in wanted.items():
            self._draw_group(key, ids)

    def _draw_group(self, key: tuple[Any, ...], ids: list[str]) -> None:
        known = self._nodes.get(key)
        if known is not None and known.ids == tuple(ids):
            return
        if known is not None:
            for handle in known.handles:
                handle.remove()
            del self._nodes[key]
        if not ids:
            return
        stands: list[Stand] = []
        shape: Shape | None = None
        work = self._desk.works.get(key[1]) if key[0] == "part" else None
        for id in ids:
            found = self.stand(self._desk.items[id])
            assert found is not None
            shape, stand = found
            stands.append(Stand(stand.world, np.ones(3)) if key[0] == "part" else stand)
        link = ""
        if key[0] == "part":
            assert work is not None and work.drawn is not None
            link = key[3]
            shape = work.drawn.shapes[link]
        assert shape is not None
        self._looks = None
        handles = self._sent(key[0], shape, stands)
        self._nodes[key] = Node(tuple(ids), shape, handles, stands, list(stands), work, link)

    def _sent(self, kind: str, shape: Shape, stands: list[Stand]) -> list[Any]:
        self._chunks += 1
        name = f"{ROOT}/{kind}/{self._chunks}"
        if shape.faces is None:
            out = []
            for k, stand in enumerate(stands):
                points = (shape.vertices * stand.scale).astype(np.float32)
                out.append(
                    self._client.scene.add_point_cloud(
                        f"{name}/{k}", points, (180, 180, 180), precision="float32",
                        point_size=POINT_SHARE * float(np.linalg.norm(np.ptp(points, axis=0))),
                        point_shape="circle", wxyz=_wxyz(stand.world),
                        position=stand.world[:3, 3],
                    )
                )  # fmt: skip
            return out
        return [
            self._client.scene.add_batched_meshes_simple(
                name, shape.vertices, shape.faces,
                np.array([_wxyz(s.world) for s in stands], np.float32),
                np.array([s.world[:3, 3] for s in stands], np.float32),
                batched_scales=np.array([s.scale for s in stands], np.float32),
                batched_colors=np.full((len(stands), 3), 180, np.uint8),
                lod="off", flat_shading=True, side="double", cast_shadow=False,
                receive_shadow=False,
            )
        ]  # fmt: skip

    def _draw_looks(self, status: Mapping[str, str]) -> None:
        """Colours by state; all but one object ghosted while that one is worked on."""
        looks = (tuple(status.items()), self.ghosted)
        if looks == self._looks:
            return
        self._looks = looks
        ghost = self.ghosted is not None
        for key, node in self._nodes.items():
            lit = palette.SCENE_COLORS if node.shape.faces is None else palette.SCENE_ALBEDO
            colors = [palette.SCENE_GHOST if ghost else lit[status[i]] for i in node.ids]
            if node.shape.faces is None:
                for id, handle, color in zip(node.ids, node.handles, colors, strict=True):
                    handle.colors = np.asarray(color, np.uint8)
                    handle.visible = id != self.ghosted
                continue
            handle = node.handles[0]
            handle.opacity = GHOST_OPACITY if ghost else None
            if key[0] == "static":
                handle.color = palette.SCENE_GHOST if ghost else lit["static"]
                continue
            handle.batched_colors = np.array(colors, np.uint8)
            scales = [s.scale * (i != self.ghosted) for i, s in
                      zip(node.ids, node.now, strict=True)]  # fmt: skip
            handle.batched_scales = np.array(scales, np.float32)

    def _draw_floor(self) -> None:
        bounds = self.bounds()
        if bounds is None:
            return
        span = float(max(np.ptp(bounds[:, :2], axis=0).max(), 0.5))
        floor = (round(float(bounds[0, 2]), 3), round(span, 1))
        if floor == self._floor:
            return
        first, self._floor = self._floor is None, floor
        cell = 10.0 ** np.floor(np.log10(span)) / 2
        self._client.scene.add_grid(
            f"{ROOT}/ground", width=4 * span, height=4 * span,
            position=(*bounds.mean(0)[:2], float(bounds[0, 2]) - 2e-3), cell_size=float(cell),
            section_size=float(2 * cell), cell_color=(205, 210, 216),
            section_color=(184, 190, 198), infinite_grid=True, fade_distance=6 * span,
        )  # fmt: skip
        if self.ghosted is None and (first or self.camera is None):
            self.frame()

    def _draw_outline(self, selected: str | None) -> None:
        found = None if selected is None else self._desk.items.get(selected)
        stand = None if found is None or self.ghosted is not None else self.stand(found)
        key = None if stand is None else (selected, stand[1].world.tobytes())
        if key == self._outlined:
            return
        self._outlined = key
        for handle in self._outline:
            handle.remove()
        self._outline = []
        if stand is None:
            return
        corners = _corners(*stand, margin=0.012)
        size = float(np.linalg.norm(np.ptp(corners, axis=0)))
        self._outline = [
            self._client.scene.add_line_segments(
                f"{ROOT}/outline", corners[_EDGES].astype(np.float32), palette.SELECTED,
                thickness=2.5, thickness_units="screen",
            ),
            self._client.scene.add_label(
                f"{ROOT}/name", (selected or "")[:60], anchor="bottom-center",
                position=(*corners.mean(0)[:2], float(corners[:, 2].max()) + 0.02 * size),
            ),
        ]  # fmt: skip

    # --- working on one object in place

    def ghost(self, id: str) -> None:
        """Everything but one object becomes a ghost around it, in that object's frame."""
        view = self._client.camera
        if self.ghosted is None:
            self.camera = (np.array(view.position), np.array(view.look_at))
        self.ghosted = id
        world = self._desk.world_from_copy(self._desk.items[id])
        if world is not None and self._root is not None:
            object_from_world = np.linalg.inv(world)
            self._root.wxyz = _wxyz(object_from_world)
            self._root.position = object_from_world[:3, 3]

    def unghost(self) -> None:
        """Back to the scene's frame and to where the camera was."""
        self.ghosted = None
        if self._root is not None:
            self._root.wxyz, self._root.position = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if self.camera is not None:
            self._aim(*self.camera)

    # --- camera

    def frame(self, ids: Sequence[str] | None = None) -> None:
        """Aim at objects from where the camera looks now, or at the whole scene from above."""
        bounds = self.bounds(ids)
        if bounds is None:
            return
        center, size = bounds.mean(0), float(np.linalg.norm(np.ptp(bounds, axis=0)))
        camera = self._client.camera
        if ids is None:
            direction = np.array([0.42, -0.72, 0.55])
        else:
            direction = np.array(camera.position) - np.array(camera.look_at)
            direction[2] = max(direction[2], 0.35 * float(np.linalg.norm(direction[:2])))
        direction /= max(float(np.linalg.norm(direction)), 1e-9)
        aspect = max(min(camera.aspect or 1.5, 2.5), 0.4)
        half = min(FIELD_OF_VIEW / 2, np.arctan(np.tan(FIELD_OF_VIEW / 2) * aspect))
        close = 0.5 * size / np.sin(half)
        distance = close * (0.82 if ids is None else 1.9)
        self._aim(center + distance * direction, center)
        self.camera = (center + distance * direction, center)

    def _aim(self, position: Array, look_at: Array) -> None:
        camera = self._client.camera
        distance = float(np.linalg.norm(position - look_at))
        with self._client.atomic():
            camera.fov = FIELD_OF_VIEW
            camera.up_direction = (0.0, 0.0, 1.0)
            camera.position = position
            camera.look_at = look_at  # after the position, which carries the old one along
            camera.near = max(distance * 1e-3, 1e-3)
            camera.far = max(distance * 100, 100.0)

    # --- motion

    def pose(self, moved: Mapping[int, Mapping[str, Array]]) -> None:
        """Move parts: session id → link → posed_from_rest; those not named rest."""
        with self._lock, self._client.atomic():
            for node in self._nodes.values():
                if node.work is None:
                    continue
                posed = moved.get(node.work.id, {}).get(node.link)
                at = [s if posed is None else Stand(s.world @ posed, s.scale) for s in node.rest]
                if posed is None and all(a is b for a, b in zip(at, node.now, strict=True)):
                    continue
                node.now = at
                if node.shape.faces is None:
                    for handle, stand in zip(node.handles, at, strict=True):
                        handle.wxyz = _wxyz(stand.world)
                        handle.position = stand.world[:3, 3]
                    continue
                handle = node.handles[0]
                handle.batched_wxyzs = np.array([_wxyz(s.world) for s in at], np.float32)
                handle.batched_positions = np.array([s.world[:3, 3] for s in at], np.float32)

    # --- picking

    def pick(self, origin: Array, direction: Array) -> str | None:
        """The object under a ray of the scene's frame, where its parts are now."""
        best, hit = np.inf, None
        with self._lock:
            nodes = list(self._nodes.values())
        for node in nodes:
            boxes = node.boxes
            if boxes is None:
                corners = np.stack([_corners(node.shape, s) for s in node.now])
                boxes = np.stack([corners.min(1), corners.max(1)], axis=1)
            for k in np.flatnonzero(meets_boxes(origin, direction, boxes)):
                stand, faces = node.now[k], node.shape.faces
                if node.faces is not None and faces is not None:
                    faces = faces[node.faces[k]]
                turn = stand.world[:3, :3]
                local = ((origin - stand.world[:3, 3]) @ turn) / stand.scale
                along = (direction @ turn) / stand.scale
                t = hit_distance(local, along, node.shape.vertices, faces)
                if t < best:
                    best, hit = t, node.ids[k]
        return hit


def _corners(shape: Shape, stand: Stand, margin: float = 0.0) -> npt.NDArray[Any]:
    """(8, 3) corners of an object's box in the scene's frame, ``margin`` of its size around it."""
    low, high = shape.bounds * stand.scale
    reach = margin * float(np.linalg.norm(high - low))
    local = (low + high) / 2 + _CORNERS.astype(np.float64) * (high - low + 2 * reach)
    return np.asarray(local @ stand.world[:3, :3].T + stand.world[:3, 3])


def _wxyz(transform: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float64]:
    return np.asarray(vtf.SO3.from_matrix(transform[:3, :3]).wxyz, np.float64)
