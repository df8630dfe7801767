"""Plausible mass and inertia, which every simulator accepts, from an editable table of materials.

A closed shell of the mesh is solid, or hollow with the wall thickness of its material, whichever is
lighter: a board is solid, a refrigerator is not. Open surfaces and scans are hollow. A part without
surface area is replaced by its convex hull. The values are always valid (positive definite, within
the triangle inequality); the real ones need a balance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Inertial, Part, inertial_problems
from model.core.errors import ConfigurationError, InputFileError
from model.core.files import read_json, static_assets
from model.core.geometry import Mesh
from model.geometry.topology import connected_shells, weld
from model.physics.part_mesh import part_mesh

FORMAT = 1


@dataclass(frozen=True)
class PartMaterial:
    """The material of a part.

    Attributes:
        density: kg/m³.
        thickness: metres, of the walls of hollow parts.
    """

    density: float
    thickness: float


@dataclass(frozen=True)
class MaterialTable:
    """Materials by name, and the material of part names and categories.

    The words of a part's name count first, then the object's category, then ``default``.
    """

    materials: Mapping[str, PartMaterial]
    categories: Mapping[str, str]
    parts: Mapping[str, str]
    default: str

    def of(self, part: Part, category: str | None) -> PartMaterial:
        """Return the material of a part."""
        return self.materials[self.name_of(part, category)]

    def name_of(self, part: Part, category: str | None) -> str:
        """Return the name of a part's material, such as "wood"."""
        words = (part.name or "").lower().replace("_", " ").split()
        named = next((self.parts[w] for w in words if w in self.parts), None)
        known = {k.lower(): v for k, v in self.categories.items()}
        return named or known.get((category or "").lower(), self.default)

    def with_density(self, density: float) -> MaterialTable:
        """Replace the density of all materials, kg/m³."""
        made = {k: replace(m, density=density) for k, m in self.materials.items()}
        return replace(self, materials=made)

    def only(self, material: str) -> MaterialTable:
        """Use one material for everything.

        Raises:
            ConfigurationError: for an unknown material.
        """
        if material not in self.materials:
            known = ", ".join(self.materials)
            raise ConfigurationError(f"no material {material!r}; known are {known}")
        return replace(self, categories={}, parts={}, default=material)


def read_materials(path: str | Path | None = None) -> MaterialTable:
    """Read the bundled table, or one of the same format.

    Raises:
        InputFileError: naming the problem in the file.
    """
    path = static_assets() / "physics" / "materials.json" if path is None else Path(path)
    data = read_json(path)
    try:
        table = _table(data)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputFileError(
            path,
            f"is no table of materials ({error})",
            "it needs materials with density and thickness above 0, categories, parts and default",
        ) from error
    used = {table.default, *table.categories.values(), *table.parts.values()}
    unknown = sorted(used - set(table.materials))
    if unknown:
        raise InputFileError(path, f"uses undefined materials: {', '.join(unknown)}")
    return table


def _table(data: Any) -> MaterialTable:
    if data.get("format", FORMAT) > FORMAT:
        raise ValueError(f"format {data['format']} is newer than {FORMAT}")
    materials = {
        str(name): PartMaterial(float(entry["density"]), float(entry["thickness"]))
        for name, entry in data["materials"].items()
    }
    for name, made in materials.items():
        if not (0 < made.density < float("inf") and 0 < made.thickness < float("inf")):
            raise ValueError(f"{name}: density and thickness must be above 0")
    return MaterialTable(
        materials,
        dict(data.get("categories", {})),
        dict(data.get("parts", {})),
        str(data["default"]),
    )


DENSITY = 300.0
"""kg/m³ of a solid convex hull: between hollow furniture and wood, a choice."""
MIN_MASS = 1e-3
"""kg: lighter links destabilise solvers."""
MIN_RADIUS = 1e-3
"""Metres: no inertia is below that of a ball of this radius and the same mass."""
SHEET = 0.005
"""Volume over area times wall below which a closed shell is a sheet with two sides."""
HELPER = Inertial(1e-2, np.zeros(3), np.eye(3) * 1e-5)
"""For moving links without geometry: simulators need mass there."""

FloatArray = npt.NDArray[np.float64]


_KNOWN: WeakKeyDictionary[Part, dict[PartMaterial | None, Inertial]] = WeakKeyDictionary()


def inertials_of(
    obj: ArticulatedObject,
    *,
    material_of: Callable[[Part], PartMaterial] | None = None,
    declared: bool = True,
) -> dict[str, Inertial]:
    """Return link → mass properties, but for a root without geometry, which stands still.

    Args:
        material_of: material of a part; mass comes from volume and surface then, else from
            the solid hull.
        declared: whether ``obj.inertials``, which the source declares, are used as they are.
    """
    parts = {p.link: p for p in obj.parts}
    out: dict[str, Inertial] = {}
    for link in obj.tree.links:
        if declared and link in obj.inertials:
            out[link] = obj.inertials[link]
            continue
        part = parts.get(link)
        points = np.zeros((0, 3)) if part is None else part_points(part)
        if part is not None and len(points):
            material = None if material_of is None else material_of(part)
            known = _KNOWN.setdefault(part, {})
            if material not in known:
                made = None if material is None else _of_material(part, points, material)
                known[material] = made or hull_inertial(points)
            out[link] = known[material]
        elif link != obj.tree.root:
            center = np.asarray(obj.tree.joint_of[link].origin, dtype=np.float64)
            out[link] = Inertial(HELPER.mass, center, HELPER.tensor)
    return out


def _of_material(part: Part, points: FloatArray, material: PartMaterial) -> Inertial | None:
    """Mass properties from the part's surface; None where it has no area or no mass."""
    mesh = part_mesh(part)
    area = float(mesh.face_areas.sum())
    if not area > 0:
        return None
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    corners = mesh.triangles - middle
    mass, first, second = _moments(mesh, corners, material)
    hull = _hull(points)
    most = mass if hull is None else material.density * hull[0]
    if not mass > 0:
        return None
    if mass > most:  # a wall thicker than the part itself
        first, second, mass = first * (most / mass), second * (most / mass), most
    scale = max(mass, MIN_MASS) / mass
    mass, first, second = mass * scale, first * scale, second * scale
    center = first / mass
    spread = second - mass * np.outer(center, center)
    tensor = np.trace(spread) * np.eye(3) - spread
    tensor = (tensor + tensor.T) / 2 + np.eye(3) * 0.4 * mass * MIN_RADIUS**2
    found = Inertial(mass, center + middle, tensor)
    return None if inertial_problems({"": found}) else found


def _moments(
    mesh: Mesh, corners: FloatArray, material: PartMaterial
) -> tuple[float, FloatArray, FloatArray]:
    """Mass, its first moment (3,) and second moment (3, 3) about the corners' origin."""
    ids = weld(mesh)
    shell = connected_shells(mesh, ids)
    sums = corners.sum(axis=1)
    products = np.einsum("fi,fj->fij", sums, sums) + np.einsum("fci,fcj->fij", corners, corners)
    volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    volume, area = np.bincount(shell, volumes), np.bincount(shell, mesh.face_areas)
    wall = material.thickness
    closed = _closed(ids[mesh.faces], shell)
    sheet = closed & (np.abs(volume) < SHEET * area * wall)
    filled = closed & ~sheet & (np.abs(volume) < area * wall)
    # Each face adds its tetrahedron to the origin, or its piece of wall.
    solid = volumes * np.sign(volume)[shell] * filled[shell]
    walls = mesh.face_areas * wall * np.where(sheet, 0.5, 1.0)[shell] * ~filled[shell]
    weight = solid + walls
    first = (solid / 4 + walls / 3) @ sums
    second = np.einsum("f,fij->ij", solid / 20 + walls / 12, products)
    return (
        material.density * float(weight.sum()),
        material.density * first,
        material.density * second,
    )


def _closed(corners: npt.NDArray[np.int32], shell: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_]:
    """(S,) whether each shell is closed and oriented: as many half-edges run each way."""
    tail, head = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    low, high = np.minimum(tail, head).astype(np.int64), np.maximum(tail, head).astype(np.int64)
    _, edge = np.unique(low * (int(corners.max()) + 1) + high, return_inverse=True)
    balance = np.bincount(edge, np.where(tail < head, 1.0, -1.0) * (tail != head))
    out = np.ones(int(shell.max()) + 1, bool)
    out[np.repeat(shell, 3)[balance[edge] != 0]] = False
    return out


def part_points(part: Part) -> FloatArray:
    """(N, 3) vertices that faces use, or points; empty for empty geometry."""
    if part.mesh is not None and len(part.mesh.faces):
        return part.mesh.vertices[np.unique(part.mesh.faces)]
    if part.cloud is not None:
        return part.cloud.points.astype(np.float64)
    return np.zeros((0, 3))


def hull_inertial(points: npt.ArrayLike, density: float = DENSITY) -> Inertial:
    """Mass properties of the solid convex hull of (N, 3) points, or of their box if flat.

    Args:
        points: metres; at least one.
        density: kg/m³.
    """
    at = np.asarray(points, dtype=np.float64)
    found = _hull(at)
    volume, center, tensor = found if found is not None else _thick_box(at)
    mass = max(density * volume, MIN_MASS)
    tensor = tensor * (mass / volume)
    # A small ball at the centre of mass keeps the inertia of slivers plausible.
    tensor = tensor + np.eye(3) * 0.4 * mass * MIN_RADIUS**2
    return Inertial(mass, center, (tensor + tensor.T) / 2)


def _hull(points: FloatArray) -> tuple[float, FloatArray, FloatArray] | None:
    """Volume, centre (3,) and inertia (3, 3) at unit density about it; None where it is flat."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 4:
        return None
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    scale = float(np.abs(points - middle).max())
    if scale <= 0:
        return None
    try:
        hull = ConvexHull((points - middle) / scale)
    except QhullError:
        return None
    inside = hull.points[hull.vertices].mean(axis=0)
    corners = hull.points[hull.simplices] - inside
    # From a point inside, all tetrahedra are positive.
    cross = np.cross(corners[:, 1], corners[:, 2])
    volumes = np.abs(np.einsum("fi,fi->f", corners[:, 0], cross)) / 6
    volume = float(volumes.sum())
    if volume < 1e-6:
        return None
    center = np.einsum("f,fi->i", volumes, corners.sum(axis=1) / 4) / volume
    # Second moments of a tetrahedron with one corner at 0 (Tonon, 2004).
    sums = corners.sum(axis=1)
    moments = np.einsum("f,fi,fj->ij", volumes, sums, sums) / 20
    moments += np.einsum("f,fci,fcj->ij", volumes, corners, corners) / 20
    moments -= volume * np.outer(center, center)
    tensor = np.trace(moments) * np.eye(3) - moments
    return volume * scale**3, (center + inside) * scale + middle, tensor * scale**5


def _thick_box(points: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """As :func:`_hull`, of the principal box with a minimal thickness."""
    mean = points.mean(axis=0)
    axes = np.linalg.svd(points - mean, full_matrices=True)[2] if len(points) > 1 else np.eye(3)
    local = (points - mean) @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    size = np.maximum(high - low, max(0.01 * float((high - low).max()), 2 * MIN_RADIUS))
    volume = float(np.prod(size))
    squares = size**2
    diagonal = volume * (squares.sum() - squares) / 12
    return volume, mean + axes.T @ ((low + high) / 2), axes.T @ np.diag(diagonal) @ axes
