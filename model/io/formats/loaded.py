"""The result of a format's reader, how several are joined, polygons as triangles, and files that a
file names.

Files that a file names may not leave its folder.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

import mapbox_earcut
import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.core.geometry import Material
from model.core.textures import SurfaceMaps
from model.geometry.topology import same_points

DEFAULT_MAX_BYTES = 4 << 30
MOST_NODES, MOST_VALUES = 200_000, 60_000_000
"""Nodes (of USD: prims) of a file, and corners and points of its meshes, with all repetitions."""
WHITE = (255, 255, 255, 255)
GREY = (200, 200, 200, 255)
WORLD_FROM_UP: dict[str, list[list[int]]] = {
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "x": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "-x": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
}
DARK = "intensities are left out"
"""Remark on clouds that have them."""

Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Loaded:
    """The content of one file in the file's own frame and unit, not yet cleaned.

    Attributes:
        vertices: (V, 3) float32 or float64; NaN is possible.
        faces: (F, 3) integer; indices are within 0..V-1.
        normals: (V, 3) or None. Kept for clouds only.
        colors: (V, 4) uint8 RGBA, sRGB, or None.
        uv: (V, 2), v up, or None.
        face_material: (F,) indices into ``materials``.
        materials: empty stands for one plain material.
        warnings: human-readable remarks on skipped content.
        pieces: where the file is in pieces that have names, each one's name and number of faces,
            in the faces' order; else empty.
        names_join: whether pieces of the same name are one.
        confidence: (V,) of a cloud's points where the file has it, or None.
        polygon: (F,) face of the file that each triangle is a piece of, or None.
        polygons: number of the file's faces.
    """

    vertices: Array
    faces: Array = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    normals: Array | None = None
    colors: Array | None = None
    uv: Array | None = None
    face_material: Array = field(default_factory=lambda: np.zeros(0, np.int32))
    materials: tuple[Material, ...] = ()
    warnings: tuple[str, ...] = ()
    pieces: tuple[tuple[str, int], ...] = ()
    names_join: bool = False
    confidence: Array | None = None
    polygon: Array | None = None
    polygons: int = 0

    def moved(self, matrix: Array) -> Loaded:
        """Under the (4, 4) affine ``matrix``; faces are turned where it mirrors."""
        rotation = matrix[:3, :3]
        vertices = self.vertices @ rotation.T.astype(self.vertices.dtype, copy=False)
        vertices = vertices + matrix[:3, 3].astype(self.vertices.dtype)
        normals = self.normals
        determinant = np.linalg.det(rotation)
        if normals is not None and determinant != 0:
            normals = normals @ np.linalg.inv(rotation).astype(normals.dtype)
        faces = self.faces[:, ::-1] if determinant < 0 else self.faces
        return replace(self, vertices=vertices, normals=normals, faces=faces)


def join(pieces: Sequence[Loaded]) -> Loaded:
    """All ``pieces`` as one, in order; materials that are the same object are shared.

    Pieces with faces win: vertices of pieces without faces are kept but no face uses them.
    """
    if len(pieces) == 1:
        return pieces[0]
    offsets = np.cumsum([0] + [len(p.vertices) for p in pieces])
    materials: list[Material] = []
    index_of: dict[int, int] = {}
    face_material = []
    for p in pieces:
        own = p.materials or (Material(),)
        table = []
        for material in own:
            if id(material) not in index_of:
                index_of[id(material)] = len(materials)
                materials.append(material)
            table.append(index_of[id(material)])
        local = p.face_material if len(p.face_material) else np.zeros(len(p.faces), np.int32)
        face_material.append(np.asarray(table, np.int32)[local])
    return Loaded(
        np.concatenate([p.vertices for p in pieces]),
        np.concatenate([p.faces + o for p, o in zip(pieces, offsets[:-1], strict=True)]),
        _together(pieces, "normals", None, 3),
        _colors_together(pieces),
        _together(pieces, "uv", (0.0, 0.0), 2),
        np.concatenate(face_material),
        tuple(materials),
        tuple(dict.fromkeys(w for p in pieces for w in p.warnings)),
    )


def _together(
    pieces: Sequence[Loaded], name: str, missing: tuple[float, ...] | None, columns: int
) -> Array | None:
    """The attribute of all pieces; ``missing`` fills in for those without (None: drop all)."""
    values = [getattr(p, name) for p in pieces]
    have = [v for v in values if v is not None]
    if not have or (missing is None and len(have) < len(values)):
        return None
    return np.concatenate(
        [
            np.full((len(p.vertices), columns), missing, have[0].dtype) if v is None else v
            for p, v in zip(pieces, values, strict=True)
        ]
    )


def _colors_together(pieces: Sequence[Loaded]) -> Array | None:
    """Colours of all pieces; those without take their base colours, which colours replace."""
    if all(p.colors is None for p in pieces):
        return None
    return np.concatenate([p.colors if p.colors is not None else _base_colors(p) for p in pieces])


def _base_colors(piece: Loaded) -> Array:
    out = np.full((len(piece.vertices), 4), GREY, np.uint8)
    if len(piece.faces) and piece.materials:
        base = np.array([m.base_color for m in piece.materials], np.uint8)
        out[piece.faces.reshape(-1)] = np.repeat(base[piece.face_material], 3, axis=0)
    return out


def with_plain_colors(loaded: Loaded) -> Loaded:
    """Multiply vertex colours by the base colours of their materials.

    :class:`~model.core.geometry.Mesh` lets vertex colours replace the base colour, so vertices
    that had none take the base colour of their material.
    """
    if loaded.colors is None or not len(loaded.faces) or not loaded.materials:
        return loaded
    base = np.array([m.base_color for m in loaded.materials], np.float64)
    if (base == 255).all():
        return loaded
    factor = np.full((len(loaded.vertices), 4), 255.0)
    factor[loaded.faces.reshape(-1)] = np.repeat(base[loaded.face_material], 3, axis=0)
    colors = np.rint(loaded.colors * (factor / 255.0)).astype(np.uint8)
    materials = tuple(replace(m, base_color=WHITE) for m in loaded.materials)
    return replace(loaded, colors=colors, materials=materials)


def along_seams(
    points: Array, faces: Array, values: list[Array]
) -> tuple[Array, Array, list[Array]]:
    """Points doubled where (T, 3, K) ``values`` at the corners of (T, 3) ``faces`` differ, their
    faces, and the values of each point."""
    if not values:
        return points, faces, []
    flat, rows = faces.reshape(-1), [v.reshape(-1, v.shape[2]) for v in values]
    first, inverse = same_points(np.column_stack([flat, *rows]))
    return points[flat[first]], inverse.reshape(-1, 3), [v[first] for v in rows]


def unpictured(material: Material) -> Material:
    """``material`` without images, in the mean colour of its texture."""
    color = np.asarray(material.base_color, np.float64)
    if material.texture is not None:
        small = material.texture.convert("RGB").resize((1, 1), resample=4)  # a box: the mean
        color[:3] *= np.asarray(small, np.float64).reshape(3) / 255
    r, g, b, a = np.rint(color).astype(int).tolist()
    plain = SurfaceMaps(emission=material.maps.emission)
    return replace(material, base_color=(r, g, b, a), texture=None, maps=plain)


def size_of(path: Path, most: float = np.inf) -> int:
    """Bytes of a regular file that holds some.

    Raises:
        InputFileError: where it is missing, empty, a pipe or a device, or has more than ``most``.
    """
    try:
        info = path.stat()
    except (OSError, ValueError) as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise InputFileError(path, reason, "check the path") from None
    if stat.S_ISDIR(info.st_mode):
        raise InputFileError(path, "is a folder", "name a file")
    if not stat.S_ISREG(info.st_mode):
        raise InputFileError(path, "is not a regular file", "give a mesh or point cloud file")
    if info.st_size == 0:
        raise InputFileError(path, "the file is empty", "export or download it again")
    if info.st_size > most:
        what = f"{info.st_size / 2**30:.1f} GiB is over the limit of {most / 2**30:.1f} GiB"
        raise InputFileError(path, what, "thin or cut it first")
    return info.st_size


def check_count(path: Path, *, nodes: int = 0, values: int = 0) -> None:
    """Refuse a file for what it would give: nodes, or corners and points, with all repetitions.

    Raises:
        InputFileError: above :data:`MOST_NODES` or :data:`MOST_VALUES`.
    """
    if nodes > MOST_NODES or values > MOST_VALUES:
        most = f"{MOST_NODES:,} nodes" if nodes else f"{MOST_VALUES:,} corners and points"
        what = f"has more than {most}, with those that it repeats"
        raise InputFileError(path, what, "cut it, or join its meshes")


def read_bytes(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> bytes:
    """The content of a regular file; errors as of :func:`open_file`."""
    with open_file(path, max_bytes) as file:
        return file.read()


def open_file(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> BinaryIO:
    """Open a regular file for reading.

    Raises:
        InputFileError: where it is missing, empty, too large, a pipe or a device, or unreadable.
    """
    size_of(path, max_bytes)
    try:
        return path.open("rb")
    except OSError as error:
        raise InputFileError(
            path, f"can't be read: {error.strerror}", "check permissions"
        ) from None


def colors_from(values: Array) -> npt.NDArray[np.uint8]:
    """RGB or RGBA values of any type as (N, 4) uint8: 0..1 floats and 16-bit are scaled."""
    if values.dtype == np.uint8:
        out = values
    elif values.dtype == np.uint16 and len(values) and values.max() > 255:
        out = (values >> 8).astype(np.uint8)
    else:
        v = np.nan_to_num(values.astype(np.float64), nan=200.0, posinf=255.0, neginf=0.0)
        if np.issubdtype(values.dtype, np.floating) and len(v) and v.max() <= 1.0:
            v = v * 255.0
        out = np.clip(np.rint(v), 0, 255).astype(np.uint8)
    if out.shape[1] == 3:
        out = np.column_stack([out, np.full(len(out), 255, np.uint8)])
    return out


def check_indices(
    path: Path,
    faces: Array,
    count: int,
    *,
    sizes: Array | None = None,
    written: Array | None = None,
    what: str = "vertex",
) -> None:
    """Raise where ``faces`` index a vertex, or ``what`` else, that isn't there.

    Args:
        faces: (F, 3) numbers from 0; or (C,) of all corners, with their ``sizes``. Floats as text
            files have them: what is no integer of 64 bits is refused as it is.
        sizes: (F,) corners of each face.
        written: (C,) what the file says for each corner; by default ``faces``.

    Raises:
        InputFileError: with the first bad corner, as the file has it.
    """
    flat = faces.reshape(-1)
    bad = ~((flat >= 0) & (flat < count))  # NaN, too
    if not bad.any():
        return
    at = int(bad.argmax())
    ends = np.arange(len(faces)) * 3 + 3 if sizes is None else np.cumsum(sizes)
    face = int(np.searchsorted(ends, at, side="right"))
    value = (flat if written is None else written)[at]
    shown = f"{int(value)}" if abs(value) < 2**63 else f"{value:g}"
    what = f"face {face} uses {what} {shown} of {count}"
    raise InputFileError(path, what, "the file is damaged; export it again")


def numbers(path: Path, text: str, what: str) -> npt.NDArray[np.float64]:
    """All numbers of ``text`` (white space between them).

    Raises:
        InputFileError: where something in it is no number.
    """
    try:
        return np.array(text.split(), dtype=np.float64)
    except ValueError:
        bad = next((t for t in text.split() if not _is_number(t)), text[:20])
        raise InputFileError(
            path, f"{what}: {bad[:40]!r} is not a number", "the file is damaged"
        ) from None


def _is_number(token: str) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True


_DRIVE = re.compile(r"^[A-Za-z]:")
_SCHEME = re.compile(r"^[A-Za-z][A-Za-z0-9+.-]*:")


class ReferenceRefused(ValueError):
    """A reference that leaves its folder. The message says which and why."""


def resolve(reference: str, folder: Path, root: Path) -> Path:
    """The file that ``reference`` names, seen from ``folder``, inside ``root``.

    Symbolic links are followed first, so that one can't lead outside.

    Raises:
        ReferenceRefused: for absolute paths, addresses, and whatever ends outside ``root``.
    """
    text = reference.strip().strip('"').replace("\\", "/")
    shown = repr(reference[:120])
    if not text or "\0" in text:
        raise ReferenceRefused(f"{shown} is no file name")
    if text.startswith(("/", "~")) or _DRIVE.match(text):
        raise ReferenceRefused(f"{shown} is an absolute path; only files of the folder are read")
    if _SCHEME.match(text):
        raise ReferenceRefused(f"{shown} is an address; only files of the folder are read")
    try:
        target = (folder / text).resolve()
        within = root.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise ReferenceRefused(f"{shown} can't be followed: {error}") from None
    if not target.is_relative_to(within):
        both = Path(os.path.commonpath([within, target])).name
        hint = f"; give the folder {both!r}, which would hold both" if both else ""
        outside = f"{shown} leads outside the folder {within.name or str(root)!r}"
        raise ReferenceRefused(outside + hint)
    return target


MOST_CORNERS = 10_000
"""Most corners of a concave face: half a second if well-formed, more if it crosses itself."""
MOST_SQUARES = 1e9
"""Sum over the concave faces of a file of their corners squared: some seconds."""


def triangulate(
    path: Path, corners: Array, sizes: Array, points: Array
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Triangles of many polygons.

    Args:
        path: the file, for messages.
        corners: (C,) position of each corner in ``points``, polygon after polygon.
        sizes: (P,) corners of each polygon; those under 3 give nothing.
        points: (V, 3).

    Returns:
        ``(T, 3)`` indices into ``corners`` (not into points) and ``(T,)`` polygon of each
        triangle, in the polygons' order. Convex polygons become fans, others are ear-clipped.

    Raises:
        InputFileError: for concave faces with absurdly many corners.
    """
    sizes = np.asarray(sizes, np.int64)
    starts = np.cumsum(sizes) - sizes
    if len(sizes) and (sizes == 3).all():
        polygon = np.arange(len(sizes))
        return np.arange(3 * len(sizes)).reshape(-1, 3), polygon
    fans = np.clip(sizes - 2, 0, None)
    polygon = np.repeat(np.arange(len(sizes)), fans)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(fans) - fans, fans)
    first = starts[polygon]
    out = np.stack([first, first + step + 1, first + step + 2], axis=1)
    bad = _concave(out, polygon, sizes, corners, points)
    # The other diagonal of a concave quadrilateral is inside it.
    four = bad[sizes[bad] == 4]
    at, corner = np.searchsorted(polygon, four), starts[four]
    out[at] = np.stack([corner + 1, corner + 2, corner + 3], axis=1)
    out[at + 1] = np.stack([corner + 1, corner + 3, corner], axis=1)
    clipped = bad[sizes[bad] > 4]
    _check_budget(path, sizes[clipped])
    kept = np.ones(len(out), bool)
    for p in clipped:
        loop = starts[p] + np.arange(int(sizes[p]))
        ears = _ear_cut(points[corners[loop]])
        if ears is not None:
            at = int(np.searchsorted(polygon, p))
            out[at : at + len(ears)] = loop[ears]
            kept[at + len(ears) : at + int(sizes[p]) - 2] = False
    return (out, polygon) if kept.all() else (out[kept], polygon[kept])


def _check_budget(path: Path, sizes: Array) -> None:
    """Refuse concave faces that may take minutes: no object has such."""
    largest = int(sizes.max(initial=0))
    if largest > MOST_CORNERS or float((sizes.astype(np.float64) ** 2).sum()) > MOST_SQUARES:
        raise InputFileError(
            path,
            f"{len(sizes):,} concave face{'s'[: len(sizes) != 1]} with up to {largest:,} "
            "corners can take minutes to triangulate",
            "triangulate them in a modelling program",
        )


def _concave(out: Array, polygon: Array, sizes: Array, corners: Array, points: Array) -> Array:
    """Polygons whose fan has a triangle that is turned the wrong way."""
    many = np.flatnonzero(sizes[polygon] > 3)
    if not len(many):
        return many
    t = points[corners[out[many]]].astype(np.float64)
    cross = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    total = np.zeros((len(sizes), 3))
    np.add.at(total, polygon[many], cross)
    against = np.einsum("ij,ij->i", cross, total[polygon[many]]) < 0
    return np.unique(polygon[many[against]])


def _ear_cut(loop: Array) -> Array | None:
    """(T, 3) triangles of one planar polygon (n, 3), turned like it; None where it crosses itself.

    Corners on a straight line may be left out, so that T ≤ n - 2.
    """
    p = loop.astype(np.float64) - loop.mean(axis=0)
    normal = np.cross(p, np.roll(p, -1, axis=0)).sum(axis=0)
    flat = np.ascontiguousarray(np.delete(p, int(np.argmax(np.abs(normal))), axis=1))
    ends = np.array([len(flat)], np.uint32)
    ears = mapbox_earcut.triangulate_float64(flat, ends).reshape(-1, 3).astype(np.int64)
    t = p[ears]
    areas = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) @ normal
    whole = float(normal @ normal)
    if not abs(np.abs(areas).sum() - whole) <= 1e-3 * whole:
        return None
    ears[areas < 0] = ears[areas < 0][:, ::-1]
    return ears
