"""The :class:`Asset`: what a person opened, with where it came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Inertial
from model.core.errors import GeometryError
from model.core.geometry import Mesh, PointCloud
from model.core.shapes import Shape
from model.core.tree import KinematicTree

UpAxis = Literal["x", "y", "z", "-x", "-y", "-z"]
ElementKind = Literal["face", "point"]


MAX_PARTS = 1000
"""Parts of one object; part 0 is the base."""


@dataclass(frozen=True)
class Source:
    """Origin of an asset, and the changes made on reading.

    Attributes:
        path: the file or folder.
        sha256: of the file's bytes (of the sorted files' digests for a folder).
        up_axis: the source's up axis, turned to +z on reading.
        unit_scale: metres per source unit, applied on reading.
        shift: (x, y, z) metres taken off on reading, after turning and scaling. Zero but for
            surveyed scans that lie far from their origin, where float32 would be too coarse.
    """

    path: Path
    sha256: str
    up_axis: UpAxis = "z"
    unit_scale: float = 1.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Asset:
    """An object: a mesh with its textures, or a cloud. Metres, object frame, +z up.

    The *elements* are what labels belong to: faces where there is a mesh, else points.

    Attributes:
        name: short display name.
        mesh, cloud: exactly one leads; where both are given the mesh leads.
        source: None for an asset made in memory.
        element_part: (E,) int32 part of each element where the source was already cut into parts
            (a folder of part meshes), else None.
        part_names: names of those parts in order.
        tree: how those parts move where the source tells it: the joints of ``link_<part>`` and of
            helpers, else None.
        category: the object's category where the source tells it.
        inertials: mass properties of those links where the source tells them.
        shapes: collision shapes of those links where the source tells them.
        warnings: human-readable; content skipped on reading (a missing texture, NaN points).
    """

    name: str
    mesh: Mesh | None = None
    cloud: PointCloud | None = None
    source: Source | None = None
    element_part: npt.NDArray[np.int32] | None = None
    part_names: tuple[str, ...] = ()
    category: str | None = None
    warnings: tuple[str, ...] = ()
    tree: KinematicTree | None = None
    inertials: Mapping[str, Inertial] = field(default_factory=dict)
    shapes: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.mesh is None and self.cloud is None:
            raise GeometryError(f"{self.name}: an asset needs a mesh or a point cloud")
        if self.element_part is not None and len(self.element_part) != self.element_count:
            raise GeometryError(f"{self.name}: element_part must have one entry an element")

    @property
    def element_kind(self) -> ElementKind:
        """Kind of element that labels refer to."""
        return "face" if self.mesh is not None else "point"

    @property
    def element_count(self) -> int:
        """Number of faces, or of points where there is no mesh."""
        return len(self.mesh.faces) if self.mesh is not None else len(self.cloud)  # type: ignore[arg-type]

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) lowest and highest corner."""
        return (self.mesh if self.mesh is not None else self.cloud).bounds  # type: ignore[union-attr]

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal in metres."""
        low, high = self.bounds
        return float(np.linalg.norm(high - low))

    @property
    def element_centers(self) -> npt.NDArray[np.float64]:
        """(E, 3) face centroids or points."""
        if self.mesh is not None:
            return self.mesh.triangles.mean(axis=1)
        assert self.cloud is not None
        return self.cloud.points.astype(np.float64)
