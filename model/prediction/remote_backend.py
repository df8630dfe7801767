"""Prediction on another machine (``artiworld backend``): the wire format and the client over HTTP.

A request is an NPZ archive without pickled objects: ``request`` holds JSON (:class:`Request`), the
other arrays are the parts' geometry, ``<part>.<array>``. Coordinates keep their precision, so that
a backend gives the same prediction as the local predictor. Textures become vertex colours. An
answer is a stream of JSON lines: ``{"progress": [0..1, text]}`` at least every second, then
``{"done": prediction}`` or ``{"error": text, "kind": …}``.
"""

from __future__ import annotations

import http.client
import io
import json
import math
import os
import ssl
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt

from model.core import codec
from model.core.articulated_object import Part, Prediction, SegmentedObject
from model.core.errors import ArtiworldError, ConfigurationError, GeometryError
from model.core.geometry import Material, Mesh, PointCloud
from model.core.joint import Joint
from model.core.progress import Cancelled, Progress, no_progress
from model.geometry.sampling import vertex_colors
from model.io.formats.points import ARCHIVE_ERRORS
from model.prediction import TOKEN_VARIABLE

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
    except ARCHIVE_ERRORS as error:
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


CONNECT_SECONDS = 10.0
SILENCE_SECONDS = 30.0
"""A backend sends a line every second, even while it serves others."""
_BLOCK = 2**18
MAX_LINE = 64 * 2**20
MOST_LINES = 100_000
"""One a second over a day."""
_LOCALLY = "predict on this machine instead"


class BackendError(ArtiworldError):
    """A backend can't be reached, refuses, or breaks off."""


class BackendRefused(BackendError):
    """A backend denies access to this client."""


class HttpPredictor:
    """Predicts on another machine.

    Args:
        url: such as ``http://gpu.example.org:8090``, perhaps with a path in front of the API.
        token: of the backend; the environment's :data:`TOKEN_VARIABLE` by default.
        connect_seconds: timeout of the connection.
        silence_seconds: timeout between two lines of the answer.

    Raises:
        ConfigurationError: if the address or the token is invalid.
    """

    def __init__(
        self,
        url: str,
        token: str | None = None,
        *,
        connect_seconds: float = CONNECT_SECONDS,
        silence_seconds: float = SILENCE_SECONDS,
    ) -> None:
        try:
            parts = urlsplit(url)
            self._host, self._port = parts.hostname, parts.port
        except ValueError as error:
            raise ConfigurationError(f"backend {url!r}: invalid address ({error})") from error
        if parts.scheme not in ("http", "https") or not self._host:
            raise ConfigurationError(
                f"backend {url!r}: invalid address; give one like http://gpu.example.org:8090"
            )
        if "@" in parts.netloc or parts.query or parts.fragment:
            raise ConfigurationError(
                "a backend's address must not contain a login, query or fragment; "
                f"give the token by --token or {TOKEN_VARIABLE}"
            )
        token = token or os.environ.get(TOKEN_VARIABLE) or None
        if token is not None and not (token.isascii() and token.isprintable()):
            raise ConfigurationError("a backend's token must consist of printable ASCII characters")
        self._secure = parts.scheme == "https"
        self._path = parts.path.rstrip("/")
        self._token = token
        self._connect_seconds, self._silence_seconds = connect_seconds, silence_seconds
        self.url = f"{parts.scheme}://{parts.netloc}{self._path}"
        self.name = self.url

    def check(self) -> dict[str, Any]:
        """The backend's health report.

        Raises:
            BackendError: if it can't be reached, is something else, or refuses the token.
        """
        with closing(self._connection()) as connection:
            response = self._ask(connection, "GET", HEALTH_PATH)
            try:
                health = json.loads(response.read(MAX_LINE))
            except (OSError, http.client.HTTPException, ValueError, RecursionError) as error:
                raise BackendError(f"{self.url} is no ArtiWorld backend") from error
        if not isinstance(health, dict) or health.get("service") != "artiworld backend":
            raise BackendError(f"{self.url} is no ArtiWorld backend")
        if health.get("token_needed") and self._token is None:
            raise BackendRefused(
                f"the backend {self.url} needs a token; give it by --token or {TOKEN_VARIABLE}"
            )
        return health

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """See :class:`model.prediction.registry.Predictor`. Cancelling closes the connection,
        which stops the backend.

        Raises:
            BackendError: if the backend can't be reached, refuses or breaks off.
            ArtiworldError: if it can't use the parts.
        """
        progress(0.0, f"Reaching {self.url}")
        limit = self.check().get("max_bytes")
        body = encode_request(segmented, locked, seed)
        if isinstance(limit, int) and len(body) > limit:
            raise BackendError(
                f"{segmented.name} has {len(body) / 1e6:.0f} MB, the backend {self.url} accepts "
                f"at most {limit / 1e6:.0f} MB; {_LOCALLY}"
            )
        with closing(self._connection()) as connection:
            response = self._ask(connection, "POST", PREDICT_PATH, body, progress)
            data = self._follow(response, progress)
        progress(1.0, "Reading the answer")
        try:
            answer = decode_answer(data, segmented)
        except ArtiworldError as error:
            raise BackendError(f"invalid answer of the backend {self.url}: {error}") from error
        return replace(answer, backend=f"{answer.backend} at {self.url}")

    def _connection(self) -> http.client.HTTPConnection:
        assert self._host is not None
        if self._secure:
            return http.client.HTTPSConnection(
                self._host, self._port, timeout=self._connect_seconds
            )
        return http.client.HTTPConnection(self._host, self._port, timeout=self._connect_seconds)

    def _ask(
        self,
        connection: http.client.HTTPConnection,
        method: str,
        path: str,
        body: bytes = b"",
        progress: Progress = no_progress,
    ) -> http.client.HTTPResponse:
        """Send a request; returns the response if its status is 200."""
        headers = {"Accept": "application/x-ndjson, application/json"}
        if self._token is not None:
            headers["Authorization"] = f"Bearer {self._token}"
        if body:
            headers |= {"Content-Type": CONTENT_TYPE, "Content-Length": str(len(body))}
        try:
            connection.connect()
            assert connection.sock is not None
            connection.sock.settimeout(self._silence_seconds)
            # It may answer before the request is complete, as when its queue is full.
            with suppress(BrokenPipeError, ConnectionResetError):
                connection.request(method, self._path + path, self._blocks(body, progress), headers)
            response = connection.getresponse()
        except TimeoutError as error:
            raise BackendError(self._unreachable("no answer")) from error
        except ssl.SSLError as error:
            raise BackendError(
                self._unreachable(f"no secure connection: {error.reason}")
            ) from error
        except (OSError, http.client.HTTPException) as error:
            why = getattr(error, "strerror", None) or str(error) or type(error).__name__
            raise BackendError(self._unreachable(why)) from error
        if response.status != 200:
            raise self._refusal(response)
        return response

    def _blocks(self, body: bytes, progress: Progress) -> Iterator[bytes] | None:
        if not body:
            return None

        def blocks() -> Iterator[bytes]:
            for begin in range(0, len(body), _BLOCK):
                progress(0.05 * begin / len(body), f"Sending {len(body) / 1e6:.1f} MB")
                yield body[begin : begin + _BLOCK]

        return blocks()

    def _follow(self, response: http.client.HTTPResponse, progress: Progress) -> object:
        """Report progress line by line; returns the value of "done"."""
        for _ in range(MOST_LINES):
            try:
                line = response.readline(MAX_LINE)
                message = json.loads(line) if line.endswith(b"\n") else None
            except TimeoutError as error:
                raise BackendError(
                    self._unreachable(f"no line for {self._silence_seconds:g} s")
                ) from error
            except (OSError, http.client.HTTPException) as error:
                raise BackendError(self._unreachable("connection lost")) from error
            except (ValueError, RecursionError) as error:
                raise BackendError(f"invalid answer of the backend {self.url}") from error
            if not isinstance(message, dict):
                raise BackendError(self._unreachable("the answer broke off"))
            if "done" in message:
                return message["done"]
            if "error" in message:
                raise self._error(message)
            fraction, text = _progress_of(message)
            progress(0.05 + 0.95 * fraction, text)
        raise BackendError(f"the backend {self.url} doesn't come to an end; {_LOCALLY}")

    def _error(self, message: dict[str, Any]) -> Exception:
        text = str(message["error"])[:2000]
        if message.get("kind") == "user":
            return ArtiworldError(text)
        if message.get("kind") == "cancelled":
            return Cancelled(text)
        return BackendError(f"the backend {self.url} failed: {text}; {_LOCALLY}")

    def _refusal(self, response: http.client.HTTPResponse) -> ArtiworldError:
        try:
            message = json.loads(response.read(_BLOCK))
            text = str(message["error"])[:2000]
        except (
            OSError,
            http.client.HTTPException,
            ValueError,
            KeyError,
            TypeError,
            RecursionError,
        ):
            return BackendError(
                f"{self.url} answered {response.status} {response.reason}: is it a backend?"
            )
        if response.status == 401:
            return BackendRefused(
                f"the backend {self.url} refuses the token; check --token or {TOKEN_VARIABLE}"
            )
        return BackendError(f"the backend {self.url} refused: {text}")

    def _unreachable(self, why: str) -> str:
        return f"the backend {self.url} can't be reached ({why}); {_LOCALLY}"


def _progress_of(message: dict[str, Any]) -> tuple[float, str]:
    try:
        fraction, text = message["progress"]
        return min(max(float(fraction), 0.0), 1.0), str(text)[:200]
    except (KeyError, TypeError, ValueError):
        return 0.0, ""
