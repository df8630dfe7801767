"""Zips of objects: checked and unpacked, so that nothing in them leaves its folder."""

from __future__ import annotations

import errno
import lzma
import os
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import BinaryIO

from model.core.errors import InputFileError
from model.core.files import draft_of
from model.io.formats.loaded import DEFAULT_MAX_BYTES, open_file
from model.io.geometry_files import SUFFIXES
from model.io.model_files import MODEL_SUFFIXES, find_assets
from model.io.urdf.files import BORDER

MAX_FILES = 5000
MAX_RATIO = 200
"""Largest compression ratio of a zip; meshes compress less."""
_RATIO_FROM = 50_000_000
"""Unpacked bytes up to which any ratio is allowed."""
_BLOCK = 1 << 20
DAMAGED = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, RuntimeError, EOFError)
DAMAGED += (ValueError, OverflowError, MemoryError)
"""Exceptions of zipfile where a zip is damaged."""
_BESIDE = (
    *".mtl .png .jpg .jpeg .bmp .tif .tiff .webp .bin .msh .json .txt .csv .md".split(),
    *".config .material".split(),
)
_WANTED = frozenset((*SUFFIXES, *MODEL_SUFFIXES, *_BESIDE))
_Files = list[tuple[PurePosixPath, zipfile.ZipInfo]]


def unpack(target: Path, name: str, file: BinaryIO, max_bytes: int) -> Path:
    """Unpack what a zip holds of objects into ``target``, in a folder that nothing in it may leave.

    Args:
        name: of the zip, for messages.
        max_bytes: largest unpacked size.

    Raises:
        InputFileError: where it is damaged or hostile, or holds nothing of the kind.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            files = _files_in(archive, name)
            if not _is_whole(target, files):
                with draft_of(target, lambda there: _is_whole(there, files)) as draft:
                    _extract(archive, files, draft, name, file.seek(0, os.SEEK_END), max_bytes)
                    if target.is_dir():  # a former version left it, and its objects may be open
                        _complete(target, files, draft)
    except (*DAMAGED, OSError) as error:
        if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
            raise  # such as a full disk; damaged streams have no number, damaged places this one
        why = f"is not a readable zip ({error})"
        raise InputFileError(name, why, "pack it again, without a password") from error
    (target.parent / BORDER).touch()
    return target


@contextmanager
def unzipped(path: Path) -> Iterator[Path]:
    """``path`` itself, or the only object of a zip, in a folder that is gone after the block.

    Raises:
        InputFileError: as :func:`unpack`, and where it holds several objects.
    """
    if not is_zip(path):
        yield path
        return
    with TemporaryDirectory(prefix="artiworld-") as folder, open_file(path) as file:
        place = Path(folder, path.stem)
        found = find_assets([unpack(place, str(path), file, DEFAULT_MAX_BYTES)])
        if len(found) > 1:
            names = ", ".join(p.name for p in found[:5])
            raise InputFileError(path, f"holds {len(found)} objects ({names})", "unpack it")
        yield found[0]


def is_zip(path: Path) -> bool:
    """True if ``path`` is a file that is called a zip."""
    return path.suffix.lower() == ".zip" and path.is_file()


def _files_in(archive: zipfile.ZipFile, name: str) -> _Files:
    """Files to unpack, without resource forks, thumbnails and programs."""
    entries = [e for e in archive.infolist() if not e.is_dir()]
    if len(entries) > MAX_FILES:
        why = f"holds {len(entries):,} files"
        raise InputFileError(name, why, f"a zip may hold at most {MAX_FILES:,}")
    paths = [(_inside(entry, name), entry) for entry in entries]
    return [(p, e) for p, e in paths if p is not None and p.suffix.lower() in _WANTED]


def _is_whole(folder: Path, files: _Files) -> bool:
    """True if a folder holds all that they hold; former versions left some that lack files."""
    try:
        return folder.is_dir() and all(
            zlib.crc32((folder / path).read_bytes()) == entry.CRC for path, entry in files
        )
    except OSError:
        return False


def _complete(folder: Path, files: _Files, source: Path) -> None:
    """Move what a folder lacks out of ``source`` into it; what it holds stays as old as it is."""
    for path, entry in files:
        if not _is_whole(folder, [(path, entry)]):
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (source / path).replace(folder / path)


def _extract(
    archive: zipfile.ZipFile, files: _Files, target: Path, name: str, size: int, max_bytes: int
) -> None:
    limit, taken = min(max_bytes, max(_RATIO_FROM, MAX_RATIO * size)), 0
    for path, entry in files:
        place = target / path
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise InputFileError(name, f"holds a file above {path}", "pack it again") from None
        if place.exists():
            raise InputFileError(name, f"holds {path} twice", "pack it again")
        # The sizes that a zip declares may be wrong, so the written bytes are counted.
        with archive.open(entry) as source, place.open("wb") as out:
            while block := source.read(_BLOCK):
                taken += len(block)
                if taken > limit:
                    what = f"unpacks to more than {limit / 1e6:.0f} MB"
                    raise InputFileError(name, what, "open large folders by path on the server")
                out.write(block)
    if not taken:
        raise InputFileError(name, "holds nothing that can be opened", "add meshes or scans to it")


def _inside(entry: zipfile.ZipInfo, name: str) -> PurePosixPath | None:
    """Return an entry's path below the folder; None for one to leave out.

    Raises:
        InputFileError: for a path that leads out of the folder, and for links.
    """
    path = PurePosixPath(entry.filename.replace("\\", "/"))
    odd = (
        path.is_absolute() or ".." in path.parts or ":" in entry.filename or "\0" in entry.filename
    )
    if odd:
        why = f"holds {entry.filename[:80]!r}, which leads out of it"
        raise InputFileError(name, why, "pack it again")
    if stat.S_ISLNK(entry.external_attr >> 16):
        why = f"holds the link {entry.filename[:80]!r}"
        raise InputFileError(name, why, "pack the file instead")
    if len(os.fsencode(str(path))) > 1000 or any(len(os.fsencode(p)) > 200 for p in path.parts):
        raise InputFileError(name, "holds a file with a very long name", "give it a shorter one")
    if path.parts[0] == "__MACOSX" or path.name.startswith("."):
        return None
    return path
