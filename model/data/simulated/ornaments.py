"""Ornaments on the flat sides of procedural objects: panels, frames, ribs, labels, vents, studs.

Real furniture and appliances have detail within their parts that plain boards lack, and a click on
a door means the door, not its panel. Sides of equal size get the same ornament, as in a row of
drawers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.core.geometry import Material, Mesh
from model.data.simulated.primitives import Triangles, block, lathe
from model.data.simulated.scans import Shape
from model.geometry.casting import Caster
from model.geometry.sampling import colors_at

Float = npt.NDArray[np.float64]

_LEAST = 0.04
"""Least side of a rectangle that gets an ornament, in diagonals."""
_RECTANGLE = 0.8
"""Least share of its bounding rectangle that a flat side fills."""
_MOST = 14
_SAME_COLOR, _NEAR_COLOR = 0.55, 0.25
_EVERY_SIDE = 0.6


@dataclass(frozen=True, eq=False)
class _Side:
    """A flat, rectangular side of a part.

    Attributes:
        part: that it belongs to; face: one of its faces.
        corner: (3,) metres; frame: (3, 3) unit rows along its sides and outwards.
        size: (2,) metres along the first two.
    """

    part: int
    face: int
    corner: Float
    frame: Float
    size: Float


def ornamented(shape: Shape, rng: np.random.Generator) -> Shape:
    """``shape`` with ornaments on some of its flat sides; the parts are unchanged."""
    diagonal = float(np.linalg.norm(np.ptp(shape.mesh.vertices, axis=0)))
    sides = _sides(shape, _LEAST * diagonal)
    if not sides:
        return shape
    caster = Caster([shape.mesh])
    style: dict[tuple[int, ...], int] = {}
    made: list[tuple[Triangles, int, tuple[int, int, int, int]]] = []
    for index in rng.permutation(len(sides)):
        side = sides[index]
        alike = tuple(np.round(np.log(side.size) / 0.1).astype(int).tolist())
        seed = style.setdefault(alike, int(rng.integers(1 << 31)) if _wanted(rng) else -1)
        if seed < 0 or len(style) > _MOST:
            continue
        of_kind = np.random.default_rng(seed)
        depth = float(of_kind.uniform(0.01, 0.06) * side.size.min())
        if _covered(caster, side, max(3 * depth, 0.01 * diagonal)):
            continue
        ornament = _KINDS[of_kind.integers(len(_KINDS))]
        solids = ornament(side.size, depth, of_kind)
        color = _color(shape.mesh, side.face, of_kind)
        made += [(s @ side.frame + side.corner, side.part, color) for s in solids]
    return _with(shape, made) if made else shape


def _wanted(rng: np.random.Generator) -> bool:
    return bool(rng.random() < _EVERY_SIDE)


def _sides(shape: Shape, least: float) -> list[_Side]:
    """The flat sides of all parts that nearly fill a rectangle of at least ``least`` metres."""
    mesh = shape.mesh
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1) / 2
    there = np.flatnonzero(area > 1e-3 * least**2)
    normal = cross[there] / (2 * area[there, None])
    offset = np.einsum("ij,ij->i", normal, corners[there, 0])
    step = 0.05 * least
    key = np.column_stack(
        [shape.part[there], np.round(normal * 50), np.round(offset / step)]
    ).astype(np.int64)
    _, group = np.unique(key, axis=0, return_inverse=True)
    order = np.argsort(group, kind="stable")
    out = []
    for faces in np.split(there[order], np.flatnonzero(np.diff(group[order])) + 1):
        total = float(area[faces].sum())
        if total < _RECTANGLE * least**2:
            continue
        up = cross[faces].sum(0)
        up /= max(float(np.linalg.norm(up)), 1e-12)
        helper = np.array([0.0, 0.0, 1.0]) if abs(up[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
        across = np.cross(helper, up)
        across /= np.linalg.norm(across)
        frame = np.stack([across, np.cross(up, across), up])
        flat = corners[faces].reshape(-1, 3) @ frame.T
        low, high = flat.min(0), flat.max(0)
        size = (high - low)[:2]
        if size.min() < least or total < _RECTANGLE * size.prod():
            continue
        corner = np.array([low[0], low[1], high[2]]) @ frame
        out.append(_Side(int(shape.part[faces[0]]), int(faces[0]), corner, frame, size))
    return out


def _covered(caster: Caster, side: _Side, reach: float) -> bool:
    """True if something is close in front of a side: the tray of a closed drawer is hidden."""
    spots = np.array([(0.2, 0.2), (0.2, 0.8), (0.5, 0.5), (0.8, 0.2), (0.8, 0.8)]) * side.size
    start = side.corner + spots @ side.frame[:2] + 1e-4 * reach * side.frame[2]
    found = caster.cast(start, np.tile(side.frame[2], (len(start), 1)), colors=False)
    return bool((found.distance < reach).sum() > 1)


def _color(mesh: Mesh, face: int, rng: np.random.Generator) -> tuple[int, int, int, int]:
    own = colors_at(mesh, np.array([face]), np.full((1, 3), 1 / 3))[0, :3].astype(float)
    chance = rng.random()
    if chance > _SAME_COLOR + _NEAR_COLOR:
        own = rng.uniform(20, 240, 3)
    elif chance > _SAME_COLOR:
        own = own * rng.uniform(0.6, 1.3)
    red, green, blue = np.clip(own, 0, 255).astype(int).tolist()
    return red, green, blue, 255


def _with(shape: Shape, made: list[tuple[Triangles, int, tuple[int, int, int, int]]]) -> Shape:
    mesh = shape.mesh
    count = [len(t) for t, _, _ in made]
    vertices = np.concatenate([t.reshape(-1, 3) for t, _, _ in made])
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3) + len(mesh.vertices)
    materials = tuple(Material(f"ornament_{i}", c) for i, (_, _, c) in enumerate(made))
    own = np.repeat(np.arange(len(made), dtype=np.int32), count) + len(mesh.materials)
    uv, color = mesh.uv, mesh.vertex_colors
    if uv is not None:
        uv = np.concatenate([uv, np.zeros((len(vertices), 2), np.float32)])
    if color is not None:
        rgba = np.repeat([c for _, _, c in made], 3 * np.array(count), axis=0)
        color = np.concatenate([color, rgba.astype(np.uint8)])
    joint = Mesh(
        np.concatenate([mesh.vertices, vertices]),
        np.concatenate([mesh.faces, faces]),
        np.concatenate([mesh.face_material, own]),
        (*mesh.materials, *materials),
        uv,
        color,
    )
    part = np.concatenate([shape.part, np.repeat([p for _, p, _ in made], count)])
    return replace(shape, mesh=joint, part=part.astype(shape.part.dtype), object=None)


# Triangles on a rectangle (size) at z = 0 that stand out by about ``depth``.


def _bar(low: Sequence[float], high: Sequence[float], depth: float) -> Triangles:
    return block((*low, -0.2 * depth), (*high, depth), 0.0)


def _border(size: Float, width: float, depth: float) -> list[Triangles]:
    w, h = size
    return [
        _bar((0, 0), (width, h), depth),
        _bar((w - width, 0), (w, h), depth),
        _bar((width, 0), (w - width, width), depth),
        _bar((width, h - width), (w - width, h), depth),
    ]


def _frame(size: Float, depth: float, rng: np.random.Generator) -> list[Triangles]:
    return _border(size, float(rng.uniform(0.06, 0.25) * size.min()), depth)


def _panel(size: Float, depth: float, rng: np.random.Generator) -> list[Triangles]:
    inset = float(rng.uniform(0.08, 0.3) * size.min())
    low, high = (inset, inset), (size[0] - inset, size[1] - inset)
    bevel = 0.4 * depth if rng.random() < 0.5 else 0.0
    return [block((*low, -0.2 * depth), (*high, depth), bevel)]


def _framed_panel(size: Float, depth: float, rng: np.random.Generator) -> list[Triangles]:
    width = float(rng.uniform(0.06, 0.18) * size.min())
    inner = np.array(size) - 2 * width
    shifted = [t + (width, width, 0) for t in _panel(inner, 0.7 * depth, rng)]
    return [*_border(size, width, depth), *shifted]


def _ribs(size: Float, depth: float, rng: np.random.Generator) -> list[Triangles]:
    """Parallel bars over all of the side, or over a vent in it."""
    axis, number = int(rng.integers(2)), int(rng.integers(3, 14))
    low, high = np.zeros(2), np.array(size)
    if rng.random() < 0.5:
        low = rng.uniform(0.05, 0.45, 2) * size
        high = low + rng.uniform(0.25, 0.5, 2) * size
    pitch = (high[axis] - low[axis]) / number
    thick = pitch * rng.uniform(0.3, 0.9)
    out = []
    for k in range(number):
        begin, end = low.copy(), high.copy()
        begin[axis] = low[axis] + k * pitch
        end[axis] = begin[axis] + thick
        out.append(_bar(tuple(begin.tolist()), tuple(end.tolist()), depth))
    return out


def _label(size: Float, depth: float, rng: np.random.Generator) -> list[Triangles]:
    """Thin plates: a display, a badge, a strip."""
    out = []
    for _ in range(int(rng.integers(1, 4))):
        low = rng.uniform(0.03, 0.7, 2) * size
        high = np.minimum(low + rng.uniform(0.08, 0.7, 2) * size, 0.98 * size)
        thin = 0.15 * depth
        out.append(_bar(tuple(low.tolist()), tuple(high.tolist()), thin))
    return out


def _studs(size: Float, depth: float, rng: np.random.Generator) -> list[Triangles]:
    """Discs and domes in a row, in a grid or at random."""
    radius = float(rng.uniform(0.02, 0.09) * size.min())
    top = float(rng.choice([0.6, 1.0]) * radius)
    stud = lathe([(0, -0.2 * depth), (radius, -0.2 * depth), (top, depth), (0, depth)], 20)
    across, up = int(rng.integers(1, 5)), int(rng.integers(1, 4))
    if rng.random() < 0.3:
        spots = rng.uniform(0.12, 0.88, (across * up, 2))
    else:
        line = [np.linspace(0.12, 0.88, n) if n > 1 else np.array([0.5]) for n in (across, up)]
        spots = np.stack(np.meshgrid(*line), axis=-1).reshape(-1, 2)
    return [stud + (*(s * size).tolist(), 0.0) for s in spots]


def _disc(size: Float, depth: float, rng: np.random.Generator) -> list[Triangles]:
    """One large disc or ring in the middle."""
    radius = float(rng.uniform(0.2, 0.45) * size.min())
    inner = float(rng.choice([0.0, rng.uniform(0.5, 0.9)])) * radius
    profile = [(inner, -0.2 * depth), (radius, -0.2 * depth), (radius, depth), (inner, depth)]
    return [lathe([*profile, profile[0]], 32) + (*(np.array(size) / 2).tolist(), 0.0)]


_KINDS: tuple[Callable[[Float, float, np.random.Generator], list[Triangles]], ...] = (
    _frame, _frame, _panel, _panel, _framed_panel, _framed_panel, _framed_panel,
    _ribs, _label, _studs, _disc,
)  # fmt: skip
