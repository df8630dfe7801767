"""Shapes that the benchmarks measure with."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part, SegmentedObject
from model.core.geometry import Mesh

Array = npt.NDArray[np.float64]


def chest(drawers: int) -> SegmentedObject:
    """A chest with ``drawers`` drawers in columns of four, each an open box with a handle."""
    columns = -(-drawers // 4)
    rows = -(-drawers // columns)
    wide, high, deep = 0.5, 0.2, 0.45
    size = np.array([deep, columns * wide, rows * high])
    wall = 0.015
    low = np.array([-deep / 2, -size[1] / 2, 0.0])
    wide_all, high_all = float(size[1]), float(size[2])
    walls = [
        _box(low, (-wall, -wall, -wall), (deep, wide_all + wall, 0.0)),
        _box(low, (-wall, -wall, high_all), (deep, wide_all + wall, high_all + wall)),
        _box(low, (-wall, -wall, 0.0), (deep, 0.0, high_all)),
        _box(low, (-wall, wide_all, 0.0), (deep, wide_all + wall, high_all)),
        _box(low, (-wall, 0.0, 0.0), (0.0, wide_all, high_all)),
    ]
    parts = [Part("link_0", mesh=joined(walls))]
    gap, thin = 0.004, 0.01
    x, y, z = deep - gap, wide - 2 * gap, high - 2 * gap
    for i in range(drawers):
        at = np.add(low, (gap, (i // rows) * wide + gap, (i % rows) * high + gap))
        boxes = [
            _box(at, (0.0, 0.0, 0.0), (x, y, thin)),
            _box(at, (0.0, 0.0, 0.0), (x, thin, z)),
            _box(at, (0.0, y - thin, 0.0), (x, y, z)),
            _box(at, (0.0, 0.0, 0.0), (thin, y, z)),
            _box(at, (x - thin, 0.0, 0.0), (x, y, z)),
            _box(at, (x, y / 2 - 0.06, z / 2 - 0.008), (x + 0.03, y / 2 + 0.06, z / 2 + 0.008)),
        ]
        parts.append(Part(f"link_{i + 1}", mesh=joined(boxes), name="drawer"))
    return SegmentedObject("chest", tuple(parts), "cabinet")


def _box(at: np.ndarray, low: tuple[float, ...], high: tuple[float, ...]) -> Mesh:
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    vertices = at + np.asarray(low) + corner * np.subtract(high, low)
    return Mesh(vertices, np.array(faces, np.int32))


def joined(meshes: list[Mesh]) -> Mesh:
    """One mesh of several."""
    counts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + start for m, start in zip(meshes, counts, strict=False)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def grid_box(cells: int, center: Array, size: Array) -> Mesh:
    """A box whose six sides are grids of ``cells`` × ``cells`` squares."""
    line = np.linspace(-0.5, 0.5, cells + 1)
    u, v = (g.ravel() for g in np.meshgrid(line, line, indexing="ij"))
    index = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    grid = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    vertices, triangles = [], []
    for axis in range(3):
        for end in (-0.5, 0.5):
            side = np.empty((len(u), 3))
            side[:, axis], side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = end, u, v
            triangles.append((grid if end > 0 else grid[:, ::-1]) + sum(map(len, vertices)))
            vertices.append(center + side * size)
    return Mesh(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32))
