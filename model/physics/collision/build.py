"""The collision shapes of an object, for export and validation."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import GeometryError
from model.core.geometry import Mesh
from model.core.joint import Joint
from model.core.memory import LruCache
from model.core.progress import Progress, no_progress
from model.core.shapes import Hull, Primitive, Shape, hull_of_shape, simplified, thick_hull
from model.core.tree import driven
from model.geometry.topology import same_points
from model.kinematics.sweep import sweep_joint
from model.physics.collision.convex_bodies import FaceExtents, Occupancy, occupancy, primitive_of
from model.physics.collision.decomposition import coacd_hulls, coacd_installed, decompose, merge
from model.physics.collision.narrow_phase import Bodies
from model.physics.collision.overlap_resolution import (
    FreeRange,
    overlapping_bodies,
    resolve_overlaps,
)
from model.physics.collision.store import fingerprint, load_shapes, packed, save_shapes
from model.physics.part_mesh import part_mesh

Method = Literal["hollow", "auto", "coacd", "hull"]

PATCH = 3e-4
"""Free voxels that the body of a patch may cover, as a share of all."""
SHEET = 0.003
"""Thickness of bodies of single sheets, in the object's diagonal."""
LEAST = 5e-4
"""Metres; no body is thinner."""
SLIVER = 2.5e-4
"""Metres, half of :data:`LEAST`: thinner hulls are left over from cuts, and PhysX, which welds what
is closer than 0.7 to 1 mm when it cooks (measured with SAPIEN 3.0.3), turns them into others."""
COVERED = 0.05
"""Share of the free space whose covering makes "auto" try coacd."""
SWEPT_POINTS = 1024
"""Samples of a part in the sweeps that find the free range of joints."""
MOST_FACES = 20_000
"""Larger meshes are simplified first."""


@dataclass(frozen=True)
class CollisionSettings:
    """Settings for collision shapes.

    Attributes:
        method: "hollow" decomposes walls into slabs, "coacd" runs coacd, "hull" takes one convex
            hull per part. "auto" is "hollow", or coacd where "hollow" covers more than
            :data:`COVERED` of the free space, coacd is installed and covers less. coacd is slow,
            and its result within its time limit depends on the machine.
        max_hulls: of a part.
        max_vertices: of a hull; PhysX takes no more than 64.
        primitives: replace hulls by similar boxes, cylinders, spheres and capsules.
        resolve_overlaps: cut bodies of links that overlap while they move against each other.
        coacd_seconds: time limit of one part.
        seed: the only source of randomness.
    """

    method: Method = "hollow"
    max_hulls: int = 24
    max_vertices: int = 32
    primitives: bool = True
    resolve_overlaps: bool = True
    coacd_seconds: float = 30.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.max_hulls < 1:
            raise GeometryError(f"max_hulls must be 1 or more, got {self.max_hulls}")
        if self.max_vertices < 8:
            raise GeometryError(f"max_vertices must be 8 or more, got {self.max_vertices}")


Collision = Mapping[str, tuple[Shape, ...]]
"""Link → shapes, object frame at rest; links without a part are left out."""


def collision_of(
    obj: ArticulatedObject,
    settings: CollisionSettings | None = None,
    *,
    store: Path | None = None,
    progress: Progress = no_progress,
) -> Collision:
    """Make collision shapes of every part.

    Hollow parts stay hollow, and links that move against each other don't overlap at rest. Shapes
    that the source declares are kept and the others are cut to fit; declared shapes are cut only
    over the range of joints with :attr:`Joint.give_way`.

    Args:
        store: folder of cached shapes, see :mod:`model.physics.collision.store`.

    Raises:
        GeometryError: for a part without geometry.
    """
    settings = settings or CollisionSettings()
    declared = {link: shapes for link, shapes in obj.shapes.items() if link in obj.tree.links}
    if all(p.link in declared for p in obj.parts) and not any(j.give_way for j in obj.tree.joints):
        progress(1.0, "collision shapes are declared by the source")
        return declared
    key = _object_key(obj, settings, declared)
    shapes = load_shapes(store, key)
    if shapes is None:
        shapes = recent_objects.get(
            key, lambda: _make_shapes(obj, settings, declared, store, progress)
        )
        save_shapes(store, key, shapes)
    progress(1.0, "collision shapes are ready")
    return shapes


recent_objects: LruCache[str, dict[str, tuple[Shape, ...]]] = LruCache(8)
"""Shapes of the last objects of this process: validation and exporters need the same ones."""


def _object_key(
    obj: ArticulatedObject, settings: CollisionSettings, declared: Mapping[str, tuple[Shape, ...]]
) -> str:
    of = "name type parent child axis origin lower upper mimic".split()
    ranges = [(*(getattr(j, n) for n in of), *["gives way"] * j.give_way) for j in obj.tree.joints]
    parts = (v for p in obj.parts for v in (p.link, p))
    arrays = sorted(packed(declared).items()) if declared else ()
    return fingerprint("object 3", settings, ranges, *parts, *(v for item in arrays for v in item))


def _make_shapes(
    obj: ArticulatedObject,
    settings: CollisionSettings,
    declared: Mapping[str, tuple[Shape, ...]],
    store: Path | None,
    progress: Progress,
) -> dict[str, tuple[Shape, ...]]:
    for i, part in enumerate(obj.parts):
        progress(0.4 * i / len(obj.parts), f"surface of {part.link}")
        part_mesh(part, store)  # raises for a part without geometry
    diagonal = _diagonal_of(obj.parts)
    made: dict[str, _PartBodies] = {}
    for i, part in enumerate(obj.parts):
        if part.link not in declared:
            progress(0.4 + 0.5 * i / len(obj.parts), f"collision shapes of {part.link}")
            made[part.link] = _part_bodies(part, diagonal, settings, store)
    progress(0.9, "resolving overlaps")
    bodies: Bodies = {link: list(each.bodies) for link, each in made.items()}
    bodies |= {link: [hull_of_shape(s) for s in shapes] for link, shapes in declared.items()}
    free, kept = _free_ranges(obj), frozenset(declared)
    if settings.resolve_overlaps:
        bodies = {
            k: v
            if k in kept
            else _without_slivers([simplified(h, settings.max_vertices) for h in v])
            for k, v in resolve_overlaps(bodies, obj.tree, diagonal, free, kept).items()
        }
    of_declared = {id(hull_of_shape(s)): s for shapes in declared.values() for s in shapes}
    out: dict[str, tuple[Shape, ...]] = {
        k: tuple(of_declared.get(id(h), h) for h in hulls) for k, hulls in bodies.items()
    }
    if settings.primitives:
        similar = {
            id(s): p
            for each in made.values()
            for s, p in zip(each.bodies, each.primitives, strict=True)
        }
        out |= _with_primitives(obj, bodies, similar, diagonal, free, kept)
    return out


def _without_slivers(hulls: list[Hull]) -> list[Hull]:
    """Leave out what cuts made too thin, unless nothing else is left."""
    return [h for h in hulls if h.thickness >= SLIVER] or hulls


def prepare_bodies(
    parts: Sequence[Part],
    store: Path,
    progress: Progress = no_progress,
    declared: Collection[str] = (),
) -> None:
    """Cache the bodies that :func:`collision_of` needs whatever the joints are.

    The last part comes first: a caller of :func:`collision_of` meanwhile begins with the first.

    Args:
        declared: links whose shapes the source declares.
    """
    settings = CollisionSettings()
    diagonal = _diagonal_of(parts)
    for i, part in enumerate(reversed(parts)):
        progress(i / len(parts), f"collision shapes of {part.link}")
        part_mesh(part, store)
        if part.link not in declared:
            _cached_bodies(part, diagonal, settings, store)


def _free_ranges(obj: ArticulatedObject) -> FreeRange:
    """The range in which a joint's parts don't collide; everything where shapes are shrunk."""
    known: dict[str, tuple[float, float]] = {}

    def free(joint: Joint) -> tuple[float, float]:
        if joint.give_way:
            return -np.inf, np.inf
        if joint.name not in known:
            swept = driven(obj.tree, joint)
            known[joint.name] = sweep_joint(obj, swept, 9, points=SWEPT_POINTS).free
        return known[joint.name]

    return free


def _cached_bodies(
    part: Part, diagonal: float, settings: CollisionSettings, store: Path | None
) -> list[Hull]:
    plain = replace(settings, resolve_overlaps=False, primitives=False, max_vertices=64)
    key = fingerprint("part", plain, round(diagonal, 6), part)
    cached = load_shapes(store, key)
    if cached is not None:
        return [h for h in cached["part"] if isinstance(h, Hull)]
    bodies = bodies_of(part, diagonal, plain)
    save_shapes(store, key, {"part": tuple(bodies)})
    return bodies


@dataclass(frozen=True, eq=False)
class _PartBodies:
    """Bodies of a part, whatever its joints are.

    Attributes:
        bodies: with few vertices. primitives: similar to each body before it was simplified.
    """

    bodies: tuple[Hull, ...]
    primitives: tuple[Primitive | None, ...]


def _part_bodies(
    part: Part, diagonal: float, settings: CollisionSettings, store: Path | None
) -> _PartBodies:
    def make() -> _PartBodies:
        full = _cached_bodies(part, diagonal, settings, store)
        bodies = tuple(simplified(h, settings.max_vertices) for h in full)
        primitives = map(primitive_of, full) if settings.primitives else [None] * len(full)
        return _PartBodies(bodies, tuple(primitives))

    # With the link: bodies are identified by their ids, so no two parts may share one.
    return recent_parts.get((part.link, fingerprint(settings, round(diagonal, 6), part)), make)


recent_parts: LruCache[tuple[str, str], _PartBodies] = LruCache(128)
"""Bodies of the last parts: most edits change a joint."""


def _diagonal_of(parts: Sequence[Part]) -> float:
    bounds = np.stack([p.bounds for p in parts]) if parts else np.zeros((1, 2, 3))
    return float(np.linalg.norm(bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)))


def bodies_of(part: Part, diagonal: float, settings: CollisionSettings) -> list[Hull]:
    """Decompose one part into convex bodies.

    Args:
        diagonal: of the whole object in metres; sets the thickness of sheets.
    """
    mesh = simplified_mesh(part_mesh(part))
    thickness = max(SHEET * diagonal, LEAST)
    flat = not (mesh.face_areas > 0).any()
    if flat or settings.method == "hull":
        hull = thick_hull(mesh.vertices[np.unique(mesh.faces)], thickness)
        return [hull if flat else simplified(hull, settings.max_vertices)]
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
    """Few convex bodies that keep free space free, and the voxels that define it."""
    space = occupancy(mesh.triangles[mesh.face_areas > 0])
    surface = FaceExtents(mesh, space, np.random.default_rng(settings.seed))
    patches = decompose(surface, max(2.0, PATCH * space.free_count))
    groups = merge(surface, patches, settings.max_hulls)
    hulls = _filled(surface, groups, thickness)
    return [simplified(h, settings.max_vertices) for h in hulls], space


def _filled(
    surface: FaceExtents, groups: list[npt.NDArray[np.int64]], thickness: float
) -> list[Hull]:
    """Hulls of groups of faces, grown to contain the sealed voxels beneath their faces."""
    hulls = [thick_hull(surface.corners(faces), thickness) for faces in groups]
    outside = np.ones(len(surface.beneath), bool)
    for hull in hulls:
        outside &= ~hull.contains(surface.beneath, -0.5 * surface.space.size)
    if not outside.any():
        return hulls
    group_of = np.zeros(len(surface.mesh.faces), np.int64)
    for i, faces in enumerate(groups):
        group_of[faces] = i
    group = group_of[surface.owner[outside]]
    for i in np.unique(group):
        more = surface.beneath[outside][group == i]
        hulls[i] = thick_hull(np.concatenate([hulls[i].vertices, more]), thickness)
    return hulls


def covered(space: Occupancy, bodies: list[Hull]) -> float:
    """Share of the free voxels whose centres are inside of bodies."""
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


def simplified_mesh(mesh: Mesh, most: int = MOST_FACES) -> Mesh:
    """Simplify by vertex clustering (Rossignac and Borrel, 1993) to at most ``most`` faces.

    That is enough for bodies, which are coarser by far.
    """
    if len(mesh.faces) <= most:
        return mesh
    low, high = mesh.bounds
    cells = 256.0
    while True:
        grid = np.floor((mesh.vertices - low) / float((high - low).max()) * cells)
        first, inverse = same_points(grid)
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


def _with_primitives(
    obj: ArticulatedObject,
    bodies: Bodies,
    similar: Mapping[int, Primitive | None],
    diagonal: float,
    free: FreeRange,
    declared: frozenset[str],
) -> dict[str, tuple[Shape, ...]]:
    """Replace bodies by similar primitives where those overlap nothing.

    Args:
        similar: id of a body that was not cut → similar primitive.
        declared: links that are left out.
    """
    shapes: dict[str, list[Shape]] = {
        k: [(similar[id(h)] if id(h) in similar else primitive_of(h)) or h for h in hulls]
        for k, hulls in bodies.items()
        if k not in declared
    }
    tried = bodies | {k: [hull_of_shape(s) for s in each] for k, each in shapes.items()}
    for link, i in overlapping_bodies(tried, obj.tree, diagonal, free):
        if link not in declared:
            shapes[link][i] = bodies[link][i]
    return {k: tuple(each) for k, each in shapes.items()}
