"""The collision shapes of an object: what exporters write and the gate sweeps."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import GeometryError
from model.core.joint import Joint
from model.core.lru_cache import LruCache
from model.core.mesh import Mesh
from model.core.progress import Progress, no_progress
from model.core.shapes import Hull, Primitive, Shape, hull_of, hull_of_shape, simplified
from model.geometry.topology import same_points
from model.kinematics.sweep import sweep_joint
from model.physics.collision.coacd_process import coacd_hulls, coacd_installed
from model.physics.collision.decomposition import decompose
from model.physics.collision.dops import Surface
from model.physics.collision.fitting import primitive_of
from model.physics.collision.hulls import thick_hull
from model.physics.collision.merging import merge
from model.physics.collision.narrow_phase import Bodies
from model.physics.collision.overlap_resolution import Free, overlapping_bodies, resolve_overlaps
from model.physics.collision.store import fingerprint, load_shapes, packed, save_shapes
from model.physics.collision.voxels import Occupancy, occupancy
from model.physics.part_mesh import part_mesh

Method = Literal["hollow", "auto", "coacd", "hull"]

PIECE = 3e-4
"""Free voxels that a piece may cover, as a share of all."""
SHEET = 0.003
"""Thickness that single sheets get, in the object's diagonal."""
LEAST = 5e-4
"""Metres; no body is thinner."""
COVERED = 0.05
"""Share of the free space that may be covered before coacd is asked for a better answer."""
SWEPT_POINTS = 1024
"""A part, where it is asked whether the parts themselves pass each other."""
MOST_FACES = 20_000
"""Larger meshes are thinned first."""


@dataclass(frozen=True)
class CollisionSettings:
    """How collision shapes are made.

    Attributes:
        method: "hollow" cuts walls into slabs, "coacd" asks coacd, "hull" takes one convex hull a
            part; "auto" is "hollow", and coacd where that covers more than :data:`COVERED` of the
            free space, coacd is installed and its answer covers less. What coacd answers within
            its time depends on the machine, and it is slow: who waits takes "hollow".
        max_hulls: budget of a part.
        max_vertices: of a hull; PhysX takes no more than 64.
        primitives: put boxes, cylinders, spheres and capsules in place of hulls like them.
        relief: take bodies back where links touch that move against each other.
        coacd_seconds: time limit of one part.
        seed: the only source of randomness.
    """

    method: Method = "hollow"
    max_hulls: int = 24
    max_vertices: int = 32
    primitives: bool = True
    relief: bool = True
    coacd_seconds: float = 30.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.max_hulls < 1:
            raise GeometryError(f"a part needs one hull or more, not {self.max_hulls}")
        if self.max_vertices < 8:
            raise GeometryError(f"a hull needs 8 vertices or more, not {self.max_vertices}")


Collision = Mapping[str, tuple[Shape, ...]]
"""Link → shapes, object frame at rest; links without a part are left out."""


def collision_of(
    obj: ArticulatedObject,
    settings: CollisionSettings | None = None,
    *,
    store: Path | None = None,
    progress: Progress = no_progress,
) -> Collision:
    """Collision shapes of every part.

    Hollow parts stay hollow, and links that move against each other don't overlap at rest. Shapes
    that the object's source tells stay as they are and the others give way to them; they are cut
    back only where a joint's shapes are to give way.

    Args:
        store: folder where shapes are kept by content, see :mod:`model.physics.collision.store`.

    Raises:
        GeometryError: for a part without geometry.
    """
    settings = settings or CollisionSettings()
    told = {link: held for link, held in obj.shapes.items() if link in obj.tree.links}
    if all(p.link in told for p in obj.parts) and not any(j.give_way for j in obj.tree.joints):
        progress(1.0, "collision shapes are told by the source")
        return told
    ranges = [(j.name, j.type, j.parent, j.child, j.axis, j.origin, j.lower, j.upper, j.mimic,
               *["gives way"] * j.give_way) for j in obj.tree.joints]  # fmt: skip
    key = fingerprint("object 2", settings, ranges, *(v for p in obj.parts for v in (p.link, p)),
                      *(v for k, array in sorted(packed(told).items()) for v in (k, array)
                        if told))  # fmt: skip
    kept = load_shapes(store, key)
    if kept is None and key in _recent:
        kept = _recent[key]
        save_shapes(store, key, kept)
    if kept is not None:
        _remember(key, kept)
        progress(1.0, "collision shapes were there already")
        return kept
    for i, part in enumerate(obj.parts):
        progress(0.4 * i / len(obj.parts), f"surface of {part.link}")
        part_mesh(part, store)  # one without geometry is named here
    diagonal = _diagonal_of(obj.parts)
    made: dict[str, _Made] = {}
    for i, part in enumerate(obj.parts):
        if part.link not in told:
            progress(0.4 + 0.5 * i / len(obj.parts), f"collision shapes of {part.link}")
            made[part.link] = _made_of(part, diagonal, settings, store)
    progress(0.9, "making room between the parts")
    slim: Bodies = {link: list(each.slim) for link, each in made.items()}
    slim |= {link: [hull_of_shape(s) for s in held] for link, held in told.items()}
    reach = _free_ranges(obj)
    room = slim
    if settings.relief:
        cut = resolve_overlaps(slim, obj.tree, diagonal, reach, frozenset(told))
        room = {
            k: v if k in told else [simplified(h, settings.max_vertices) for h in v]
            for k, v in cut.items()
        }
    of_told = {id(hull_of_shape(s)): s for held in told.values() for s in held}
    shapes: dict[str, tuple[Shape, ...]] = {
        k: tuple(of_told.get(id(h), h) for h in held) for k, held in room.items()
    }
    if settings.primitives:
        alike = {
            id(s): p for each in made.values()
            for s, p in zip(each.slim, each.primitives, strict=True)
        }  # fmt: skip
        shapes |= _shapes(obj, room, alike, diagonal, reach, frozenset(told))
    save_shapes(store, key, shapes)
    _remember(key, shapes)
    progress(1.0, "collision shapes are there")
    return shapes


_recent: OrderedDict[str, dict[str, tuple[Shape, ...]]] = OrderedDict()
"""The last objects of this process: the gate and the exporters ask for the same ones."""


def _remember(key: str, shapes: dict[str, tuple[Shape, ...]]) -> None:
    _recent[key] = shapes
    while len(_recent) > 8:
        _recent.popitem(last=False)


def prepare_bodies(
    parts: Sequence[Part], store: Path, progress: Progress = no_progress,
    told: Collection[str] = (),
) -> None:  # fmt: skip
    """Keep what :func:`collision_of` will ask for whatever the joints are, the last part first:
    whoever asks meanwhile begins with the first one.

    Args:
        told: links whose shapes the source tells.
    """
    settings = CollisionSettings()
    diagonal = _diagonal_of(parts)
    for i, part in enumerate(reversed(parts)):
        progress(i / len(parts), f"collision shapes of {part.link}")
        part_mesh(part, store)
        if part.link not in told:
            _kept_bodies(part, diagonal, settings, store)


def _free_ranges(obj: ArticulatedObject) -> Free:
    """The range over which a joint's parts run into nothing; all of it where shapes are to give
    way."""
    known: dict[str, tuple[float, float]] = {}

    def free(joint: Joint) -> tuple[float, float]:
        if joint.give_way:
            return -np.inf, np.inf
        if joint.name not in known:
            known[joint.name] = sweep_joint(obj, joint, 9, points=SWEPT_POINTS).free
        return known[joint.name]

    return free


def _kept_bodies(
    part: Part, diagonal: float, settings: CollisionSettings, store: Path | None
) -> list[Hull]:
    made = replace(settings, relief=False, primitives=False, max_vertices=64)
    key = fingerprint("part", made, round(diagonal, 6), part)
    kept = load_shapes(store, key)
    if kept is not None:
        return [h for h in kept["part"] if isinstance(h, Hull)]
    bodies = bodies_of(part, diagonal, made)
    save_shapes(store, key, {"part": tuple(bodies)})
    return bodies


@dataclass(frozen=True, eq=False)
class _Made:
    """Bodies of a part, whatever its joints are.

    Attributes:
        slim: with few corners. primitives: what each is like before its corners are taken away.
    """

    slim: tuple[Hull, ...]
    primitives: tuple[Primitive | None, ...]


def _made_of(part: Part, diagonal: float, settings: CollisionSettings, store: Path | None) -> _Made:
    """The bodies of a part; those of the last parts are kept, as most edits are of a joint."""

    def make() -> _Made:
        bodies = _kept_bodies(part, diagonal, settings, store)
        slim = tuple(simplified(h, settings.max_vertices) for h in bodies)
        return _Made(
            slim, tuple(map(primitive_of, bodies)) if settings.primitives else (None,) * len(slim)
        )

    # A body is known by its id: no two parts share one.
    return _made.get((part.link, fingerprint(settings, round(diagonal, 6), part)), make)


_made: LruCache[tuple[str, str], _Made] = LruCache(128)


def _diagonal_of(parts: Sequence[Part]) -> float:
    bounds = np.stack([p.bounds for p in parts]) if parts else np.zeros((1, 2, 3))
    return float(np.linalg.norm(bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)))


def bodies_of(part: Part, diagonal: float, settings: CollisionSettings) -> list[Hull]:
    """The convex bodies of one part by itself.

    Args:
        diagonal: of the whole object, metres; sheets get their thickness from it.
    """
    mesh = thinned(part_mesh(part))
    thickness = max(SHEET * diagonal, LEAST)
    if not (mesh.face_areas > 0).any():
        return [thick_hull(mesh.vertices[np.unique(mesh.faces)], thickness)]
    if settings.method == "hull":
        return [simplified(thick_hull(mesh.vertices[np.unique(mesh.faces)], thickness),
                           settings.max_vertices)]  # fmt: skip
    if settings.method == "coacd":
        return _coacd(mesh, settings) or hollow_bodies(mesh, thickness, settings)[0]
    bodies, space = hollow_bodies(mesh, thickness, settings)
    if settings.method == "auto" and covered(space, bodies) > COVERED and coacd_installed():
        other = _coacd(mesh, settings)
        if other is not None and covered(space, other) < covered(space, bodies):
            return other
    return bodies


def hollow_bodies(
    mesh: Mesh, thickness: float, settings: CollisionSettings
) -> tuple[list[Hull], Occupancy]:
    """Few convex bodies that leave free space free, and the voxels that say what is free."""
    space = occupancy(mesh.triangles[mesh.face_areas > 0])
    surface = Surface(mesh, space, np.random.default_rng(settings.seed))
    pieces = decompose(surface, max(2.0, PIECE * space.free_count))
    groups = merge(surface, pieces, settings.max_hulls)
    hulls = _filled(surface, groups, thickness)
    return [simplified(h, settings.max_vertices) for h in hulls], space


def _filled(surface: Surface, groups: list[npt.NDArray[np.int64]], thickness: float) -> list[Hull]:
    """The hulls of groups of faces, grown where sealed voxels beneath them are in none."""
    hulls = [thick_hull(surface.corners(faces), thickness) for faces in groups]
    left = np.ones(len(surface.beneath), bool)
    for hull in hulls:
        left &= ~hull.contains(surface.beneath, -0.5 * surface.space.size)
    if not left.any():
        return hulls
    group_of = np.zeros(len(surface.mesh.faces), np.int64)
    for i, faces in enumerate(groups):
        group_of[faces] = i
    mine = group_of[surface.owner[left]]
    for i in np.unique(mine):
        more = surface.beneath[left][mine == i]
        hulls[i] = thick_hull(np.concatenate([hulls[i].vertices, more]), thickness)
    return hulls


def covered(space: Occupancy, bodies: list[Hull]) -> float:
    """Share of the free voxels that bodies cover."""
    centers = space.centers(space.free)
    inside = np.zeros(len(centers), bool)
    for body in bodies:
        inside |= body.contains(centers)
    return float(inside.mean()) if len(centers) else 0.0


def _coacd(mesh: Mesh, settings: CollisionSettings) -> list[Hull] | None:
    found = coacd_hulls(
        mesh, settings.coacd_seconds, max_convex_hull=settings.max_hulls, seed=settings.seed
    )
    return None if found is None else [simplified(h, settings.max_vertices) for h in found]


def thinned(mesh: Mesh, most: int = MOST_FACES) -> Mesh:
    """``mesh`` with vertices joined in cells until it has at most ``most`` faces (Rossignac and
    Borrel, 1993); faces of no area go. Enough for bodies, which are coarser by far."""
    if len(mesh.faces) <= most:
        return mesh
    low, high = mesh.bounds
    cells = 256.0
    while True:
        place = same_points(np.floor((mesh.vertices - low) / float((high - low).max()) * cells))
        first, inverse = place
        faces = inverse[mesh.faces]
        real = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        faces = _distinct(faces[real])
        if len(faces) <= most or cells < 24:
            return Mesh(mesh.vertices[first], faces.astype(np.int32))
        cells /= 1.5


def _distinct(faces: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    ordered = np.sort(faces, axis=1)
    key = (ordered[:, 0] << 42) + (ordered[:, 1] << 21) + ordered[:, 2]
    return faces[np.unique(key, return_index=True)[1]]


def _shapes(
    obj: ArticulatedObject,
    room: Bodies,
    alike: Mapping[int, Primitive | None],
    diagonal: float,
    reach: Free,
    told: frozenset[str],
) -> dict[str, tuple[Shape, ...]]:
    """Primitives where a body is like one and nothing else is in the primitive's way.

    Args:
        told: links that are left out.
        room: bodies that leave each other room.
        alike: id of a body that was not cut → the primitive that it is like.
    """
    shapes: dict[str, list[Shape]] = {
        k: [(alike[id(h)] if id(h) in alike else primitive_of(h)) or h for h in hulls]
        for k, hulls in room.items()
        if k not in told
    }
    tried = room | {k: [hull_of_shape(s) for s in held] for k, held in shapes.items()}
    for link, i in overlapping_bodies(tried, obj.tree, diagonal, reach):
        if link not in told:
            shapes[link][i] = room[link][i]
    return {k: tuple(held) for k, held in shapes.items()}


__all__ = [
    "Collision",
    "CollisionSettings",
    "bodies_of",
    "collision_of",
    "hull_of",
    "hull_of_shape",
]
