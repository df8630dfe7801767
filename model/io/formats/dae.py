"""COLLADA meshes, read through pycollada."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from model.core.errors import InputFileError
from model.core.geometry import Material, affine
from model.core.packages import require
from model.io.formats.loaded import (
    DEFAULT_MAX_BYTES,
    WHITE,
    WORLD_FROM_UP,
    Loaded,
    along_seams,
    check_count,
    check_indices,
    join,
    read_bytes,
    unpictured,
)
from model.io.formats.mtl import MaterialFiles

_ABSURD = re.compile(rb"<(?:\w+:)?p\b[^<>]*>[^<]*?(?<![\w.])(-?\d{10,})(?![\w.])")
"""An index of a face that no file of a mesh has."""


def read_dae(
    path: Path, max_bytes: int = DEFAULT_MAX_BYTES, *, files: MaterialFiles | None = None
) -> Loaded:
    """Read the triangles of a COLLADA file's scene; metres, +z up by the file's own axis and unit.

    Of materials the diffuse colour or its texture is kept.

    Args:
        path: the file.
        max_bytes: refuse larger files.
        files: reads the textures; without it they lie in the file's folder.

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
    warnings, lines, values = list[str](), 0, 0
    files = files or MaterialFiles(path.parent)
    try:
        passed_over = [collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError]
        file = collada.Collada(io.BytesIO(data), ignore=passed_over)
        up = affine(WORLD_FROM_UP[str(file.assetInfo.upaxis or "Y_UP")[0].lower()])
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
                values += triangles.vertex_index.size + len(triangles.vertex)
                check_count(path, values=values)
                made = _dressed(path, triangles, files, warnings)
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
    if lines:
        warnings.append(f"{lines} pieces of lines are left out")
    if file.errors:
        warnings.append(f"ignored: {len(file.errors)} elements, such as: {file.errors[0]}"[:150])
    if len(file.controllers):
        warnings.append(f"ignored: {len(file.controllers)} skins and morphs")
    names = tuple((name, len(p.faces)) for name, p in pieces if len(p.faces))
    return replace(whole, pieces=names, warnings=tuple(dict.fromkeys([*whole.warnings, *warnings])))


def _count(node: Any, known: dict[int, int]) -> int:
    """Nodes at and below one with those that instances repeat; ``known`` has those of others."""
    repeated = getattr(node, "node", node)
    if id(repeated) not in known:
        below = getattr(repeated, "children", getattr(repeated, "nodes", ()))
        known[id(repeated)] = 1 + sum(_count(child, known) for child in below)
    return known[id(repeated)]


def _dressed(path: Path, triangles: Any, files: MaterialFiles, warnings: list[str]) -> Loaded:
    """Triangles in the file's axes with their colour or texture."""
    faces = np.asarray(triangles.vertex_index, np.int64).reshape(-1, 3)
    points, uv = np.asarray(triangles.vertex, np.float64), []
    check_indices(path, faces, len(points))
    diffuse: Any = getattr(getattr(triangles.material, "effect", None), "diffuse", None)
    material = Material()
    if isinstance(diffuse, tuple):
        r, g, b = (int(np.clip(np.rint(255 * float(c)), 0, 255)) for c in diffuse[:3])
        material = Material("dae", (r, g, b, 255))
    elif hasattr(diffuse, "sampler"):
        texture = files.texture(unquote(diffuse.sampler.surface.image.path), path, warnings)
        material = material if texture is None else Material("dae", WHITE, texture)
        _, named = (triangles.inputmap or {}).get(diffuse.texcoord, ("", None))
        sets = [said[3] for said in triangles.original.sources.get("TEXCOORD", ())]
        at = sets.index(named) if named in sets else 0
        if material.texture is not None and sets:
            at_corners = triangles.texcoord_indexset[at]
            uv = [np.asarray(triangles.texcoordset[at], np.float64)[at_corners][..., :2]]
        elif material.texture is not None:
            warnings.append("coordinates of the texture of a piece are missing")
            material = unpictured(material)
    points, faces, uv = along_seams(points, faces, uv)
    return Loaded(
        points,
        faces,
        uv=uv[0].astype(np.float32) if uv else None,
        face_material=np.zeros(len(faces), np.int32),
        materials=(material,),
    )
