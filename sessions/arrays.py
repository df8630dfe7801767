"""Arrays in files named by their content, written once and read back with their checksum."""

from __future__ import annotations

import hashlib
import json
import os
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import StoreError
from model.core.files import draft_of

MAGIC = b"ARTIWORLD-ARRAY 1\n"
_MAGIC_ANY = b"ARTIWORLD-ARRAY "
_REF = re.compile(r"[0-9a-f]{64}")
_UNSIGNED = (np.uint8, np.uint16, np.uint32, np.uint64)


class ArrayFiles:
    """Arrays below a folder, as ``ab/abcd….array``.

    A file is the magic line, a line of JSON (dtype, shape, packing), and the zlib stream.
    Integers are packed first: sorted ones as differences, others from their lowest value, in the
    fewest bytes that hold them.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, ref: str) -> Path:
        """Return the file of ``ref``.

        Raises:
            StoreError: where ``ref`` is malformed.
        """
        if not _REF.fullmatch(ref):
            raise StoreError(f"{ref[:80]!r} is no reference of a stored array")
        return self.folder / ref[:2] / f"{ref}.array"

    def put(self, array: npt.NDArray[Any]) -> str:
        """Write ``array`` (numbers or booleans) and return its reference.

        Durable when it returns; an existing array is written again only where its file is damaged.

        Raises:
            StoreError: where the folder can't be written, or for other kinds of arrays.
        """
        array = _plain(array)
        ref = _digest(array)
        path = self.path(ref)
        if path.exists() and self._is_whole(ref):
            return ref
        try:
            _write_durably(path, _encode(array))
        except OSError as error:
            raise StoreError(
                f"{path}: can't be written ({error.strerror or error}); "
                "the workspace must be a folder that you may write to, with room left"
            ) from error
        return ref

    def get(self, ref: str) -> npt.NDArray[Any]:
        """Return the array behind ``ref``, read-only.

        Raises:
            StoreError: naming the file, where it is missing or damaged.
        """
        path = self.path(ref)
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            raise StoreError(f"{path}: is missing; restore it from a copy") from None
        except OSError as error:
            raise StoreError(f"{path}: can't be read ({error.strerror or error})") from error
        if data.startswith(_MAGIC_ANY) and not data.startswith(MAGIC):
            raise StoreError(f"{path}: was written by a newer version of ArtiWorld; use that one")
        try:
            array = _decode(data)
        except (ValueError, KeyError, TypeError, OverflowError, zlib.error) as error:
            raise StoreError(f"{path}: is damaged; restore it from a copy") from error
        if _digest(array) != ref:
            raise StoreError(f"{path}: is damaged (wrong checksum); restore it from a copy")
        array.flags.writeable = False
        return array

    def _is_whole(self, ref: str) -> bool:
        try:
            self.get(ref)
        except StoreError:
            return False
        return True


def _plain(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array = np.asarray(array)
    if array.dtype.kind not in "biuf":
        raise StoreError(f"arrays of {array.dtype} can't be stored; only numbers and booleans can")
    little = array.dtype.newbyteorder("<")
    return np.ascontiguousarray(array, dtype=little).reshape(array.shape)


def _digest(array: npt.NDArray[Any]) -> str:
    digest = hashlib.sha256(f"{array.dtype.str}{array.shape}".encode())
    digest.update(array.reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def _encode(array: npt.NDArray[Any]) -> bytes:
    packed, packing, base = _pack(array.reshape(-1))
    header = {
        "dtype": array.dtype.str,
        "shape": list(array.shape),
        "packing": packing,
        "packed": packed.dtype.str,
        "base": base,
    }
    return MAGIC + json.dumps(header).encode() + b"\n" + zlib.compress(packed.tobytes(), 1)


def _decode(data: bytes) -> npt.NDArray[Any]:
    if not data.startswith(MAGIC):
        raise ValueError("no magic line")
    line, _, body = data[len(MAGIC) :].partition(b"\n")
    header = json.loads(line)
    dtype = np.dtype(header["dtype"])
    packed = np.frombuffer(zlib.decompress(body), dtype=np.dtype(header["packed"]))
    flat = _unpack(packed, header["packing"], header["base"], dtype)
    return flat.reshape(header["shape"])


def _pack(flat: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], str, int]:
    if flat.dtype.kind not in "iu" or not len(flat):
        return flat, "none", 0
    if len(flat) > 1 and bool((flat[1:] >= flat[:-1]).all()):
        steps = flat[1:] - flat[:-1]
        if int(steps.min()) >= 0:  # a negative one overflowed
            steps = np.concatenate([np.zeros(1, flat.dtype), steps])
            return _narrow(steps, int(steps.max())), "difference", int(flat[0])
    low, high = int(flat.min()), int(flat.max())
    # Wraps where the span overflows a signed type; the low bits stay right, and unpacking wraps
    # back.
    return _narrow(flat - flat.dtype.type(low), high - low), "offset", low


def _narrow(values: npt.NDArray[Any], highest: int) -> npt.NDArray[Any]:
    """Return ``values`` modulo 2^bits in the fewest bytes that hold ``highest``."""
    for dtype in _UNSIGNED:
        if highest <= np.iinfo(dtype).max:
            return values.astype(dtype)
    raise AssertionError(f"{highest} doesn't fit 64 bits")


def _unpack(
    packed: npt.NDArray[Any], packing: str, base: int, dtype: np.dtype[Any]
) -> npt.NDArray[Any]:
    if packing == "none":
        return packed.astype(dtype)
    if packing == "offset":
        return packed.astype(dtype) + dtype.type(base)
    if packing == "difference":
        return np.cumsum(packed, dtype=dtype) + dtype.type(base)
    raise ValueError(f"unknown packing {packing!r}")


def _write_durably(path: Path, data: bytes) -> None:
    with draft_of(path) as draft, draft.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
