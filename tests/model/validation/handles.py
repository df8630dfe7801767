"""Bar handles for the cabinet of :mod:`tests.model.validation.cabinets`."""

from dataclasses import replace

import numpy as np
import trimesh

from model.core.articulated_object import ArticulatedObject
from model.core.geometry import Mesh
from tests.builders import box
from tests.model.validation.cabinets import W

FRONT = -W - 0.002
"""Where the fronts end along y."""


def bar(x: float, low: float, high: float):
    """A bar 12 mm thick, 4 cm before the front, upright, on two posts."""
    y0, y1, r = FRONT - 0.052, FRONT - 0.04, 0.006
    posts = [box([x - r, y1, z - r], [x + r, FRONT, z + r]) for z in (low + r, high - r)]
    return [box([x - r, y0, low], [x + r, y1, high]), *posts]


def with_handles(obj: ArticulatedObject) -> ArticulatedObject:
    """The cabinet with a bar on its door and one on its drawer."""

    added = {"link_1": bar(-0.04, 0.2, 0.4), "link_2": bar(0.2, 0.1, 0.22)}
    parts = []
    for part in obj.parts:
        pieces = [trimesh.Trimesh(part.mesh.vertices, part.mesh.faces, process=False)]
        whole = trimesh.util.concatenate([*pieces, *added.get(part.link, [])])
        mesh = Mesh(np.asarray(whole.vertices), np.asarray(whole.faces))
        parts.append(replace(part, mesh=mesh))
    return replace(obj, parts=tuple(parts))
