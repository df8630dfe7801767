"""A whole scene as one browser tab draws it; below one frame, so that all of it can be moved.

Static objects are merged into few meshes. The others are drawn as instances of their asset, which
is sent once however often it stands there; once a working copy has joints, its parts are.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import viser
from viser import transforms as vtf

from app.server.display_tasks import front_direction
from app.server.scene_state import Row
from app.server.scene_tasks import SceneItem, Shape, placed
from app.server.scene_workspace import SceneWorkspace
from app.viewer.picture import palette
from app.viewer.picture.ghosts import Ghosts
from app.viewer.picture.scene_nodes import (
    Group,
    Look,
    Node,
    Placement,
    Surroundings,
    corners_of,
    first_under,
    send,
    wxyz_of,
)
from app.viewer.picture.stage import (
    SCENE_ROOT,
    add_floor,
    aim,
    fitting_distance,
    set_stage,
    view_direction,
)

ROOT = SCENE_ROOT
Array = npt.NDArray[np.float64]

_EDGES = np.array([[a, a | bit] for bit in (1, 2, 4) for a in range(8) if not a & bit])


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-9)


class ScenePicture:
    """The scene of one client.

    Attributes:
        own: whether all objects look as the source has them; else only the static ones do.
        ghosted: the object that is worked on in place, or None.
        camera: where it was before that.
        dark: whether the floor is drawn for a dark backdrop.
    """

    def __init__(self, client: viser.ClientHandle, workspace: SceneWorkspace) -> None:
        self._client = client
        self._workspace = workspace
        self._root: Any = None
        # The tab's threads draw, animate and pick at the same time.
        self._lock = threading.RLock()
        self._nodes: dict[tuple[Any, ...], Node] = {}
        self._chunks = 0
        self._floor: tuple[float, float] | None = None
        self._outline: list[Any] = []
        self._outlined: Any = None
        self._look: Look | None = None
        self._merged: dict[str, Path | None] = {}
        self._front: tuple[Any, Array] | None = None
        self._ghosts = Ghosts(
            client, f"{ROOT}/ghosts", lambda: self.in_scene(np.array(client.camera.position))
        )
        self.original_colors = False
        self.dark = False
        self.ghosted: str | None = None
        self.camera: tuple[Any, ...] | None = None

    # --- placements

    def _placement(self, item: SceneItem) -> tuple[Shape, Placement] | None:
        """An object's shape and place; None where it isn't known (yet)."""
        found = placed(item, self._workspace.shapes)
        return None if found is None else (found[0], Placement(*found[1:]))

    def bounds(self, ids: Sequence[str] | None = None) -> Array | None:
        """(2, 3) of objects in the scene's frame; of all where None."""
        every: list[Array] = []
        for id, item in self._workspace.items.items():
            if ids is None or id in ids:
                found = self._placement(item)
                if found is not None:
                    every.append(corners_of(*found))
        if not every:
            return None
        points = np.concatenate(every)
        return np.stack([points.min(0), points.max(0)])

    # --- drawing

    @property
    def nodes(self) -> list[Node]:
        """All that was sent, with the objects that each draws."""
        with self._lock:
            return list(self._nodes.values())

    def draw(self, rows: Sequence[Row], selected: str | None) -> None:
        """Send what changed: shapes that arrived, states, what is selected."""
        if self._root is None:
            set_stage(self._client.scene)
            self._root = self._client.scene.add_frame(ROOT, show_axes=False)
        items = self._workspace.items
        status = {r.id: r.shown for r in rows if r.id in items}
        self._place_root()
        with self._lock, self._client.atomic():
            self._draw_static({i for i, s in status.items() if s == "static"})
            self._draw_instances(self._wanted(status))
            self._paint(status, selected)
            self._draw_outline(selected)
            item = self._workspace.items.get(self.ghosted or "")
            found = None if item is None else self._placement(item)
            self._ghosts.draw(self.ghosted, self._nodes.values(), found)
        self._draw_floor()

    def _wanted(self, status: Mapping[str, str]) -> dict[tuple[Any, ...], list[str]]:
        out: dict[tuple[Any, ...], list[str]] = {}
        for id, where in status.items():
            item = self._workspace.items[id]
            found = self._placement(item)
            if found is None or where in ("failed", "missing"):
                continue
            if where == "static" and found[0].faces is not None:
                continue  # merged
            work = self._workspace.work(id)
            if work is None or work.drawn is None or work.document.tree is None:
                out.setdefault(("whole", item.path), []).append(id)
            else:
                for link in work.drawn.shapes:
                    out.setdefault(("part", work.id, work.drawn.labels, link), []).append(id)
        return out

    def _draw_static(self, ids: set[str]) -> None:
        shown, items = set[str](), self._workspace.items
        for key, node in list(self._nodes.items()):
            if not isinstance(node, Surroundings):
                continue
            # Their assets are still those that were sent.
            kept = [
                s for s in node.solid if s[0] in ids and self._merged.get(s[0]) == items[s[0]].path
            ]
            if len(kept) < len(node.ids):
                node.remove()
                del self._nodes[key]
                if kept:
                    self._merge(kept)
            shown |= {i for i, _, _ in kept}
        solid: list[tuple[str, Shape, Placement]] = []
        for id in self._workspace.items:
            if id not in ids or id in shown:
                continue
            found = self._placement(self._workspace.items[id])
            if found is not None and found[0].faces is not None:
                solid.append((id, *found))
        if solid:
            self._merge(solid)

    def _merge(self, solid: list[tuple[str, Shape, Placement]]) -> None:
        self._chunks += 1
        name = f"{ROOT}/static/{self._chunks}"
        self._nodes["static", self._chunks] = Surroundings(self._client, name, solid)
        self._merged |= {i: self._workspace.items[i].path for i, _, _ in solid}
        self._look = None

    def _draw_instances(self, wanted: dict[tuple[Any, ...], list[str]]) -> None:
        for key in [k for k in self._nodes if k[0] in ("whole", "part") and k not in wanted]:
            self._nodes.pop(key).remove()
        for key, ids in wanted.items():
            self._draw_group(key, ids)

    def _draw_group(self, key: tuple[Any, ...], ids: list[str]) -> None:
        known = self._nodes.get(key)
        if known is not None and known.ids == tuple(ids):
            return
        if known is not None:
            self._nodes.pop(key).remove()
        found = [f for id in ids if (f := self._placement(self._workspace.items[id]))]
        shape, work, link = found[0][0], None, ""
        placements = [placement for _, placement in found]
        if key[0] == "part":
            placements = [Placement(placement.world, np.ones(3)) for placement in placements]
            work, link = self._workspace.works[key[1]], key[3]
            assert work.drawn is not None
            shape = work.drawn.shapes[link]
        self._look = None
        self._chunks += 1
        group = Group(tuple(ids), shape, placements, work, link)
        self._nodes[key] = send(self._client, f"{ROOT}/{key[0]}/{self._chunks}", group)

    def _paint(self, status: Mapping[str, str], selected: str | None) -> None:
        """Colors by state, of the selected object by part, or as the source has them; all ghosts
        while one is worked on."""
        look = Look(status, self.original_colors, self.ghosted, selected)
        if look == self._look:
            return
        self._look = look
        for node in self._nodes.values():
            node.paint(look)

    def _draw_floor(self) -> None:
        bounds = self.bounds()
        if bounds is None:
            return
        span = float(max(np.ptp(bounds[:, :2], axis=0).max(), 0.5))
        floor = (round(float(bounds[0, 2]), 3), round(span, 1))
        if floor == self._floor:
            return
        first, self._floor = self._floor is None, floor
        place, scene = (*bounds.mean(0)[:2], float(bounds[0, 2]) - 2e-3), self._client.scene
        add_floor(scene, f"{ROOT}/ground", span, place, (1, 0, 0, 0), fade=6, dark=self.dark)
        if self.ghosted is None and (first or self.camera is None):
            self.frame()

    def _draw_outline(self, selected: str | None) -> None:
        found = None if selected is None else self._workspace.items.get(selected)
        # Where there is one object alone, a box round it would only be in the way.
        hidden = self.ghosted is not None or len(self._workspace.items) == 1
        placement = None if found is None or hidden else self._placement(found)
        key = None if placement is None else (selected, placement[1].world.tobytes())
        if key == self._outlined:
            return
        self._outlined = key
        for handle in self._outline:
            handle.remove()
        self._outline = []
        if placement is None:
            return
        corners = corners_of(*placement, margin=0.012)
        size = float(np.linalg.norm(np.ptp(corners, axis=0)))
        # Not below the floor, which would hide the box's lower edges.
        lowest = float(corners_of(*placement)[:, 2].min()) + 2e-3 * size
        corners[:, 2] = np.maximum(corners[:, 2], lowest)
        self._outline = [
            self._client.scene.add_line_segments(
                f"{ROOT}/outline",
                corners[_EDGES].astype(np.float32),
                palette.SELECTED,
                thickness=2.5,
                thickness_units="screen",
            ),
            self._client.scene.add_label(
                f"{ROOT}/name",
                (selected or "")[:60],
                anchor="bottom-center",
                position=(*corners.mean(0)[:2], float(corners[:, 2].max()) + 0.02 * size),
            ),
        ]

    # --- working on one object in place

    def ghost(self, id: str) -> None:
        """Everything but one object becomes a ghost around it, in that object's frame."""
        view = self._client.camera
        if self.ghosted is None:
            self.camera = (np.array(view.position), np.array(view.look_at))
        self.ghosted = id
        self._place_root()

    def _place_root(self) -> None:
        """Place the scene in its own frame, or in that of the object that is edited."""
        world = np.eye(4) if self.ghosted is None else self._world_of_ghosted()
        if world is None or self._root is None:
            return  # its size isn't known yet: it is placed once that is
        frame = np.linalg.inv(world)
        if not np.array_equal(frame[:3, 3], self._root.position):
            self._root.position = frame[:3, 3]
        if not np.array_equal(wxyz_of(frame), self._root.wxyz):
            self._root.wxyz = wxyz_of(frame)

    def look_from(self, eye: Array, at: Array) -> None:
        """Look at the object that is worked on; both places in the scene."""
        if (world := self._world_of_ghosted()) is not None:
            self._aim(*((p - world[:3, 3]) @ world[:3, :3] for p in (eye, at)))

    def in_scene(self, point: Array) -> Array:
        """Position in the displayed scene of a point of the edited object."""
        if self._root is None:
            return point
        turned = vtf.SO3(np.asarray(self._root.wxyz)).inverse().as_matrix()
        return np.asarray(turned @ (point - self._root.position))

    def _world_of_ghosted(self) -> Array | None:
        if self.ghosted is None or self.ghosted not in self._workspace.items:
            return None
        return self._workspace.world_from_copy(self._workspace.items[self.ghosted])

    def unghost(self) -> None:
        """Back to the scene's frame and to where the camera was."""
        self.ghosted = None
        self._place_root()
        if self.camera is not None:
            self._aim(*self.camera)

    # --- camera

    def frame(self, ids: Sequence[str] | None = None, *, front: bool = False) -> None:
        """Aim at objects from where the camera looks now, or at the whole scene from above.

        Args:
            front: look at the first of them from its front, past what is before it.
        """
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
        close = fitting_distance(camera, size)
        if front and ids:
            direction = self._from_front(ids[0], center, 1.9 * close, direction)
        whole = self.bounds()
        alone = whole is None or size > 0.6 * float(np.linalg.norm(np.ptp(whole, axis=0)))
        distance = close * (0.82 if ids is None or alone else 1.9)
        self._aim(center + distance * direction, center)
        self.camera = (center + distance * direction, center)

    def _from_front(self, id: str, center: Array, distance: float, otherwise: Array) -> Array:
        """(3,) unit direction from an object to an eye that sees its front, from the side and from
        as far above as what stands before it demands; ``otherwise`` where it isn't drawn."""
        found = self._placement(self._workspace.items[id])
        if found is None:
            return otherwise
        shape, placement = found
        key = id, shape.bounds.tobytes()
        if self._front is None or self._front[0] != key:
            self._front = key, np.asarray(front_direction(shape.vertices, shape.faces))
        facing = placement.world[:3, :3] @ self._front[1]
        best, most = otherwise, -1
        places = center + 0.6 * (corners_of(shape, placement) - center)
        places = np.vstack([center, places[(places - center) @ facing > 0]])
        for above, aside in ((0.45, 0.5), (0.45, -0.5), (0.9, 0.5), (0.9, -0.5), (2.0, 0.3)):
            direction = view_direction(facing, aside, above)
            eye = center + distance * direction
            seen = sum(self.pick(eye, _unit(p - eye)) == id for p in places)
            if seen > most:
                best, most = direction, seen
            if seen == len(places):
                break
        return best

    def _aim(self, position: Array, look_at: Array) -> None:
        aim(self._client, position, look_at, least_near=1e-3, least_far=100.0)

    def close(self) -> None:
        """The tab is gone."""
        self._ghosts.close()

    # --- motion

    def pose(self, moved: Mapping[int, Mapping[str, Array]]) -> None:
        """Move parts: session id → link → posed_from_rest; those not named rest."""
        with self._lock, self._client.atomic():
            for node in self._nodes.values():
                if node.work is not None:
                    node.move(moved.get(node.work.id, {}).get(node.link))

    # --- picking

    def pick(self, origin: Array, direction: Array) -> str | None:
        """The object under a ray of the scene's frame, where its parts are now."""
        return first_under(self.nodes, origin, direction)
