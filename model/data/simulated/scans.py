"""Procedural objects sampled into labelled clouds: clean, noisy, one-sided, by depth cameras.

Half of the objects are the data set's families and composites, half are assemblies of simple solids
that look less tidy. The families of ``HELD_OUT`` are never trained on.

Flat sides get ornaments: panels, frames, ribs, labels, vents, studs. Real furniture and appliances
have detail within their parts that plain boards lack, and a click on a door means the door, not its
panel. Sides of equal size get the same ornament, as in a row of drawers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.geometry import Material, Mesh, PointCloud
from model.data.procedural.examples import joined
from model.data.procedural.families import HELD_OUT
from model.data.procedural.generate import family_names, make
from model.data.simulated import furniture, gadgets
from model.data.simulated.depth_camera import ScanSettings, View, simulate_scan
from model.data.simulated.primitives import Builder, Triangles, block, lathe
from model.geometry.casting import Caster
from model.geometry.sampling import colors_at, sample_surface
from model.segmentation.graph import sphere_directions

Mode = Literal["surface", "outside", "one-sided"]
ASSEMBLIES = (*furniture.FAMILIES, *gadgets.FAMILIES)
FLUSH = (furniture.flush_front.__name__,)
"""Doors and drawers that lie in one plane with their frame."""
_ASSEMBLY = {family.__name__: family for family in (*ASSEMBLIES, furniture.flush_front)}
FAMILIES = tuple(name for name in family_names() if name not in HELD_OUT)
SMALL_PARTED = (
    *"Keyboard Remote Phone Switch Microwave WashingMachine CoffeeMachine Camera Printer".split(),
    *"Dispenser Lamp Safe".split(),
)
"""Families with keys, knobs and buttons."""
DRAWERED = (
    *"StorageFurniture StorageFurniture StorageFurniture Table Cart Refrigerator".split(),
    *"Dishwasher Printer TrashCan Composite".split(),
)
"""Families with drawers, racks and trays within a body."""
SQUARE = (
    *4 * ("StorageFurniture",),
    *2 * ("Table",),
    *2 * ("cabinet",),
    *"table appliance Cart Refrigerator Dishwasher Printer TrashCan Composite".split(),
)
"""Families and assemblies whose parts fill boxes."""

_FAMILY_SHARE = 0.6
_COMPOSITE_SHARE = 0.12
_CAMERA_SHARE = 0.12


@dataclass(frozen=True, eq=False)
class LabelledCloud:
    """A cloud with the true part of each point, -1 for outliers, and the object's family."""

    cloud: PointCloud
    labels: npt.NDArray[np.int16]
    family: str


@dataclass(frozen=True, eq=False)
class Shape:
    """A mesh and the (F,) part of each face; ``object`` if a family of the data set made it."""

    mesh: Mesh
    part: npt.NDArray[np.int16]
    family: str
    object: ArticulatedObject | None = None


def build(seed: int, families: tuple[str, ...] | None = None) -> Shape:
    """A random object, of ``families`` if given, slightly stretched and turned."""
    rng = np.random.default_rng(seed)
    if families is not None:
        name = str(rng.choice(families))
    elif rng.random() < _FAMILY_SHARE:
        name = _family(rng)
    else:
        name = ASSEMBLIES[rng.integers(len(ASSEMBLIES))].__name__
    shape = _assembly(name, rng) if name in _ASSEMBLY else family_shape(name, seed)
    stretch = np.exp(rng.normal(0, 0.12, 3))
    angle = rng.choice([0.0, rng.uniform(0, 2 * np.pi)])
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    return replace(shape, mesh=replace(shape.mesh, vertices=shape.mesh.vertices * stretch @ turn.T))


def _family(rng: np.random.Generator) -> str:
    if rng.random() < _COMPOSITE_SHARE / _FAMILY_SHARE:
        return family_names()[-1]
    return str(rng.choice(FAMILIES))


def family_shape(name: str, seed: int) -> Shape:
    """An object of the data set's family ``name``, unchanged."""
    made = make(name, seed).object
    mesh, part = joined(made)
    return Shape(mesh, part.astype(np.int16), name, made)


def _assembly(name: str, rng: np.random.Generator) -> Shape:
    builder = Builder(rng)
    _ASSEMBLY[name](builder)
    triangles = np.concatenate([s[0] for s in builder.solids])
    counts = [len(s[0]) for s in builder.solids]
    part = np.repeat([s[1] for s in builder.solids], counts).astype(np.int16)
    materials = tuple(
        Material(f"solid_{i}", base_color=(int(red), int(green), int(blue), 255))
        for i, (red, green, blue) in enumerate(np.clip(s[2], 0, 255) for s in builder.solids)
    )
    mesh = Mesh(
        triangles.reshape(-1, 3),
        np.arange(3 * len(triangles), dtype=np.int32).reshape(-1, 3),
        np.repeat(np.arange(len(counts), dtype=np.int32), counts),
        materials,
    )
    return Shape(mesh, part, name)


def visible_from(
    points: npt.NDArray, directions: npt.NDArray[np.float64], pixel: float
) -> npt.NDArray[np.float64]:
    """(N,) number of directions that see each point, by depth buffers with pixels in metres."""
    visible = np.zeros(len(points))
    for w in directions:
        helper = np.array([1.0, 0, 0]) if abs(w[0]) < 0.8 else np.array([0, 1.0, 0])
        u = np.cross(w, helper)
        u /= np.linalg.norm(u)
        local = points @ np.stack([u, np.cross(w, u), w], axis=1)
        grid = np.floor((local[:, :2] - local[:, :2].min(0)) / pixel).astype(np.int64)
        key = grid[:, 0] * (grid[:, 1].max() + 1) + grid[:, 1]
        top = np.full(int(key.max()) + 1, -np.inf)
        np.maximum.at(top, key, local[:, 2])
        visible += local[:, 2] > top[key] - 1.5 * pixel
    return visible


def scan(shape: Shape, count: int, mode: Mode, noise: float, seed: int) -> LabelledCloud:
    """Sample ``shape``.

    Args:
        count: of points; fewer if little is visible.
        mode: all surfaces, those visible from all around, or those visible from two near views.
        noise: standard deviation along all axes, in diagonals of the bounding box.
    """
    rng = np.random.default_rng(seed)
    low, high = shape.mesh.vertices.min(0), shape.mesh.vertices.max(0)
    diagonal = float(np.linalg.norm(high - low))
    cloud, face = sample_surface(shape.mesh, count if mode == "surface" else 3 * count, rng)
    assert cloud.colors is not None and cloud.normals is not None
    points, normal = cloud.points.astype(np.float64), cloud.normals.astype(np.float64)
    keep = np.arange(len(points))
    if mode != "surface":
        if mode == "outside":
            directions = sphere_directions(32)
            directions = directions[directions[:, 2] > -0.5]
        else:
            azimuth = -np.pi / 2 + rng.uniform(-0.6, 0.6) + np.array([-0.4, 0.4])
            up = rng.uniform(0.2, 0.7)
            directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.full(2, up)], axis=1)
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        area = diagonal**2 / len(points)
        visible = visible_from(points, directions, 1.2 * np.sqrt(area)) > 0
        if mode == "one-sided":
            facing = np.abs(normal @ directions.T).max(1)
            visible &= rng.random(len(points)) < facing
            for _ in range(int(rng.integers(0, 4))):
                hole = points[rng.integers(len(points))]
                apart = np.linalg.norm(points - hole, axis=1)
                visible &= apart > rng.uniform(0.01, 0.05) * diagonal
        keep = np.nonzero(visible)[0][:count]
    colors = _painted(cloud.colors[keep], points[keep], normal[keep], diagonal, rng)
    noisy = points[keep] + rng.normal(0, noise * diagonal, (len(keep), 3))
    out = PointCloud(noisy.astype(np.float32), colors=None if rng.random() < 0.2 else colors)
    return LabelledCloud(out, shape.part[face[keep]], shape.family)


def _painted(
    colors: npt.NDArray[np.uint8],
    points: npt.NDArray,
    normal: npt.NDArray,
    diagonal: float,
    rng: np.random.Generator,
) -> npt.NDArray[np.uint8]:
    """Colours with texture, shading and sensor noise, so that flat colour tells little."""
    color = colors.astype(np.float64)
    wave = rng.normal(0, 1, 3) * rng.choice([3, 15, 60]) / diagonal
    color *= 1 + rng.choice([0, 0.05, 0.15]) * np.sin(points @ wave)[:, None]
    light = rng.normal(size=3)
    light /= np.linalg.norm(light)
    color *= 1 - rng.choice([0, 0.2, 0.4]) * (0.5 - 0.5 * np.abs(normal @ light))[:, None]
    color += rng.normal(0, rng.choice([0, 3, 10]), color.shape)
    return np.clip(color, 0, 255).astype(np.uint8)


def _photographed(
    shape: Shape, count: int, noise: float, rng: np.random.Generator
) -> LabelledCloud:
    """The scan of one to four simulated depth cameras in front of the object."""
    assert shape.object is not None
    around = rng.uniform(-0.9, 0.9, rng.integers(1, 5))
    found = simulate_scan(shape.object, depth_cameras(shape, around, count, noise, rng), rng)
    return LabelledCloud(found.cloud, found.part.astype(np.int16), shape.family)


def depth_cameras(
    shape: Shape,
    around: npt.NDArray[np.float64],
    count: int,
    noise: float,
    rng: np.random.Generator,
) -> ScanSettings:
    """Depth cameras at random heights in front of a shape.

    Args:
        around: (cameras,) azimuths in radians.
        count: points.
        noise: of a point, in diagonals of the shape.
    """
    size = float(np.linalg.norm(np.ptp(shape.mesh.vertices, axis=0)))
    return ScanSettings(
        tuple(View(float(a), float(rng.uniform(0.05, 0.7))) for a in around),
        count,
        # Depths are about 1.6 diagonals, and the noise grows with their square.
        depth_noise=noise * size / max((1.6 * size) ** 2, 1e-6),
        misalignment=0.3 * noise * size,
    )


def random_scan(
    seed: int, count: int | None = None, families: tuple[str, ...] | None = None
) -> LabelledCloud:
    """A random object in a random mode, 20k to 80k points; see :func:`build`."""
    rng = np.random.default_rng([seed, 1])
    mode: Mode = rng.choice(["surface", "surface", "outside", "one-sided"])  # type: ignore[assignment]
    noise = float(rng.choice([0, 0.0003, 0.001, 0.002]))
    count = int(rng.choice([20_000, 40_000, 80_000])) if count is None else count
    shape = build(seed, families)
    if shape.object is not None and rng.random() < _CAMERA_SHARE / _FAMILY_SHARE:
        return _photographed(shape, count, noise, rng)
    return scan(shape, count, mode, noise, seed)


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


_KINDS = (_frame, _frame, _panel, _panel, *3 * (_framed_panel,), _ribs, _label, _studs, _disc)
