"""Triangle soups of simple solids, and a builder that groups them into parts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

Triangles = npt.NDArray[np.float64]
Vector = npt.ArrayLike

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def block(low: Vector, high: Vector, bevel: float = 0.0) -> Triangles:
    """(T, 3, 3) axis-aligned box from corner to corner; ``bevel`` cuts its edges (metres)."""
    corners = np.stack([np.asarray(low, float), np.asarray(high, float)])
    corners = np.sort(corners, axis=0)
    bevel = min(bevel, 0.45 * float((corners[1] - corners[0]).min()))
    points = []
    for index in np.ndindex(2, 2, 2):
        at = corners[list(index), [0, 1, 2]]
        if bevel <= 0:
            points.append(at)
            continue
        inward = np.where(np.array(index) == 0, bevel, -bevel)
        points += [at + inward * keep for keep in 1 - np.eye(3)]
    hull = ConvexHull(np.array(points), qhull_options="QJ" if bevel > 0 else "Qt")
    triangles = hull.points[hull.simplices]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    wrong = np.einsum("ij,ij->i", normal, hull.equations[:, :3]) < 0
    triangles[wrong] = triangles[wrong][:, ::-1]
    return triangles


def lathe(profile: Vector, segments: int = 36) -> Triangles:
    """Surface of revolution about +z of (K, 2) radius and height."""
    line = np.asarray(profile, float)
    turn = np.linspace(0, 2 * np.pi, segments + 1)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    grid = np.concatenate(
        [line[:, None, :1] * ring[None], np.repeat(line[:, None, 1:], segments + 1, axis=1)], axis=2
    )
    return _grid_triangles(grid)


def _grid_triangles(grid: npt.NDArray[np.float64]) -> Triangles:
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    triangles = np.concatenate(
        [np.stack([a, b, c], axis=2).reshape(-1, 3, 3), np.stack([a, c, d], 2).reshape(-1, 3, 3)]
    )
    area = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    return triangles[area > 1e-14]


def rod(start: Vector, end: Vector, radius: float, end_radius: float | None = None) -> Triangles:
    """A closed cylinder or cone frustum between two points."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = float(np.linalg.norm(end - start))
    top = radius if end_radius is None else end_radius
    solid = lathe([(0, 0), (radius, 0), (top, length), (0, length)], 28)
    return solid @ _frame(end - start).T + start


def _frame(direction: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Columns u, v, w with w along ``direction``."""
    w = direction / max(float(np.linalg.norm(direction)), 1e-12)
    helper = np.array([1.0, 0, 0]) if abs(w[0]) < 0.8 else np.array([0, 1.0, 0])
    u = np.cross(helper, w)
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(w, u), w], axis=1)


def tube(path: Vector, radius: float, segments: int = 14) -> Triangles:
    """A round tube along (K, 3) points; closed where the path returns to its start."""
    path = np.asarray(path, float)
    turn = np.linspace(0, 2 * np.pi, segments + 1)
    tangent = np.gradient(path, axis=0)
    u = _frame(tangent[0])[:, 0]
    rings = []
    for at, step in zip(path, tangent, strict=True):
        along = step / max(float(np.linalg.norm(step)), 1e-12)
        u = u - along * (u @ along)
        u /= np.linalg.norm(u)
        v = np.cross(along, u)
        rings.append(at + radius * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v))
    return _grid_triangles(np.array(rings))


def ring(center: Vector, axis: Vector, radius: float, thickness: float) -> Triangles:
    """A torus."""
    turn = np.linspace(0, 2 * np.pi, 33)
    circle = radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    path = circle @ _frame(np.asarray(axis, float)).T + np.asarray(center, float)
    return tube(path, thickness)


def ball(center: Vector, radius: float) -> Triangles:
    """A sphere."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 17)
    solid = lathe(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), 28)
    return solid + np.asarray(center, float)


def turned(triangles: Triangles, axis: Vector, angle: float, origin: Vector) -> Triangles:
    """``triangles`` turned by ``angle`` rad about the line through ``origin``."""
    direction = np.asarray(axis, float)
    rotation = Rotation.from_rotvec(angle * direction / np.linalg.norm(direction)).as_matrix()
    about = np.asarray(origin, float)
    return (triangles - about) @ rotation.T + about


@dataclass
class Builder:
    """Collects solids with their part and colour.

    Attributes:
        rng: the only randomness.
        palette: colours to draw from; few, so that neighbours often share one.
    """

    rng: np.random.Generator
    palette: npt.NDArray[np.float64] = field(init=False)
    solids: list[tuple[Triangles, int, npt.NDArray[np.float64]]] = field(default_factory=list)
    parts: int = 1

    def __post_init__(self) -> None:
        base = self.rng.uniform(40, 235, 3)
        gray = self.rng.uniform(30, 235) * np.ones(3)
        other = np.clip(base + self.rng.normal(0, 40, 3), 10, 250)
        self.palette = np.stack([base, gray, other, self.rng.uniform(20, 240, 3)])

    def uniform(self, low: float, high: float) -> float:
        """One number."""
        return float(self.rng.uniform(low, high))

    def chance(self, probability: float) -> bool:
        """True with this probability."""
        return bool(self.rng.random() < probability)

    def new_part(self) -> int:
        """The next free part id."""
        self.parts += 1
        return self.parts - 1

    def color(self, same: float = 0.5) -> npt.NDArray[np.float64]:
        """The main colour with probability ``same``, else another of the palette."""
        return self.palette[0 if self.chance(same) else self.rng.integers(len(self.palette))]

    def add(
        self, part: int, triangles: Triangles, color: npt.NDArray[np.float64] | None = None
    ) -> None:
        """Add one solid to a part."""
        self.solids.append((triangles, part, self.palette[0] if color is None else color))

    def turn_since(self, start: int, axis: Vector, angle: float, origin: Vector) -> None:
        """Turn the solids added since ``start`` (an earlier ``len(solids)``)."""
        for i in range(start, len(self.solids)):
            triangles, part, color = self.solids[i]
            self.solids[i] = (turned(triangles, axis, angle, origin), part, color)
