"""Files of a workspace: arrays named by their content, accepted assets and releases.

Arrays are written once and read back with their checksum. Accepted assets and releases lie in
folders of the workspace, or in object storage beside them. There an asset is a folder of files
below ``assets/NAME/VERSION``; the small object ``assets/NAME/current`` names the version that
counts, so that nobody reads half an asset. The folder in the workspace is a copy then, which is
fetched where it is missing or old.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import ConfigurationError, InputFileError, StoreError
from model.core.files import draft_of, file_sha256
from model.core.packages import install_command
from model.io.assets.asset_folder import publish, read_provenance
from sessions.document import SavedRecord

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


STORAGE_VARIABLE = "ARTIWORLD_STORAGE"
"""Environment variable with the address of the storage, for all commands."""
_CURRENT = "current"
_SECONDS = 30
"""Longest request, and longest time of trying again."""


class AssetStorage:
    """Assets and releases of one workspace. Methods may be called from any thread.

    Args:
        workspace: whose folder ``assets`` holds them, or copies of them.
        url: of a place that fsspec knows, such as ``s3://bucket/prefix``; None: only the folder.

    Raises:
        ConfigurationError: where the address can't be used.
    """

    def __init__(self, workspace: Path, url: str | None = None) -> None:
        self._local, self._copies = workspace / "assets", workspace / "storage"
        self._withdrawn = workspace / "withdrawn"
        self.url = (url or "").rstrip("/")
        self._files: Any = None  # fsspec's file systems have no types
        self._root = ""
        if self.url:
            self._files, self._root = _file_system(self.url)

    def check(self) -> None:
        """Ask the storage for something.

        Raises:
            StoreError: where it doesn't answer, or refuses.
        """
        if self._files is not None:
            with self._translated():
                self._files.find(f"{self._root}/assets/.check")

    def publish(self, draft: Path, folder: Path, provenance: Mapping[str, Any]) -> Path:
        """Put a draft in the place of the asset ``folder``; returns where it lies.

        Raises:
            StoreError: where the storage doesn't take it.
        """
        self._set_aside(folder, _accepted_at(folder))
        written = Path(publish(draft, folder, provenance).folder)
        if self._files is not None:
            self._put(written, f"assets/{written.name}")
        return written

    def settle(self, name: str, accepted: str) -> None:
        """Let the asset ``name`` that was accepted then (ISO 8601) stand and set others aside; ""
        sets all aside.

        Raises:
            StoreError: where the storage fails, or a folder can't be moved.
        """
        folder, aside = self._local / name, self._withdrawn / name
        version = None if self._files is None else self._current(name)
        if version is not None and not folder.is_dir():
            self._fetch(folder, version)
        standing = _accepted_at(folder)
        known = {standing, *(p.name for p in aside.glob("*"))}
        # Earlier versions wrote the time of asking, which is before that of accepting.
        wanted = max((at for at in known if at <= accepted), default=accepted and standing)
        if wanted != standing:
            self._set_aside(folder, standing)
            if wanted:
                self._move(aside / wanted, folder)
        if self._files is None or (version is None, wanted) in ((False, standing), (True, "")):
            return
        if wanted:
            self._put(folder, f"assets/{name}")
        else:
            with self._translated():
                self._files.rm_file(f"{self._root}/assets/{name}/{_CURRENT}")

    def _set_aside(self, folder: Path, at: str) -> None:
        if at:
            self._move(folder, self._withdrawn / folder.name / at)

    def _move(self, folder: Path, target: Path) -> None:
        with suppress(FileNotFoundError), self._translated():  # another server may be first
            target.parent.mkdir(parents=True, exist_ok=True)
            folder.rename(target)

    def folder(self, saved: SavedRecord | None) -> Path | None:
        """Return the folder of an asset as it counts now, also in a workspace that was moved.

        Raises:
            StoreError: where the storage has it and it can't be read.
        """
        if saved is None:
            return None
        local = self._local / Path(saved.folder).name
        lacking = None
        while self._files is not None and (version := self._current(local.name)) is not None:
            if local.is_dir() and self._copied(local.name) == version:
                return local
            if self._fetch(local, version):
                continue
            if version == lacking:  # a replaced one lacks files once, then another is current
                raise StoreError(
                    f"{self.url}/assets/{local.name}: version {version} isn't complete there; "
                    "accept the object again"
                )
            lacking = version
        here = [f for f in (Path(saved.folder), local) if f.is_dir()]
        return here[0] if here else None

    def has(self, saved: SavedRecord | None) -> bool:
        """True if an asset is likely there, without asking the storage."""
        return saved is not None and (
            self._files is not None
            or Path(saved.folder).is_dir()
            or (self._local / Path(saved.folder).name).is_dir()
        )

    def check_release(self, name: str) -> None:
        """Refuse a release that the storage has already.

        Raises:
            ConfigurationError: where it is there: a release never changes.
        """
        if self._files is not None and self._read(f"releases/{name}/{_CURRENT}") is not None:
            raise ConfigurationError(
                f"{self.url}/releases/{name} is there already; a release never changes: give a "
                "new --version"
            )

    def keep_release(self, folder: Path) -> str:
        """Copy a release to the storage; returns its address there, or "" without one."""
        if self._files is None:
            return ""
        return self._put(folder, f"releases/{folder.name}")

    # --- the storage

    def _put(self, folder: Path, key: str) -> str:
        files, version = _files_in(folder), _version_of(folder)
        before = self._read(f"{key}/{_CURRENT}")
        with self._translated():
            if self.url.startswith("file://"):  # others show no object before it is complete
                home = Path(self._root, key)
                with draft_of(
                    home / version, lambda there: all((there / n).is_file() for n in files)
                ) as draft:
                    shutil.copytree(folder, draft)
                with draft_of(home / _CURRENT) as draft:
                    draft.write_text(version)
            else:
                for name, path in files.items():
                    self._files.put_file(str(path), f"{self._root}/{key}/{version}/{name}")
                self._files.pipe_file(f"{self._root}/{key}/{_CURRENT}", version.encode())
        if key.startswith("assets/"):
            self._mark(folder.name, version)
        if before not in (None, version):
            with suppress(Exception):  # what nobody refers to does no harm
                self._files.rm(self._files.find(f"{self._root}/{key}/{before}"))
        return f"{self.url}/{key}/{version}"

    def _fetch(self, local: Path, version: str) -> bool:
        """Copy a version from the storage to its place, unless it lacks files, as while another
        replaces it."""
        prefix = f"{self._root}/assets/{local.name}/{version}/"
        try:
            with draft_of(local) as draft, self._translated():
                for path in self._files.find(prefix):
                    name = PurePosixPath(path.partition(f"/{local.name}/{version}/")[2])
                    if name.is_absolute() or ".." in name.parts:
                        raise StoreError(f"{self.url}: {path} leads out of its folder")
                    (draft / name).parent.mkdir(parents=True, exist_ok=True)
                    self._files.get_file(path, str(draft / name))
                if _version_of(draft) != version:
                    raise FileNotFoundError(prefix)
        except FileNotFoundError:
            return False
        self._mark(local.name, version)
        return True

    def _current(self, name: str) -> str | None:
        version = self._read(f"assets/{name}/{_CURRENT}")
        if version is not None and not (len(version) == 32 and version.isalnum()):
            raise StoreError(f"{self.url}/assets/{name}/{_CURRENT} names no version")
        return version

    def _read(self, key: str) -> str | None:
        with self._translated():
            try:
                return self._files.cat_file(f"{self._root}/{key}").decode()
            except FileNotFoundError as error:
                if "NoSuchBucket" in str(error):
                    raise StoreError(f"{self.url}: there is no such bucket") from error
                return None

    def _mark(self, name: str, version: str) -> None:
        with draft_of(self._copies / name) as draft:
            draft.write_text(version)

    def _copied(self, name: str) -> str:
        try:
            return (self._copies / name).read_text()
        except OSError:
            return ""

    @contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except (StoreError, FileNotFoundError):
            raise
        except Exception as error:  # each kind of storage has errors of its own
            first = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
            raise StoreError(f"{self.url or self._local}: the storage fails ({first})") from error


def _accepted_at(folder: Path) -> str:
    """When the asset in a folder was accepted; "" where there is none."""
    with suppress(InputFileError, KeyError, TypeError):
        return str(read_provenance(folder)["review"]["at"])
    return ""


def _files_in(folder: Path) -> dict[str, Path]:
    return {p.relative_to(folder).as_posix(): p for p in folder.rglob("*") if p.is_file()}


def _version_of(folder: Path) -> str:
    """A key of all files' names and bytes."""
    sums = "".join(f"{n} {file_sha256(p)}\n" for n, p in sorted(_files_in(folder).items()))
    return hashlib.sha256(sums.encode()).hexdigest()[:32]


def _file_system(url: str) -> tuple[Any, str]:
    """The file system of an address, and the path below which everything lies."""
    kind, _, root = url.partition("://")
    if not kind or not root:
        raise ConfigurationError(
            f"the storage {url} is no address; give one like s3://bucket/prefix"
        )
    if kind != "s3":
        import fsspec

        try:
            return fsspec.filesystem(kind, **({"auto_mkdir": True} if kind == "file" else {})), root
        except (ValueError, ImportError) as error:
            raise ConfigurationError(f"the storage {url} can't be used ({error})") from error
    try:
        from obstore.fsspec import FsspecStore
    except ImportError as error:
        command = install_command("artiworld[s3]")
        raise ConfigurationError(f"the storage {url} needs a package; run: {command}") from error
    plain = os.environ.get("AWS_ENDPOINT_URL", "").startswith("http://")
    return FsspecStore(
        "s3",
        client_options={"timeout": f"{_SECONDS}s", "allow_http": plain},
        retry_config={"max_retries": 3, "retry_timeout": timedelta(seconds=_SECONDS)},
    ), root
