"""Procedural objects sampled into labelled clouds: clean, noisy, one-sided, by depth cameras.

Half of the objects are the data set's families and composites, half are assemblies of simple solids
that look less tidy. The families of ``HELD_OUT`` are never trained on.
"""

from __future__ import annotations

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
from model.data.simulated.primitives import Builder
from model.geometry.sampling import sample_surface
from model.segmentation.encode.normals import sphere_directions

Mode = Literal["surface", "outside", "one-sided"]
ASSEMBLIES = (*furniture.FAMILIES, *gadgets.FAMILIES)
FLUSH = (furniture.flush_front.__name__,)
"""Doors and drawers that lie in one plane with their frame."""
_ASSEMBLY = {family.__name__: family for family in (*ASSEMBLIES, furniture.flush_front)}
FAMILIES = tuple(name for name in family_names() if name not in HELD_OUT)
SMALL_PARTED = ("Keyboard", "Remote", "Phone", "Switch", "Microwave", "WashingMachine",
                "CoffeeMachine", "Camera", "Printer", "Dispenser", "Lamp", "Safe")  # fmt: skip
"""Families with keys, knobs and buttons."""
DRAWERED = ("StorageFurniture", "StorageFurniture", "StorageFurniture", "Table", "Cart",
            "Refrigerator", "Dishwasher", "Printer", "TrashCan", "Composite")  # fmt: skip
"""Families with drawers, racks and trays within a body."""
SQUARE = (*4 * ("StorageFurniture",), *2 * ("Table",), *2 * ("cabinet",), "table", "appliance",
          "Cart", "Refrigerator", "Dishwasher", "Printer", "TrashCan", "Composite")  # fmt: skip
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
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0],
                     [0, 0, 1]])  # fmt: skip
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
