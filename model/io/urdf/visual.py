"""One piece of a link's geometry as a URDF or MJCF declares it, before its mesh is loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.mesh import Material, Mesh


@dataclass(frozen=True, eq=False)
class UrdfVisual:
    """One piece of a link's geometry.

    Attributes:
        link: the link that carries it.
        name: the element's ``name``, or None.
        object_from_geometry: (4, 4) from the file's coordinates to the object frame at rest,
            scale included.
        file: the mesh file, resolved; None for a primitive, and for ``mesh``.
        primitive: ``("box", (x, y, z))``, ``("cylinder", (radius, length))``, ``("sphere",
            (radius,))`` or ``("capsule", (radius, length without the caps))`` in metres; None for
            a file.
        color: RGBA in 0..255 from the URDF's material, or None. It is for what has no looks.
        mesh: geometry that no file holds, or None.
        material: takes the place of what a mesh file says of its looks, or None.
    """

    link: str
    name: str | None
    object_from_geometry: npt.NDArray[np.float64]
    file: Path | None = None
    primitive: tuple[str, tuple[float, ...]] | None = None
    color: tuple[int, int, int, int] | None = None
    mesh: Mesh | None = None
    material: Material | None = None
