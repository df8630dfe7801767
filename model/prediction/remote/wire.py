"""The wire format between a client and a prediction backend.

A request is an NPZ archive without pickled objects: ``request`` holds JSON (:class:`Request`), the
other arrays are the parts' geometry, ``<part>.<array>``. Coordinates keep their precision, so that
a backend gives the same prediction as the local predictor. Textures become vertex colours. An
answer is a stream of JSON lines: ``{"progress": [0..1, text]}`` at least every second, then
``{"done": prediction}`` or ``{"error": text, "kind": …}``.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core import codec
from model.core.articulated_object import Part, Prediction, SegmentedObject
from model.core.errors import ArtiworldError, GeometryError
from model.core.geometry import Material, Mesh, PointCloud
from model.core.joint import Joint
from model.geometry.sampling import vertex_colors

FORMAT = 1
CONTENT_TYPE = "application/x-artiworld-parts"
"""Browsers don't send this type across sites without a preflight request."""
PREDICT_PATH = "/v1/predict"
HEALTH_PATH = "/health"
MAX_PARTS = 2000
MAX_UNPACKED = 2 * 2**30
MAX_HEADER = 8 * 2**20
_REQUEST = "request"


class RequestError(ArtiworldError):
    """Invalid bytes, or a request that a backend doesn't accept."""


@dataclass(frozen=True)
class PartHeader:
    """A part without its geometry."""

    link: str
    name: str | None = None


@dataclass(frozen=True)
class Request:
    """A request without its geometry."""

    format: int
    name: str
    parts: tuple[PartHeader, ...]
    category: str | None = None
    locked: tuple[Joint, ...] = ()
    seed: int = 0


def encode_request(segmented: SegmentedObject, locked: tuple[Joint, ...], seed: int) -> bytes:
    """The bytes of a request."""
    headers = tuple(PartHeader(part.link, part.name) for part in segmented.parts)
    request = Request(FORMAT, segmented.name, headers, segmented.category, locked, seed)
    text = json.dumps(codec.write(request), ensure_ascii=False, allow_nan=False).encode()
    arrays: dict[str, npt.NDArray[Any]] = {_REQUEST: np.frombuffer(text, np.uint8)}
    for index, part in enumerate(segmented.parts):
        for name, array in _arrays(part).items():
            arrays[f"{index}.{name}"] = array
    out = io.BytesIO()
    np.savez(out, **arrays)  # type: ignore[arg-type]
    return out.getvalue()


def _arrays(part: Part) -> dict[str, npt.NDArray[Any]]:
    out: dict[str, npt.NDArray[Any]] = {}
    mesh, cloud = part.mesh, part.cloud
    if mesh is not None:
        out["vertices"], out["faces"] = mesh.vertices, mesh.faces
        out["face_material"] = mesh.face_material
        out["base_colors"] = np.array([m.base_color for m in mesh.materials], np.uint8)
        if mesh.vertex_colors is not None or any(m.texture is not None for m in mesh.materials):
            out["vertex_colors"] = vertex_colors(mesh)
    if cloud is not None:
        out["points"] = cloud.points
        if cloud.normals is not None:
            out["normals"] = cloud.normals
        if cloud.colors is not None:
            out["colors"] = cloud.colors
    return out


def read_header(data: bytes) -> Request:
    """The request without its geometry: cheap enough for a server's event loop.

    Raises:
        RequestError: if the bytes are no request or unpack to more than :data:`MAX_UNPACKED`.
    """
    with _archive(data) as archive:
        return _header(archive)


def decode_request(data: bytes) -> tuple[SegmentedObject, tuple[Joint, ...], int]:
    """The object, the locked joints and the seed of a request.

    Raises:
        ArtiworldError: if the request is invalid.
    """
    with _archive(data) as archive:
        request = _header(archive)
        names = [name.removesuffix(".npy").partition(".") for name in archive.namelist()]
        found: dict[int, dict[str, npt.NDArray[Any]]] = {}
        for index, dot, name in names:
            if dot and index.isdigit() and int(index) < len(request.parts):
                array = _array(archive, f"{index}.{name}", MAX_UNPACKED)
                found.setdefault(int(index), {})[name] = array
    parts = tuple(_part(header, found.get(index, {})) for index, header in enumerate(request.parts))
    return SegmentedObject(request.name, parts, request.category), request.locked, request.seed


def _part(header: PartHeader, arrays: Mapping[str, npt.NDArray[Any]]) -> Part:
    mesh = cloud = None
    try:
        if "vertices" in arrays:
            colors = arrays.get("base_colors", np.array([[200, 200, 200, 255]], np.uint8))
            rows = [[int(v) for v in row] for row in colors]
            mesh = Mesh(
                arrays["vertices"],
                arrays["faces"],
                arrays.get("face_material", np.zeros(0, np.int32)),
                tuple(Material("material", (r, g, b, a)) for r, g, b, a in rows),
                vertex_colors=arrays.get("vertex_colors"),
            )
        if "points" in arrays:
            cloud = PointCloud(arrays["points"], arrays.get("normals"), arrays.get("colors"))
        return Part(header.link, mesh, cloud, header.name)
    except GeometryError as error:
        raise GeometryError(f"part {header.link!r}: {error}") from error
    except (KeyError, ValueError, TypeError) as error:
        raise RequestError(f"part {header.link!r}: missing or invalid array") from error


def _archive(data: bytes) -> zipfile.ZipFile:
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise RequestError("the body is no NPZ archive of parts") from error
    size = sum(entry.file_size for entry in archive.infolist())
    if size > MAX_UNPACKED:
        most = f"at most {MAX_UNPACKED / 2**30:g} are allowed"
        raise RequestError(f"the parts unpack to {size / 2**30:.1f} GiB, {most}")
    return archive


def _header(archive: zipfile.ZipFile) -> Request:
    if f"{_REQUEST}.npy" not in archive.namelist():
        raise RequestError(f"the archive lacks {_REQUEST}.npy")
    text = _array(archive, _REQUEST, MAX_HEADER).astype(np.uint8).tobytes()
    try:
        request = codec.read(Request, json.loads(text), _REQUEST)
    except (codec.CodecError, ValueError, RecursionError) as error:
        raise RequestError(f"invalid request: {error}") from error
    if request.format != FORMAT:
        raise RequestError(
            f"the request has format {request.format}, this backend reads {FORMAT}: "
            "use the same version of ArtiWorld on both sides"
        )
    if not 1 <= len(request.parts) <= MAX_PARTS:
        raise RequestError(f"{len(request.parts)} parts; 1 to {MAX_PARTS} are allowed")
    return request


def _array(archive: zipfile.ZipFile, name: str, limit: int) -> npt.NDArray[Any]:
    """One array of numbers, with a size that agrees with its header."""
    try:
        entry = archive.getinfo(f"{name}.npy")
        if entry.file_size > limit:
            raise RequestError(f"the array {name!r} is larger than {limit} bytes")
        data = archive.read(entry)
        stream = io.BytesIO(data)
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise ValueError(f"version {version}")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    except (
        KeyError, ValueError, TypeError, OSError, EOFError, SyntaxError, RuntimeError,
        NotImplementedError, zipfile.BadZipFile, zlib.error,
    ) as error:  # fmt: skip
        raise RequestError(f"the array {name!r} is damaged") from error
    begin = stream.tell()
    if dtype.kind not in "fiu" or fortran or math.prod(shape) * dtype.itemsize != len(data) - begin:
        raise RequestError(f"the array {name!r} contradicts its header: {dtype} {shape}")
    return np.frombuffer(data, dtype, offset=begin).reshape(shape)


def encode_answer(answer: Prediction) -> dict[str, Any]:
    """A prediction as JSON values."""
    return codec.write(answer)


def decode_answer(data: object, segmented: SegmentedObject) -> Prediction:
    """The prediction that a backend sent for ``segmented``.

    Raises:
        ArtiworldError: if it is invalid or lacks a part.
    """
    try:
        answer = codec.read(Prediction, data, "prediction")
    except codec.CodecError as error:
        raise RequestError(f"invalid prediction ({error})") from error
    if answer.tree is not None:
        absent = {p.link for p in segmented.parts} - set(answer.tree.links)
        if absent:
            raise RequestError(f"the answer lacks the part {min(absent)!r}")
    return answer
