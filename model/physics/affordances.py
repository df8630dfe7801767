"""Find from geometry where a parallel gripper can move each joint.

Handles are not looked for by their shape: a place counts by what a gripper can do there. Places on
a link's surface are tried from several sides; the hand must be free of everything at rest and along
the joint's motion, be far from the hinge, and press on a surface that faces the motion. A handle,
the free edge of a door, the rim of a lid and the face of a button come out of this.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.core.articulated_object import (
    Affordance,
    AffordanceKind,
    ArticulatedObject,
    Part,
    belongs,
)
from model.core.geometry import Mesh
from model.core.joint import Joint, motion
from model.core.progress import attempt
from model.core.shapes import Hull, Shape, hull_of_shape
from model.core.tree import KinematicTree
from model.geometry.sampling import sample_surface

OPENING = 0.085
"""Metres between the pads at most, as of common two-finger grippers."""
FINGER = (0.004, 0.01, 0.06)
"""Metres of a finger: thickness, width, length."""
PALM = (0.08, 0.04, 0.06)
"""Metres of the palm behind the fingers: along the closing axis, across, along the approach."""
DEPTH = 0.008
"""Metres that the pads reach beyond the middle of what they hold."""
SPARE = 0.004
"""Metres between a pad and the surface before the fingers close."""
OFF = 0.003
"""Metres between the fingers and the surface before they push or hook it."""
ROWS = tuple((-np.arange(0.003, FINGER[2], 0.006)).tolist())
"""Metres of the spheres of :func:`finger_spheres` along a finger, from the tips."""
ARM = 0.15
"""Metres behind the palm that stay free for the wrist; the hand comes straight from outside."""

Array = npt.NDArray[np.float64]


def tool_pose(affordance: Affordance, gap: float = 0.0) -> Array:
    """(4, 4) ``link_from_tool`` of a gripper that takes hold.

    Its origin lies between the fingertips, x is the closing axis, z the approach.

    Args:
        gap: metres that a push or a hook stays off the surface.
    """
    x, z = np.asarray(affordance.closing), -np.asarray(affordance.normal)
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    out = np.eye(4)
    out[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    out[:3, 3] = tip_of(affordance.kind, np.asarray(affordance.center), z, x, gap)
    return out


def tip_of(
    kind: AffordanceKind | npt.NDArray[np.str_],
    center: Array,
    approach: Array,
    closing: Array,
    gap: float,
) -> Array:
    """(..., 3) between the fingertips, for (...) kinds, as in :func:`tool_pose`."""
    kinds = np.asarray(kind)[..., None]
    off = np.where(kinds == "hook", FINGER[1] / 2 + gap, 0.0)
    ahead = np.where(kinds == "push", -gap, DEPTH)
    return np.asarray(center - off * np.cross(approach, closing) + ahead * approach)


def finger_spheres(rows: Sequence[float], opening: Array) -> tuple[Array, Array]:
    """(P, S, 3) centres in tool frames, for (P,) openings, and (S,) radii of both fingers."""
    thick, wide, _ = FINGER
    radius = 0.003
    at = np.array(
        [(s, y, z) for s in (-1, 1) for y in (-wide / 2 + 0.002, 0, wide / 2 - 0.002) for z in rows]
    )
    out = np.repeat(at[None], len(opening), axis=0)
    out[:, :, 0] *= (opening[:, None] + thick) / 2
    return out, np.full(len(at), radius)


def palm_spheres() -> tuple[Array, Array]:
    """(S, 3) centres and (S,) radii of palm and arm."""
    along, _, deep = PALM
    side = np.linspace(-along / 2 + 0.02, along / 2 - 0.02, 3)
    rows = -FINGER[2] - np.arange(0.02, deep + ARM, 0.025)
    at = np.array([(x, 0.0, z) for x in side for z in rows])
    return at, np.full(len(at), 0.02)


BACK = (0.0, 0.006)
"""Metres that a pinch is tried further out, for what stands out little."""
REACHED = 0.6
"""Share of a range over which the hand follows a link, and what counts as opened."""
SPACING, MOST_POINTS = 0.004, 250_000
"""Metres between the samples of a surface, and their number in an object at most."""
CELL = 0.025
"""Metres between the places that are tried; MOST_PLACES of a link at most."""
MOST_PLACES = 900
SIDES = 8
"""Directions of approach about a surface's normal."""
TILTS = (0.0, np.radians(30))
"""Radians by which a hooked finger leans back, as the hand has more room there."""
FACING = 0.6
"""Least cosine between the motion and what pushes or hooks."""
FROM_BELOW = 0.8
"""Weight of a place that the hand comes to from below."""
BATCH, FEW = 400, 24
"""Candidates whose room is looked at together, best first: by samples, and by the shapes."""
CLOSE = 0.03
"""Metres within which two places are one."""
ALONG = (0.0, 0.5 * REACHED, REACHED)
"""Shares of the range at which the hand must be free."""
EXACTLY = tuple(np.linspace(0.0, REACHED, 7).tolist())
"""Shares at which it must be free of the shapes themselves, not of their samples."""
STRIDE = 6
"""Every so many spheres of a hand are tested first: most hands meet something there."""
FREE_TURN = np.pi
"""Radians that a joint without limits is turned."""


def opened_range(joint: Joint) -> float:
    """Joint value at which a robot stops: the farther limit; half a turn without limits."""
    low, high = joint.motion_range
    return FREE_TURN if not joint.limited else high if high >= -low else low


def find_affordances(
    obj: ArticulatedObject,
    collision: Mapping[str, Sequence[Shape]],
    *,
    remarks: list[str] | None = None,
) -> tuple[Affordance, ...]:
    """Places for each joint that moves on its own, best first; none where no hand fits.

    Affordances of ``obj`` whose joints remain are kept; a search that fails finds none.

    Args:
        collision: link → shapes, object frame: what a gripper meets. Links without any count by
            their meshes or clouds; where no link has one, nothing is looked for.
        remarks: gets one for each search that failed.
    """
    said = [] if remarks is None else remarks
    found = _FOUND.get(obj)  # formats of one export ask for the same
    if found is not None and found[0] is collision:
        said += found[2]
        return found[1]
    kept = [a for a in obj.affordances if belongs(a, obj.tree)]
    known = {a.joint for a in kept}
    joints = [j for j in obj.tree.joints if _own(j) and j.name not in known] if collision else []
    failed: list[str] = []
    surface = cache(lambda: _Surface.of(obj, collision, np.random.default_rng(0)))
    for joint in joints:
        places = partial(_places, obj.tree, surface, joint)
        kept += attempt(failed, f"{joint.name}: the search for affordances", places, [])
    _FOUND[obj] = (collision, tuple(kept), failed)
    said += failed
    return tuple(kept)


_FOUND: WeakKeyDictionary[
    ArticulatedObject,
    tuple[Mapping[str, Sequence[Shape]], tuple[Affordance, ...], list[str]],
] = WeakKeyDictionary()


def _places(tree: KinematicTree, surface: Callable[[], _Surface], joint: Joint) -> list[Affordance]:
    return list(_Search(tree, surface(), joint).best())


def _own(joint: Joint) -> bool:
    return joint.moves and joint.mimic is None and abs(opened_range(joint)) > 1e-6


# -- surfaces --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Surface:
    """All links at rest.

    Attributes:
        points, normals: (N, 3) samples and their unit normals. link: (N,) index of the link.
        number: link → its index. spacing: metres between samples.
        hulls: link → its convex shapes.
    """

    points: Array
    normals: Array
    link: npt.NDArray[np.int64]
    number: Mapping[str, int]
    spacing: float
    hulls: Mapping[str, tuple[Hull, ...]]

    @classmethod
    def of(
        cls,
        obj: ArticulatedObject,
        collision: Mapping[str, Sequence[Shape]],
        rng: np.random.Generator,
    ) -> _Surface:
        parts = {p.link: p for p in obj.parts}
        number = {link: k for k, link in enumerate(obj.tree.links)}
        hulls = {k: tuple(hull_of_shape(s) for s in collision.get(k, ())) for k in number}
        meshes = {k: _mesh(parts.get(k), hulls[k]) for k in number}
        area = sum(float(m.face_areas.sum()) for m in meshes.values() if m is not None)
        spacing = max(SPACING, float(np.sqrt(area / MOST_POINTS)))
        found: list[tuple[Array, Array, int]] = []
        for link, mesh in meshes.items():
            part = parts.get(link)
            if mesh is not None and mesh.face_areas.sum() > 0:
                count = max(60, int(mesh.face_areas.sum() / spacing**2))
                cloud = sample_surface(mesh, count, rng)[0]
            elif part is not None and part.cloud is not None:
                cloud = part.cloud
            else:
                continue
            points = cloud.points.astype(np.float64)
            normals = np.zeros_like(points) if cloud.normals is None else cloud.normals
            outside = np.ones(len(points), bool)
            for hull in hulls[link]:  # where shapes of one link meet is no surface
                outside &= ~hull.contains(points, 2e-4)
            found.append((points[outside], normals[outside].astype(np.float64), number[link]))
        if not found:
            none = np.zeros((0, 3))
            return cls(none, none, np.zeros(0, np.int64), number, spacing, hulls)
        points, normals, which = zip(*found, strict=True)
        link = np.repeat(which, [len(p) for p in points]).astype(np.int64)
        return cls(np.concatenate(points), np.concatenate(normals), link, number, spacing, hulls)

    @cached_property
    def tree(self) -> KDTree:
        """KD-tree of all points."""
        return KDTree(self.points)

    @cached_property
    def size(self) -> float:
        """Diagonal of the box round all points."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    def of_links(self, links: Sequence[str] | frozenset[str]) -> npt.NDArray[np.bool_]:
        """(N,) mask."""
        return np.isin(self.link, [self.number[k] for k in links])


def _mesh(part: Part | None, hulls: Sequence[Hull]) -> Mesh | None:
    if not hulls:
        return None if part is None or part.mesh is None or not len(part.mesh.faces) else part.mesh
    shift = np.cumsum([0, *(len(h.vertices) for h in hulls)])
    faces = [h.faces + s for h, s in zip(hulls, shift, strict=False)]
    return Mesh(np.concatenate([h.vertices for h in hulls]), np.concatenate(faces))


# -- the search ------------------------------------------------------------------------------------


@dataclass
class _Poses:
    """Candidates, arrays by row: kind index, centre, approach, closing axis, width, score."""

    kind: npt.NDArray[np.int64]
    center: Array
    approach: Array
    closing: Array
    width: Array
    score: Array

    def take(self, rows: npt.NDArray[np.bool_] | npt.NDArray[np.int64]) -> _Poses:
        return _Poses(*(getattr(self, f)[rows] for f in self.__dataclass_fields__))

    def batches(self, size: int) -> Iterator[_Poses]:
        for start in range(0, len(self), size):
            yield self.take(np.arange(start, min(start + size, len(self))))

    def __len__(self) -> int:
        return len(self.score)


_KINDS: tuple[AffordanceKind, ...] = ("grasp", "hook", "push", "turn")
_GRASP, _HOOK, _PUSH, _TURN = range(4)


class _Search:
    """Places for one joint."""

    def __init__(self, tree: KinematicTree, surface: _Surface, joint: Joint) -> None:
        self.joint, self.surface, self.exact = joint, surface, False
        self.end = opened_range(joint)
        moving = tree.descendants(joint.child)
        moves = surface.of_links(moving)
        own = surface.of_links(_rigid(tree, joint.child)) if len(moves) else moves
        own = own if own.any() else moves
        self.points, self.normals = surface.points[own], surface.normals[own]
        self.empty = len(self.points) == 0
        if self.empty:
            return
        self.tree = KDTree(self.points)
        static = surface.points[~moves & self._near(surface.points)]
        self.static = KDTree(static) if len(static) else None
        self.shapes = [(k in moving, h) for k, each in surface.hulls.items() for h in each]
        self.bounds = np.array([h.bounds for _, h in self.shapes]).reshape(-1, 2, 3)
        self.speed = np.linalg.norm(self._velocity(self.points), axis=1).max()

    def _near(self, points: Array) -> npt.NDArray[np.bool_]:
        """(N,) whether a hand at the link may come to (N, 3) points along the motion."""
        poses = [motion(self.joint, share * self.end) for share in EXACTLY]
        moved = np.concatenate([self.points @ m[:3, :3].T + m[:3, 3] for m in poses])
        room = FINGER[2] + PALM[2] + ARM + 0.05
        inside = (points > moved.min(axis=0) - room) & (points < moved.max(axis=0) + room)
        return inside.all(axis=1)

    def best(self, most: int = 3) -> Iterator[Affordance]:
        """The best free candidates that differ from each other."""
        if self.empty or not self.speed > 0:
            return
        poses = _joined(*self._pinches(), *self._presses())
        poses.score *= np.where(poses.approach[:, 2] > 0.5, FROM_BELOW, 1.0)
        poses = poses.take(np.argsort(-poses.score, kind="stable"))
        taken: list[_Poses] = []
        at_rest: list[_Poses] = []
        free = self._free_at_rest(poses, at_rest)
        along = (self._free_along(batch, ALONG[1:]) for batch in free)
        # Then those that must let go early; all of them have been looked at by then.
        for batches, exactly in ((along, EXACTLY), (at_rest, ALONG[:1])):
            for batch in batches:
                for few in batch.batches(FEW):
                    for one in self._clear(few, exactly, exact=True).batches(1):
                        if all(self._differ(one, other) for other in taken):
                            taken.append(one)
                            yield self._affordance(one)
                        if len(taken) == most:
                            return
            if taken:
                return

    def _free_at_rest(self, poses: _Poses, found: list[_Poses]) -> Iterator[_Poses]:
        """Poses of each batch whose hand is free of all samples at rest; also kept in ``found``."""
        for batch in poses.batches(BATCH):
            found.append(self._clear(batch, ALONG[:1]))
            yield found[-1]

    def _differ(self, a: _Poses, b: _Poses) -> bool:
        apart = np.linalg.norm(a.center[0] - b.center[0]) > CLOSE
        return bool(apart or a.approach[0] @ b.approach[0] < 0.5)

    def _affordance(self, pose: _Poses) -> Affordance:
        center = pose.center[0] - np.asarray(self.joint.origin)
        vectors = [tuple(v.tolist()) for v in (center, -pose.approach[0], pose.closing[0])]
        kind = _KINDS[pose.kind[0]]
        wide = float(pose.width[0])
        return Affordance(self.joint.name, self.joint.child, kind, *vectors, wide)  # type: ignore[arg-type]

    def _velocity(self, points: Array) -> Array:
        """(N, 3) motion of points towards the end of the range, per unit of q."""
        axis = np.asarray(self.joint.axis) * np.sign(self.end)
        if not self.joint.rotates:
            return np.broadcast_to(axis, points.shape)
        arm = points - np.asarray(self.joint.origin)
        return np.asarray(np.cross(axis, arm), np.float64)

    @cached_property
    def _places(self) -> npt.NDArray[np.int64]:
        """Indices of points: one a cell and direction of the normal, so small features count."""
        size = CELL
        while True:
            cell = np.floor(self.points / size).astype(np.int64)
            cell -= cell.min(axis=0)
            columns = [*cell.T, *(np.rint(self.normals).astype(np.int64) + 1).T]
            rows = np.ravel_multi_index(columns, [int(c.max()) + 1 for c in columns])
            key = np.unique(rows, return_index=True)[1]
            if len(key) <= MOST_PLACES:
                return key
            size *= 1.25

    # Candidates

    def _sides(self, normals: Array) -> Array:
        """(N, SIDES, 3) unit directions across the normals; the first is nearest to the axis."""
        axis = np.asarray(self.joint.axis)
        first = axis - normals * (normals @ axis)[:, None]
        weak = np.linalg.norm(first, axis=1) < 0.1
        helper = np.eye(3)[np.abs(normals).argmin(axis=1)]
        first[weak] = np.cross(normals[weak], helper[weak])
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        other = np.cross(normals, first)
        turn = np.arange(SIDES) * 2 * np.pi / SIDES
        return first[:, None] * np.cos(turn)[:, None] + other[:, None] * np.sin(turn)[:, None]

    def _pinches(self) -> Iterator[_Poses]:
        """Two opposite surfaces that fit between the pads."""
        at = self._places
        points, normals = self.points[at], self.normals[at]
        width = self._widths(points, normals)
        fits = np.isfinite(width)
        points, normals, width = points[fits], normals[fits], width[fits]
        if not len(points):
            return
        center = points - normals * width[:, None] / 2
        patch = self._patch(points) * self._patch(center - normals * width[:, None] / 2)
        approach = self._sides(normals)
        count, sides = len(center), approach.shape[1]
        velocity = self._velocity(center)
        lever = np.linalg.norm(velocity, axis=1) / self.speed
        way = velocity / np.maximum(np.linalg.norm(velocity, axis=1), 1e-12)[:, None]
        held = np.abs((normals * way).sum(1))[:, None]  # between the pads, not by friction
        pulled = -(approach * way[:, None]).sum(2)
        score = 0.7 + 0.3 * held + 0.1 * np.maximum(pulled, 0)
        score = score * np.sqrt(lever)[:, None]
        kind = np.full((count, sides), _GRASP)
        if self.joint.rotates:
            axis = np.asarray(self.joint.axis)
            off = np.cross(center - np.asarray(self.joint.origin), axis)
            along = np.abs(approach @ axis) > 0.9
            turns = along & (np.linalg.norm(off, axis=1) < 0.25 * width)[:, None]
            kind[turns] = _TURN
            score[turns] = 0.9
        score = score * np.sqrt(patch)[:, None]
        for back in BACK:
            yield _Poses(
                kind.ravel(),
                (center[:, None] - back * approach).reshape(-1, 3),
                approach.reshape(-1, 3),
                np.repeat(normals, sides, axis=0),
                np.repeat(width, sides),
                score.ravel() * (1.0 if back == 0.0 else 0.95),
            )

    def _widths(self, points: Array, normals: Array) -> Array:
        """(P,) distance to the opposite surface along the normal; inf where the pads don't fit."""
        out = np.full(len(points), np.inf)
        most = OPENING - 2 * SPARE
        near = max(0.004, 0.8 * self.surface.spacing)
        middles = points - normals * most / 2
        for k, rows in enumerate(self.tree.query_ball_point(middles, most / 2 + near)):
            index = np.asarray(rows, np.int64)
            away = points[k] - self.points[index]
            depth = away @ normals[k]
            beside = np.linalg.norm(away - depth[:, None] * normals[k], axis=1)
            opposite = self.normals[index] @ normals[k] < -0.85
            good = opposite & (beside < near) & (depth > 5e-4)
            if good.any():
                out[k] = depth[good].min()
        return out

    def _patch(self, points: Array) -> Array:
        """(P,) 0..1: how much of a pad has surface before it."""
        radius = 0.008
        count = self.tree.query_ball_point(points, radius, return_length=True)
        return np.clip(count * self.surface.spacing**2 / (np.pi * radius**2), 0.05, 1.0)

    def _presses(self) -> Iterator[_Poses]:
        """Surfaces that face against the motion, pushed with the tips or hooked from a side."""
        at = self._places
        points, normals = self.points[at], self.normals[at]
        velocity = self._velocity(points)
        speed = np.linalg.norm(velocity, axis=1)
        facing = -(normals * velocity).sum(1) / np.maximum(speed, 1e-12)
        good = (facing > FACING) & (speed > 0.2 * self.speed)
        points, normals, facing = points[good], normals[good], facing[good]
        if not len(points):
            return
        base = facing * np.sqrt(speed[good] / self.speed) * np.sqrt(self._patch(points))
        sides = self._sides(normals)
        count, each = len(points), sides.shape[1]
        pull = np.repeat(-normals, each, axis=0)
        across, at = sides.reshape(-1, 3), np.repeat(points, each, axis=0)
        for tilt in TILTS:
            approach = np.cos(tilt) * across - np.sin(tilt) * pull
            side = np.cos(tilt) * pull + np.sin(tilt) * across
            yield _Poses(
                np.full(count * each, _HOOK),
                at,
                approach,
                np.cross(side, approach),
                np.zeros(count * each),
                np.repeat(0.8 * np.cos(tilt) * base, each),
            )
        for closing in (sides[:, 0], sides[:, SIDES // 4]):
            yield _Poses(
                np.full(count, _PUSH), points, -normals, closing, np.zeros(count), 0.85 * base
            )

    # Clearance

    def _clear(self, poses: _Poses, shares: Sequence[float], exact: bool = False) -> _Poses:
        """Poses whose hand is free at rest, on its way there, and at shares of the motion.

        Args:
            exact: of all shapes, which takes longer; else of their samples.
        """
        self.exact = exact
        poses = poses.take(self._fingers_free(poses, ROWS[:2]))
        poses = self._free_along(poses, shares)
        return poses.take(self._reached(poses))

    def _free_along(self, poses: _Poses, shares: Sequence[float]) -> _Poses:
        """Poses whose fingers and palm are free at shares of the motion."""
        for share in shares:
            poses = poses.take(self._fingers_free(poses, ROWS[1:], share))
            poses = poses.take(self._palm_free(poses, share))
        return poses

    def _fingers_free(
        self, poses: _Poses, rows: Sequence[float], share: float = 0.0
    ) -> npt.NDArray[np.bool_]:
        pinch = (poses.kind == _GRASP) | (poses.kind == _TURN)
        opening = np.where(pinch, poses.width + 2 * SPARE * (share == 0.0), 0.0)
        spheres, radii = finger_spheres(rows, opening)
        return self._free(poses, spheres, radii, share)

    def _palm_free(self, poses: _Poses, share: float) -> npt.NDArray[np.bool_]:
        at, radii = palm_spheres()
        return self._free(poses, np.repeat(at[None], len(poses), axis=0), radii, share)

    def _reached(self, poses: _Poses) -> npt.NDArray[np.bool_]:
        """Mask of the poses that the hand reaches straight from outside of the object."""
        rows = np.arange(FINGER[2] + PALM[2], self.surface.size, 0.04)
        at = np.column_stack([np.zeros((len(rows), 2)), -rows])
        at = np.repeat(at[None], len(poses), axis=0)
        return self._free(poses, at, np.full(len(rows), 0.025), 0.0)

    def _free(
        self, poses: _Poses, spheres: Array, radii: Array, share: float
    ) -> npt.NDArray[np.bool_]:
        """(P,) whether (P, S, 3) spheres in tool frames meet nothing, ``share`` along the way."""
        if not len(poses) or not len(radii):
            return np.ones(len(poses), bool)
        kinds = np.array(_KINDS)[poses.kind]
        tips = tip_of(kinds, poses.center, poses.approach, poses.closing, OFF)
        y = np.cross(poses.approach, poses.closing)
        frames = np.stack([poses.closing, y, poses.approach], axis=2)  # columns
        world = np.einsum("pij,psj->psi", frames, spheres) + tips[:, None]
        flat, room = world.reshape(-1, 3), radii + 5e-4
        matrix = motion(self.joint, share * self.end)
        posed = flat @ matrix[:3, :3].T + matrix[:3, 3]
        if self.exact:
            free, least = np.ones(len(flat), bool), np.tile(room, len(poses))
            low, high = (np.stack([end(flat, 0), end(posed, 0)]).T for end in (np.min, np.max))
            meets = (self.bounds[:, 0] < high.max(axis=1) + room.max()) & (
                self.bounds[:, 1] > low.min(axis=1) - room.max()
            )
            for k in np.flatnonzero(meets.all(axis=1)):
                moves, hull = self.shapes[k]
                if not (moves and share):
                    free &= _apart(hull, flat if moves else posed, least)
            return np.asarray(free.reshape(len(poses), -1).all(axis=1))
        tree = self.surface.tree if share == 0.0 else self.static
        out = np.ones(len(poses), bool)
        if tree is None:
            return out
        posed = posed.reshape(len(poses), -1, 3)
        for some in (slice(0, None, STRIDE), slice(None)):
            left = np.flatnonzero(out)
            off = tree.query(posed[left, some], distance_upper_bound=float(room.max()))[0]
            out[left] = (off > room[some]).all(axis=1)
        return out


def _apart(hull: Hull, points: Array, least: Array) -> npt.NDArray[np.bool_]:
    """(N,) whether (N, 3) points are (N,) metres off a hull, or more; too strict at its edges."""
    low, high = hull.bounds
    room = least[:, None]
    near = np.flatnonzero(((points > low - room) & (points < high + room)).all(axis=1))
    out = np.ones(len(points), bool)
    heights = points[near] @ hull.planes[:, :3].T + hull.planes[:, 3]
    out[near] = heights.max(axis=1, initial=-np.inf) >= least[near]
    return out


def _joined(*found: _Poses) -> _Poses:
    if not found:
        none = np.zeros((0, 3))
        return _Poses(np.zeros(0, np.int64), none, none, none, np.zeros(0), np.zeros(0))
    fields = _Poses.__dataclass_fields__
    return _Poses(*(np.concatenate([getattr(p, f) for p in found]) for f in fields))


def _rigid(tree: KinematicTree, link: str) -> frozenset[str]:
    """``link`` and what is fixed to it."""
    out, stack = {link}, [link]
    while stack:
        for child in tree.children(stack.pop()):
            if not tree.joint_of[child].moves:
                out.add(child)
                stack.append(child)
    return frozenset(out)
