"""Procedural rooms, scanned from within: which object each point belongs to.

Furniture stands along walls and in the middle with small objects on it; kitchens have runs of
cabinets under one worktop; doors and windows lie in the walls.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset
from model.core.geometry import Material, Mesh, PointCloud
from model.data.simulated.primitives import AXES, block, turned
from model.data.simulated.scans import HELD_OUT, LabelledCloud, family_shape
from model.geometry.casting import Caster
from model.geometry.crop import floor_and_walls, outliers

Array = npt.NDArray[np.float64]

AT_WALLS = (
    *"StorageFurniture StorageFurniture StorageFurniture Refrigerator Oven WashingMachine".split(),
    *"Dishwasher Safe Table Toilet TrashCan Composite".split(),
)
FREE = tuple("Table Table Chair Chair Chair FoldingChair Suitcase TrashCan Cart Fan Box".split())
IN_WALLS = ("Door", "Door", "Window")
ON_TOP = (
    *"Microwave CoffeeMachine Kettle KitchenPot Box Printer Display Toaster Bottle Lamp".split(),
    *"Bucket Laptop".split(),
)
NOTHING = 0
"""Label of floor and walls; objects count from 1."""

_STEP_BACK = 0.25
_FLUSH = -0.02
"""Negative gap in metres between neighbours in a run, against rounding."""


@dataclass
class _Plan:
    """A room that is being furnished: meshes, the object of each, and occupied floor."""

    rng: np.random.Generator
    width: float
    depth: float
    height: float
    meshes: list[Mesh] = field(default_factory=list)
    of_mesh: list[int] = field(default_factory=list)
    standing: list[tuple[Array, Array]] = field(default_factory=list)
    objects: int = 0

    def new(self) -> int:
        """The next object's label."""
        self.objects += 1
        return self.objects

    def add(self, mesh: Mesh, label: int) -> None:
        """Add a mesh at its place."""
        self.meshes.append(mesh)
        self.of_mesh.append(label)

    def blocked(self, low: Array, high: Array, margin: float = 0.05) -> bool:
        """True if an object stands between two corners (x, y) of the floor."""
        return any((low < h + margin).all() and (high > b - margin).all() for b, h in self.standing)

    def family(self, names: tuple[str, ...]) -> Mesh:
        """A random object of the families, standing on z = 0 about x = y = 0, front to -y."""
        name = str(self.rng.choice([n for n in names if n not in HELD_OUT]))
        mesh = family_shape(name, int(self.rng.integers(1 << 30))).mesh
        points = mesh.vertices * np.exp(self.rng.normal(0, 0.08, 3))
        low, high = points.min(0), points.max(0)
        return replace(mesh, vertices=points - [*(low + high)[:2] / 2, low[2]])


def _solid(low: npt.ArrayLike, high: npt.ArrayLike, color: Array) -> Mesh:
    corners = block(low, high).reshape(-1, 3)
    red, green, blue = np.clip(color, 0, 255).astype(int).tolist()
    return Mesh(
        corners,
        np.arange(len(corners), dtype=np.int32).reshape(-1, 3),
        np.zeros(len(corners) // 3, np.int32),
        (Material("painted", base_color=(red, green, blue, 255)),),
    )


def _moved(mesh: Mesh, quarters: int, offset: npt.ArrayLike) -> Mesh:
    """The mesh turned about +z by quarters, then shifted."""
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters % 4]
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]], float)
    return replace(mesh, vertices=mesh.vertices @ turn.T + np.asarray(offset, float))


@dataclass(frozen=True)
class _Wall:
    """One side of the room, from left to right as seen from inside.

    Attributes:
        quarters: of a turn that bring an object with its back at +y to this wall.
        length: metres.
    """

    quarters: int
    length: float
    room: _Plan

    def put(self, mesh: Mesh, along: float, off: float = 0.0, up: float = 0.0) -> Mesh:
        """The mesh with its back ``off`` the wall, its middle ``along`` it, ``up`` the floor."""
        half = np.ptp(mesh.vertices[:, 1]) / 2
        away = (self.room.depth if self.quarters % 2 == 0 else self.room.width) / 2
        local = np.array([along - self.length / 2, away - half - off, up])
        return _moved(replace(mesh, vertices=mesh.vertices + local), self.quarters, (0, 0, 0))

    def stand(self, mesh: Mesh, label: int, margin: float = 0.05) -> bool:
        """Add it if the floor is free, with a margin in metres."""
        low, high = mesh.vertices[:, :2].min(0), mesh.vertices[:, :2].max(0)
        if self.room.blocked(low, high, margin):
            return False
        self.room.standing.append((low, high))
        self.room.add(mesh, label)
        return True


def _shell(room: _Plan, walls: list[_Wall]) -> None:
    rng = room.rng
    paint, floor = rng.uniform(120, 240) + rng.normal(0, 12, 3), rng.uniform(50, 200, 3)
    x, y = room.width / 2 + 0.1, room.depth / 2 + 0.1
    room.add(_solid((-x, -y, -0.1), (x, y, 0), floor), NOTHING)
    for wall in walls:
        thick = _solid((-wall.length / 2, -0.05, 0), (wall.length / 2, 0.05, room.height), paint)
        room.add(wall.put(thick, wall.length / 2, off=-0.1), NOTHING)


def _run(wall: _Wall, start: float, end: float) -> None:
    """A run of kitchen cabinets and appliances with one front, under one worktop."""
    room, rng = wall.room, wall.room.rng
    deep, high = float(rng.uniform(0.5, 0.65)), float(rng.uniform(0.8, 0.9))
    together = room.new() if rng.random() < 0.6 else None
    placed: list[float] = []
    at = start
    while at < end - 0.3:
        kitchen = rng.random() < 0.2
        mesh = room.family(("Dishwasher", "Oven") if kitchen else ("StorageFurniture",))
        size = np.ptp(mesh.vertices, axis=0)
        wide = min(float(rng.uniform(0.35, 1.0)), end - at)
        mesh = replace(
            mesh, vertices=mesh.vertices * [wide / size[0], deep / size[1], high / size[2]]
        )
        label = together if together and not kitchen else room.new()
        if wall.stand(wall.put(mesh, at + wide / 2), label, margin=_FLUSH):
            placed += [at, at + wide]
        at += wide + float(rng.choice([0.0, 0.0, 0.004, 0.06]))
    if placed and rng.random() < 0.8:
        low, top = min(placed), high + float(rng.uniform(0.02, 0.05))
        width = max(placed) - low
        plate = _solid(
            (-width / 2, -deep / 2 - 0.02, 0),
            (width / 2, deep / 2, top - high),
            rng.uniform(40, 230, 3),
        )
        own = room.new() if rng.random() < 0.7 else (together or room.new())
        room.add(wall.put(plate, low + width / 2, up=high), own)
        for _ in range(int(rng.integers(0, 4))):
            thing = room.family(ON_TOP)
            if np.ptp(thing.vertices[:, 1]) < deep:
                room.add(wall.put(thing, rng.uniform(low, low + width), 0.03, top), room.new())
    if rng.random() < 0.5:
        label = room.new()
        for at in np.arange(start, end - 0.5, 0.6):
            mesh = room.family(("StorageFurniture",))
            size = np.ptp(mesh.vertices, axis=0)
            mesh = replace(mesh, vertices=mesh.vertices * (np.array([0.6, 0.35, 0.7]) / size))
            room.add(wall.put(mesh, at + 0.3, up=1.45), label)


def _furnish(wall: _Wall) -> None:
    room, rng = wall.room, wall.room.rng
    at = float(rng.uniform(0, 0.6))
    if rng.random() < 0.35:
        end = min(at + float(rng.uniform(1.2, 3.5)), wall.length)
        _run(wall, at, end)
        at = end + float(rng.choice([0.07, 0.4]))
    while at < wall.length - 0.4:
        if rng.random() < 0.3:
            mesh = room.family(IN_WALLS)
            # Some stand out, some are nearly flush with the wall.
            mesh = replace(mesh, vertices=mesh.vertices * [1, rng.choice([0.3, 0.6, 1.0]), 1])
            wide, tall = np.ptp(mesh.vertices, axis=0)[[0, 2]]
            up = 0.0 if tall > 1.8 else 0.9
            thick = float(np.ptp(mesh.vertices[:, 1]))
            out = float(rng.uniform(0.01, thick))
            placed = wall.put(mesh, at + wide / 2, off=out - thick, up=up)
            low, high = placed.vertices[:, :2].min(0), placed.vertices[:, :2].max(0)
            if at + wide < wall.length and not room.blocked(low, high):
                room.add(placed, room.new())
        else:
            mesh = room.family(AT_WALLS)
            wide, _, tall = np.ptp(mesh.vertices, axis=0)
            placed = wall.put(mesh, at + wide / 2, off=float(rng.choice([0.0, 0.03, 0.1])))
            if at + wide < wall.length and wall.stand(placed, room.new()) and tall < 1.3:
                _on_top(room, placed)
        at += wide + float(rng.choice([0.06, 0.08, 0.3, 0.9]))


def _on_top(room: _Plan, below: Mesh) -> None:
    low, high = below.vertices.min(0), below.vertices.max(0)
    for _ in range(int(room.rng.integers(0, 3))):
        thing = room.family(ON_TOP)
        slack = (high - low - np.ptp(thing.vertices, axis=0))[:2] / 2
        if (slack > 0).all():
            shift = (low + high)[:2] / 2 + room.rng.uniform(-slack, slack)
            room.add(_moved(thing, 0, (*shift, high[2])), room.new())


def _middle(room: _Plan) -> None:
    rng = room.rng
    for _ in range(int(rng.integers(1, 7))):
        mesh = _moved(room.family(FREE), int(rng.integers(4)), (0, 0, 0))
        half = np.ptp(mesh.vertices, axis=0)[:2] / 2
        reach = np.array([room.width, room.depth]) / 2 - half
        if (reach <= 0).any():
            continue
        spot = rng.uniform(-reach, reach)
        if not room.blocked(spot - half, spot + half):
            room.standing.append((spot - half, spot + half))
            placed = _moved(mesh, 0, (*spot, 0.0))
            room.add(placed, room.new())
            if np.ptp(mesh.vertices[:, 2]) < 1.0 and rng.random() < 0.4:
                _on_top(room, placed)


def _eyes(room: _Plan) -> Array:
    """(E, 3) positions of the scanner: over free floor, at the height of a person's hands."""
    rng = room.rng
    eyes: list[Array] = []
    for _ in range(200):
        reach = np.array([room.width, room.depth]) / 2 - _STEP_BACK
        spot = rng.uniform(-reach, reach)
        if not room.blocked(spot, spot, _STEP_BACK):
            eyes.append(np.array([*spot, rng.uniform(1.2, 1.9)]))
        if len(eyes) == 8:
            break
    return np.array(eyes or [[0.0, 0.0, 2.0]])


def furnished(seed: int) -> tuple[_Plan, Array]:
    """A room, and the positions (E, 3) it is scanned from."""
    rng = np.random.default_rng([seed, 5])
    room = _Plan(rng, *rng.uniform(2.8, 6.0, 2), height=float(rng.uniform(2.2, 2.6)))
    sides = [_Wall(k, room.depth if k % 2 else room.width, room) for k in range(4)]
    walls = [sides[k] for k in np.sort(rng.permutation(4)[: rng.integers(2, 5)])]
    _shell(room, walls)
    for wall in walls:
        _furnish(wall)
    _middle(room)
    return room, _eyes(room)


def scanned_room(seed: int, points: int = 90_000) -> LabelledCloud:
    """A room as fused depth images show it: hidden surfaces are missing, edges are rounded.

    Args:
        points: approximate number.
    """
    room, eyes = furnished(seed)
    rng = room.rng
    caster = Caster(room.meshes)
    direction = rng.standard_normal((len(eyes), 60_000, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    start = np.repeat(eyes, direction.shape[1], axis=0)
    hits = caster.cast(start, direction.reshape(-1, 3))
    label = np.array(room.of_mesh)[hits.part]
    inside = hits.points[:, 2] > -0.05
    keep = inside & (hits.distance < 5.0)
    for _ in range(int(rng.integers(0, 8))):  # where the scanner lost track
        spot = hits.points[rng.integers(len(hits.points))]
        keep &= np.linalg.norm(hits.points - spot, axis=1) > rng.uniform(0.05, 0.2)
    return _fused(
        hits.points[keep], hits.normals[keep], hits.colors[keep], label[keep], points, rng
    )


def cropped_room(data: LabelledCloud) -> LabelledCloud:
    """A room without floor, walls and outliers, as the app shows it for picking objects."""
    asset = Asset("room", cloud=data.cloud)
    kept = np.flatnonzero(~outliers(asset))
    kept = kept[~floor_and_walls(Asset("room", cloud=data.cloud.take(kept)))]
    return LabelledCloud(data.cloud.take(kept), data.labels[kept], data.family)


def _fused(
    points: Array,
    normals: Array,
    colors: npt.NDArray[np.uint8],
    label: npt.NDArray[np.integer],
    wanted: int,
    rng: np.random.Generator,
) -> LabelledCloud:
    """One point per voxel, shifted by a smooth error and noise, and turned."""
    size = float(np.sqrt(len(np.unique(np.floor(points / 0.02), axis=0)) / wanted)) * 0.02
    voxel = np.floor(points / max(size, 0.012)).astype(np.int64)
    _, first, back = np.unique(voxel, axis=0, return_index=True, return_inverse=True)
    back = back.ravel()
    held = np.bincount(back)
    mean = np.stack([np.bincount(back, v) for v in points.T], axis=1) / held[:, None]
    color = np.stack([np.bincount(back, v) for v in colors.T.astype(float)], axis=1)
    color /= held[:, None]
    # Images from many places blur into each other.
    patch = np.floor(mean / rng.uniform(0.03, 0.09)).astype(np.int64)
    _, of_patch = np.unique(patch, axis=0, return_inverse=True)
    of_patch = of_patch.ravel()
    wide = np.stack([np.bincount(of_patch, v) for v in color.T], axis=1)
    wide /= np.bincount(of_patch)[:, None]
    blur = rng.uniform(0, 0.8)
    color = (1 - blur) * color + blur * wide[of_patch]
    wave = rng.normal(0, rng.uniform(3, 12), (3, 3))
    swing = np.sin(mean @ wave + rng.uniform(0, 6, 3))
    off = rng.uniform(0, 0.008) * swing.mean(1) + rng.normal(0, rng.uniform(0, 0.005), len(mean))
    light = 1 - rng.choice([0.1, 0.3, 0.5]) * (0.5 - 0.5 * normals[first] @ [0.3, 0.3, 0.9])
    color = color * light[:, None] + rng.normal(0, rng.choice([3, 8, 15]), color.shape)
    angle = rng.choice([0.0, rng.uniform(0, 2 * np.pi)])
    moved = turned(mean + off[:, None] * normals[first], AXES["z"], angle, (0.0, 0.0, 0.0))
    painted = np.clip(color, 0, 255).astype(np.uint8)
    cloud = PointCloud(moved.astype(np.float32), colors=painted)
    return LabelledCloud(cloud, label[first].astype(np.int16), "room")
