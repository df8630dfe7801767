"""Quality of collision shapes: free space, and overlaps at rest and over the range."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.shapes import Hull, hull_of_shape, thick_hull
from model.physics.collision.build import Collision, covered, simplified_mesh
from model.physics.collision.convex_bodies import occupancy
from model.physics.collision.decomposition import coacd_hulls
from model.physics.collision.narrow_phase import overlaps
from model.physics.collision.overlap_resolution import moving_pairs, poses_over_range
from model.physics.part_mesh import part_mesh

VOXELS = 200_000
"""More than shapes are made with, so that they aren't scored by their own measure."""
SAMPLES = 9
"""Poses of each joint's range."""


@dataclass(frozen=True)
class FreeVolume:
    """Free space of an object's parts, each by itself.

    Voxels of a part's box are free where they are reachable from outside without crossing its
    surface, and kept where no shape of the part contains their centre.

    Attributes:
        volume: m³ of free space in all parts' boxes.
        kept: share of it that the shapes keep free.
        kept_by_hull: share that one convex hull per part keeps.
        kept_by_coacd: share that coacd with its defaults keeps; None where it was left out, isn't
            installed, failed on a part or ran out of time.
        hull: link → convex hull of its part.
        coacd: link → coacd's hulls; None where ``kept_by_coacd`` is.
        coacd_seconds: its time.
    """

    volume: float
    kept: float
    kept_by_hull: float
    hull: Collision
    kept_by_coacd: float | None = None
    coacd: Collision | None = None
    coacd_seconds: float | None = None


@dataclass(frozen=True)
class Overlaps:
    """Overlap of shapes whose links move against each other, metres.

    Attributes:
        at_rest: deepest at rest.
        links_at_rest: pairs of links that overlap at rest.
        over_range: joint → deepest while it moves alone.
    """

    at_rest: float
    links_at_rest: tuple[tuple[str, str], ...]
    over_range: Mapping[str, float]


def overlaps_of(obj: ArticulatedObject, collision: Collision) -> Overlaps:
    """Measure overlaps at rest and over the range of each joint that mimics none."""
    bodies = {link: [hull_of_shape(s) for s in shapes] for link, shapes in collision.items()}
    pairs = moving_pairs(obj.tree)
    rest = overlaps(bodies, pairs, obj.tree.pose({}))
    worst = {j.name: 0.0 for j in obj.tree.joints if j.moves and j.mimic is None}
    for joint, _, poses in poses_over_range(obj.tree, SAMPLES):
        moved = obj.tree.descendants(joint.child)
        across = [(a, b) for a, b in pairs if (a in moved) != (b in moved)]
        for touch in overlaps(bodies, across, poses):
            worst[joint.name] = max(worst[joint.name], touch.depth)
    return Overlaps(
        max((t.depth for t in rest), default=0.0),
        tuple(dict.fromkeys((t.a, t.b) for t in rest)),
        worst,
    )


def free_volume(
    obj: ArticulatedObject, collision: Collision, *, coacd_seconds: float = 0.0
) -> FreeVolume:
    """Compare the free space that shapes keep with one hull per part, and with coacd.

    Args:
        coacd_seconds: time limit of coacd for all parts; 0 leaves it out.
    """
    total = kept = by_hull = by_coacd = 0.0
    try_coacd, spent = coacd_seconds > 0, 0.0
    single: dict[str, tuple[Hull, ...]] = {}
    several: dict[str, tuple[Hull, ...]] = {}
    for part in obj.parts:
        mesh = simplified_mesh(part_mesh(part))
        real = mesh.face_areas > 0
        if not real.any():
            continue
        space = occupancy(mesh.triangles[real], VOXELS)
        free = space.free_count * space.size**3
        shapes = [hull_of_shape(s) for s in collision.get(part.link, ())]
        whole = thick_hull(mesh.vertices[np.unique(mesh.faces)], space.size)
        single[part.link] = (whole,)
        total += free
        kept += free * (1 - covered(space, shapes))
        by_hull += free * (1 - covered(space, [whole]))
        if try_coacd:
            start = time.perf_counter()
            found: Sequence[Hull] | None = coacd_hulls(mesh, coacd_seconds - spent)
            spent += time.perf_counter() - start
            try_coacd = found is not None
            by_coacd += free * (1 - covered(space, list(found or ())))
            several[part.link] = tuple(found or ())
    share = 1.0 / max(total, 1e-30)
    return FreeVolume(
        total,
        kept * share if total else 1.0,
        by_hull * share if total else 1.0,
        single,
        by_coacd * share if try_coacd and total else None,
        several if try_coacd else None,
        spent if try_coacd else None,
    )
