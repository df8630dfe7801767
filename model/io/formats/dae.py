"""COLLADA meshes, read through pycollada."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import InputFileError
from model.core.geometry import Material, affine
from model.core.packages import require
from model.io.formats.loaded import (
    DEFAULT_MAX_BYTES,
    Loaded,
    check_count,
    check_indices,
    join,
    read_bytes,
)

_WORLD_FROM_UP = {
    "X_UP": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    "Y_UP": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "Z_UP": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
}
_ABSURD = re.compile(rb"<(?:\w+:)?p\b[^<>]*>[^<]*?(?<![\w.])(-?\d{10,})(?![\w.])")
"""An index of a face that no file of a mesh has."""


def read_dae(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read the triangles of a COLLADA file's scene; metres, +z up by the file's own axis and unit.

    Of materials the diffuse colour is kept, textures are not.

    Raises:
        InputFileError: where it is no such file, damaged, or has no triangles.
        ConfigurationError: where pycollada isn't installed.
    """
    collada = require("collada", "artiworld[scans]")
    data = read_bytes(path, max_bytes)
    if b"<!DOCTYPE" in data[:4096] or b"<!ENTITY" in data:
        raise InputFileError(path, "declares XML entities, which are not read", "export it again")
    absurd = _ABSURD.search(data)
    if absurd is not None:  # pycollada would wrap it
        vertex = absurd[1][:40].decode()
        raise InputFileError(path, f"a face uses vertex {vertex}", "the file is damaged")
    pieces: list[tuple[str, Loaded]] = []
    textured, lines, values = False, 0, 0
    try:
        passed_over = [collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError]
        file = collada.Collada(io.BytesIO(data), ignore=passed_over)
        up = affine(_WORLD_FROM_UP[str(file.assetInfo.upaxis or "Y_UP")])
        up[:3, :3] *= float(file.assetInfo.unitmeter or 1.0)
        check_count(path, nodes=_count(file.scene, {}))
        for bound in file.scene.objects("geometry") if file.scene is not None else ():
            for primitive in bound.primitives():
                triangles = (
                    primitive.triangleset() if hasattr(primitive, "triangleset") else primitive
                )
                if isinstance(primitive, collada.lineset.BoundLineSet):
                    lines += 1
                    continue
                if getattr(triangles, "vertex_index", None) is None or triangles.vertex is None:
                    continue
                faces = np.asarray(triangles.vertex_index, np.int64).reshape(-1, 3)
                vertices = np.asarray(triangles.vertex, np.float64)
                check_indices(path, faces, len(vertices))
                values += faces.size + len(vertices)
                check_count(path, values=values)
                diffuse = getattr(getattr(primitive.material, "effect", None), "diffuse", None)
                textured |= diffuse is not None and not isinstance(diffuse, tuple)
                own = np.zeros(len(faces), np.int32)
                made = Loaded(vertices, faces, face_material=own, materials=(_material(diffuse),))
                name = str(getattr(bound.original, "name", "") or bound.original.id)
                pieces.append((name, made.moved(up)))
    except InputFileError:
        raise
    except Exception as error:  # pycollada raises many kinds for damaged files
        raise InputFileError(
            path, f"can't be read as COLLADA ({error})", "export it again"
        ) from None
    if not pieces:
        raise InputFileError(path, "has no triangles in its scene", "export the object again")
    whole = join([p for _, p in pieces])
    remarks = ["textures of COLLADA files are not read"] if textured else []
    if lines:
        remarks.append(f"{lines} pieces of lines are left out")
    if file.errors:
        remarks.append(f"not read: {len(file.errors)} elements, such as: {file.errors[0]}"[:150])
    if len(file.controllers):
        remarks.append(f"not read: {len(file.controllers)} skins and morphs")
    names = tuple((name, len(p.faces)) for name, p in pieces if len(p.faces))
    return replace(whole, pieces=names, warnings=(*whole.warnings, *remarks))


def _count(node: Any, known: dict[int, int]) -> int:
    """Nodes at and below one with those that instances repeat; ``known`` has those of others."""
    repeated = getattr(node, "node", node)
    if id(repeated) not in known:
        below = getattr(repeated, "children", getattr(repeated, "nodes", ()))
        known[id(repeated)] = 1 + sum(_count(child, known) for child in below)
    return known[id(repeated)]


def _material(diffuse: Any) -> Material:
    if not isinstance(diffuse, tuple) or len(diffuse) < 3:
        return Material()
    r, g, b = (int(np.clip(np.rint(255 * float(c)), 0, 255)) for c in diffuse[:3])
    return Material("dae", (r, g, b, 255))
