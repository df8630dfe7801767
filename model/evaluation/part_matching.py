"""Match predicted to true parts, by geometry and never by name.

The surfaces are compared: points are sampled evenly on each part, and a point belongs to the parts
of the other side with the nearest surface. With ``a`` the area of true part *i* that
lies on predicted part *j*, and ``b`` the area of *j* that lies on *i*,

    IoU(i, j) = I / (A_i + B_j - I),  I = (a + b) / 2.

The assignment with the largest sum of IoU is chosen (Hungarian method), without pairs below
:data:`THRESHOLD`, as in S2O (Iliash et al., 2024). S2O compares boxes instead of surfaces, but a
door and its cabinet's front have the same box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from model.core.articulated_object import Part
from model.geometry.sampling import sample_surface
from model.kinematics.surface import Surface, surface_of

THRESHOLD = 0.5
"""Smallest IoU of a matched pair."""
POINTS = 12_000
"""Samples of an object; every part has at least :data:`LEAST`."""
LEAST = 200
TIE = 2e-4
"""Distance beyond the nearest surface that counts as nearest, in diagonals."""
REACH = 0.02
"""Largest distance of a point from its surface, in diagonals."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PartMatch:
    """A true part and its predicted part.

    Attributes:
        part: link in the truth. link: link in the prediction. iou: of their surfaces, 0..1.
    """

    part: str
    link: str
    iou: float


@dataclass(frozen=True, eq=False)
class SampledPart:
    """Samples of a part; metres, object frame.

    Attributes:
        points: (N, 3) even samples of its surface; a cloud's own points.
        area: of its triangles, or of a cloud's discs (m²).
    """

    link: str
    points: FloatArray
    surface: Surface
    area: float


def sampled_parts(parts: Sequence[Part], *, seed: int = 0) -> list[SampledPart]:
    """Sample parts that have a surface; deterministic."""
    found = [(p, s) for p in parts if (s := surface_of(p)) is not None]
    areas = [_area(s) for _, s in found]
    total = sum(areas) or 1.0
    out: list[SampledPart] = []
    for i, ((part, surface), area) in enumerate(zip(found, areas, strict=True)):
        count = max(LEAST, round(POINTS * area / total))
        points = _points(part, count, np.random.default_rng([seed, i]))
        out.append(SampledPart(part.link, points, surface, area))
    return out


def part_ious(
    truth: Sequence[SampledPart], predicted: Sequence[SampledPart]
) -> npt.NDArray[np.float64]:
    """(T, P) IoU of every true with every predicted part."""
    if not truth or not predicted:
        return np.zeros((len(truth), len(predicted)))
    corners = np.concatenate([t.points for t in truth])
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0))) or 1.0
    on_predicted = np.stack([_shares(t, predicted, diagonal) for t in truth])
    on_truth = np.stack([_shares(p, truth, diagonal) for p in predicted]).T
    a = np.array([t.area for t in truth])[:, None]
    b = np.array([p.area for p in predicted])[None]
    inside = (a * on_predicted + b * on_truth) / 2
    return np.minimum(inside / np.maximum(a + b - inside, 1e-300), 1.0)


def match_parts(
    truth: Sequence[SampledPart], predicted: Sequence[SampledPart]
) -> tuple[PartMatch, ...]:
    """Match pairs with an IoU of at least :data:`THRESHOLD`, in the order of the true parts."""
    iou = part_ious(truth, predicted)
    kept = np.where(iou >= THRESHOLD, iou, 0.0)
    rows, columns = linear_sum_assignment(-kept)
    return tuple(
        PartMatch(truth[i].link, predicted[j].link, float(iou[i, j]))
        for i, j in zip(rows, columns, strict=True)
        if kept[i, j] > 0
    )


def _shares(one: SampledPart, others: Sequence[SampledPart], diagonal: float) -> FloatArray:
    """(len(others),) share of the samples of ``one`` on each of the others."""
    reach = REACH * diagonal
    distance = np.full((len(one.points), len(others)), np.inf)
    for j, other in enumerate(others):
        low, high = other.surface.bounds[0] - reach, other.surface.bounds[1] + reach
        near = ((one.points >= low) & (one.points <= high)).all(axis=1)
        if near.any():
            distance[near, j] = other.surface.distance(one.points[near])[0]
    tie = np.array(
        [max(TIE * diagonal, o.surface.resolution, one.surface.resolution) for o in others]
    )
    nearest = distance.min(axis=1, keepdims=True)
    lies = (distance <= nearest + tie) & (distance <= reach + tie)
    return lies.mean(axis=0)


def _area(surface: Surface) -> float:
    corners = surface.triangles.vertices[surface.triangles.faces]
    a, b, c = np.moveaxis(corners.astype(np.float64), 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2


def _points(part: Part, count: int, rng: np.random.Generator) -> FloatArray:
    if part.mesh is not None and part.mesh.face_areas.sum() > 0:
        return sample_surface(part.mesh, count, rng)[0].points.astype(np.float64)
    points = part.cloud.points if part.cloud is not None else part.mesh.vertices  # type: ignore[union-attr]
    chosen = rng.permutation(len(points))[:count]
    return points[chosen].astype(np.float64)
