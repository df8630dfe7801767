"""The numbers and bytes of a glTF file: buffers, buffer views, accessors."""

from __future__ import annotations

import base64
import binascii
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.io.formats.loaded import read_bytes
from model.io.formats.references import ReferenceRefused, resolve

Array = npt.NDArray[Any]
Json = dict[str, Any]

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
MAX_VALUES = 60_000_000


class GltfBuffers:
    """The accessors of one file; a buffer is read on first use.

    Args:
        tree: its JSON.
        binary: the chunk of a GLB, else None.
        max_bytes: of each file beside it.
    """

    def __init__(self, path: Path, tree: Json, binary: bytes | None, max_bytes: int) -> None:
        self._buffers: dict[int, bytes] = {}
        self.path, self.tree, self.binary, self.max_bytes = path, tree, binary, max_bytes

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            buffer = self.tree["buffers"][index]
            uri = buffer.get("uri")
            if uri is None:
                if index != 0 or self.binary is None:
                    raise InputFileError(self.path, f"buffer {index} has no data")
                data = self.binary
            else:
                data = self.uri(uri, "buffer")
            if len(data) < int(buffer["byteLength"]):
                raise InputFileError(
                    self.path,
                    f"buffer {index} has {len(data)} bytes instead of {buffer['byteLength']}",
                    "the file is cut off; download or export it again",
                )
            self._buffers[index] = data
        return self._buffers[index]

    def uri(self, uri: str, what: str) -> bytes:
        """Bytes at an address inside the file; ``what`` names them in errors."""
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            try:
                return base64.b64decode(body) if head.endswith("base64") else unquote(body).encode()
            except (binascii.Error, ValueError):
                raise InputFileError(self.path, f"a {what} inside it is damaged") from None
        try:
            target = resolve(unquote(uri), self.path.parent, self.path.parent)
        except ReferenceRefused as error:
            raise InputFileError(self.path, f"{what} {error}", "keep its files beside it") from None
        return read_bytes(target, self.max_bytes)

    def view(self, index: int) -> tuple[memoryview, int]:
        """A buffer view and its stride, 0 where its values lie one after the other."""
        view = self.tree["bufferViews"][index]
        start, size = int(view.get("byteOffset") or 0), int(view["byteLength"])
        data = self._buffer(view["buffer"])
        if start < 0 or size < 0 or start + size > len(data):
            raise InputFileError(self.path, f"buffer view {index} leaves its buffer")
        return memoryview(data)[start : start + size], int(view.get("byteStride") or 0)

    def _strided(self, view: int, offset: int, count: int, dtype: np.dtype, width: int) -> Array:
        data, stride = self.view(view)
        row = dtype.itemsize * width
        stride = stride or row
        if count == 0:
            return np.zeros((0, width), dtype)
        if (
            min(offset, count) < 0
            or stride < row
            or offset + stride * (count - 1) + row > len(data)
        ):
            raise InputFileError(
                self.path, f"{count} values don't fit into buffer view {view}", "export it again"
            )
        return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))

    def accessor(self, index: int, columns: int | None = None) -> Array:
        """(count, width) values, integers brought to 0..1 where they are normalised."""
        a = self.tree["accessors"][index]
        dtype, width, count = (
            np.dtype(_COMPONENTS[a["componentType"]]),
            _WIDTHS[a["type"]],
            a["count"],
        )
        if not isinstance(count, int) or count < 0:
            raise InputFileError(self.path, f"accessor {index} counts {count!r} values")
        if columns is not None and width != columns:
            raise InputFileError(self.path, f"accessor {index} is {a['type']}")
        if "bufferView" in a:
            offset = int(a.get("byteOffset") or 0)
            out = self._strided(a["bufferView"], offset, count, dtype, width)
        else:
            if count > MAX_VALUES:
                raise InputFileError(self.path, f"accessor {index} counts {count} values")
            out = np.zeros((count, width), dtype)
        if sparse := a.get("sparse"):
            out = self._sparse(out, sparse, dtype, width)
        if a.get("normalized") and dtype.kind in "iu":
            out = np.maximum(out / float(np.iinfo(dtype).max), -1.0).astype(np.float32)
        return out

    def _sparse(self, dense: Array, sparse: Json, dtype: np.dtype, width: int) -> Array:
        count, at, to = int(sparse["count"]), sparse["indices"], sparse["values"]
        where = self._strided(
            at["bufferView"], int(at.get("byteOffset") or 0), count,
            np.dtype(_COMPONENTS[at["componentType"]]), 1,
        )  # fmt: skip
        values = self._strided(
            to["bufferView"], int(to.get("byteOffset") or 0), count, dtype, width
        )
        out = dense.copy()
        out[where[:, 0]] = values
        return out
