"""Collision hulls as small OBJ files: the one mesh format that every target reads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from model.collision.build import Collision
from model.collision.hulls import Hull
from model.collision.shapes import Primitive, hull_of_shape
from model.exporters.saved import MESHES

FOLDER = f"{MESHES}/collision"


def write_collision(
    collision: Collision, stems: Mapping[str, str], folder: Path, *, capsules: bool = False
) -> dict[str, list[str | Primitive]]:
    """Write hulls into ``folder/meshes/collision``.

    Args:
        stems: link → name of its files.
        capsules: whether the format has them; else they are written as hulls.

    Returns:
        Link → file relative to ``folder``, in object-frame coordinates, or primitive.
    """
    out: dict[str, list[str | Primitive]] = {}
    for link, shapes in collision.items():
        held = out.setdefault(link, [])
        for i, shape in enumerate(shapes):
            if isinstance(shape, Primitive) and (capsules or shape.kind != "capsule"):
                held.append(shape)
                continue
            name = f"{FOLDER}/{stems[link]}_{i}.obj"
            (folder / FOLDER).mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(obj_text(hull_of_shape(shape)))
            held.append(name)
    return out


def obj_text(hull: Hull) -> str:
    """A hull as OBJ, nothing but corners and faces."""
    lines = ["# ArtiWorld collision hull, metres, +z up"]
    lines += ["v {:.9g} {:.9g} {:.9g}".format(*row) for row in (hull.vertices + 0.0).tolist()]
    lines += ["f {} {} {}".format(*row) for row in (hull.faces + 1).tolist()]
    return "\n".join([*lines, ""])
