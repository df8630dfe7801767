"""Collision hulls and meshes as small OBJ files: the one mesh format that every target reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from model.core.articulated_object import Part
from model.core.shapes import MOST_CORNERS, Hull, Primitive, Solid, hull_of_shape, simplified
from model.io.assets.reader import MESHES
from model.io.export.part_files import file_stems
from model.physics.collision.build import Collision

FOLDER = f"{MESHES}/collision"


def write_collision(
    collision: Collision, parts: Sequence[Part], folder: Path, *,
    capsules: bool = False, concave: bool = True,
) -> dict[str, list[str | Primitive]]:  # fmt: skip
    """Write hulls into ``folder/meshes/collision``.

    Args:
        parts: of the object; files of shapes are called after theirs.
        capsules: whether the format has them; else they are written as hulls.
        concave: whether the format may have meshes as they are; else they are written as hulls.
            Hulls have at most :data:`MOST_CORNERS` vertices, as PhysX wants them.

    Returns:
        Link → file relative to ``folder``, in object-frame coordinates, or primitive.
    """
    out: dict[str, list[str | Primitive]] = {}
    stems = file_stems(list(dict.fromkeys([*(p.link for p in parts), *collision])))
    for link, shapes in collision.items():
        held = out.setdefault(link, [])
        for i, shape in enumerate(shapes):
            if isinstance(shape, Primitive) and (capsules or shape.kind != "capsule"):
                held.append(shape)
                continue
            name = f"{FOLDER}/{stems[link]}_{i}.obj"
            (folder / FOLDER).mkdir(parents=True, exist_ok=True)
            body = (
                shape
                if isinstance(shape, Solid) and concave
                else (simplified(hull_of_shape(shape), MOST_CORNERS))
            )
            (folder / name).write_text(obj_text(body))
            held.append(name)
    return out


def obj_text(hull: Hull | Solid) -> str:
    """A hull or mesh as OBJ with vertices and faces only."""
    lines = ["# ArtiWorld collision hull, metres, +z up"]
    lines += ["v {:.9g} {:.9g} {:.9g}".format(*row) for row in (hull.vertices + 0.0).tolist()]
    lines += ["f {} {} {}".format(*row) for row in (hull.faces + 1).tolist()]
    return "\n".join([*lines, ""])
