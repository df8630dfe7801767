"""Files that a browser sent: kept under their content's digest, zips unpacked with care."""

from __future__ import annotations

import hashlib
import io
import os
import re
import shutil
import stat
import zipfile
from pathlib import Path, PurePosixPath

from model.core.errors import InputFileError
from model.io.geometry_files import SUFFIXES
from model.io.model_files import MODEL_SUFFIXES
from model.io.urdf.files import URDF_SUFFIX

MOST_FILES = 5000
MOST_RATIO = 200
"""A zip that unpacks to more than this many times its size is no zip of meshes."""
_RATIO_FROM = 50_000_000
_BLOCK = 1 << 20
_BESIDE = (".mtl", ".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".bin", ".urdf",
           ".mjcf", ".msh", ".json", ".txt", ".csv", ".xml", ".md")  # fmt: skip


def keep_upload(folder: Path, name: str, content: bytes, max_bytes: int) -> Path:
    """What can be opened of an uploaded file: itself, or the folder that a zip was unpacked to.

    Args:
        folder: where uploads are kept.
        max_bytes: that a zip may unpack to.

    Raises:
        InputFileError: where no reader knows it, nothing is in it, or a zip is damaged or hostile.
    """
    safe = plain_name(name)
    suffix = Path(safe).suffix.lower()
    # An MJCF may be made of boxes alone.
    if suffix in MODEL_SUFFIXES and (suffix == URDF_SUFFIX or b"file=" in content):
        raise InputFileError(safe, "its meshes didn't come along", "zip it with their folder")
    if suffix not in (".zip", *SUFFIXES, *MODEL_SUFFIXES):
        known = ", ".join(sorted(SUFFIXES))
        raise InputFileError(
            safe, "this kind of file can't be opened", f"give one of {known}, or a zip of several"
        )
    if not content:
        raise InputFileError(safe, "the file is empty", "choose one with a mesh or points")
    own = folder / hashlib.sha256(content).hexdigest()[:16]
    if suffix == ".zip":
        return _unpacked(own / Path(safe).stem, safe, content, max_bytes)
    own.mkdir(parents=True, exist_ok=True)
    path, part = own / safe, own / f".{safe}.part"
    if not path.exists():
        part.write_bytes(content)
        part.rename(path)
    return path


def _unpacked(target: Path, name: str, content: bytes, max_bytes: int) -> Path:
    if target.exists():
        return target
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f".{target.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            _extract(archive, part, name, len(content), max_bytes)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError) as error:
        shutil.rmtree(part, ignore_errors=True)
        raise InputFileError(
            name, f"is no zip that can be read ({error})", "pack it again, without a password"
        ) from error
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    part.rename(target)
    return target


def _extract(archive: zipfile.ZipFile, target: Path, name: str, size: int, max_bytes: int) -> None:
    entries = [e for e in archive.infolist() if not e.is_dir()]
    if len(entries) > MOST_FILES:
        raise InputFileError(
            name, f"holds {len(entries):,} files", f"a zip may hold at most {MOST_FILES:,}"
        )
    room, taken = min(max_bytes, max(_RATIO_FROM, MOST_RATIO * size)), 0
    for entry in entries:
        path = _inside(entry, name)
        if path is None or path.suffix.lower() not in (*SUFFIXES, *_BESIDE):
            continue  # resource forks, thumbnails, programs: nothing that a reader would open
        place = target / path
        place.parent.mkdir(parents=True, exist_ok=True)
        if place.exists():
            raise InputFileError(name, f"holds {path} twice", "pack it again")
        # What is written is counted: the sizes that a zip announces may be lies.
        with archive.open(entry) as source, place.open("wb") as out:
            while block := source.read(_BLOCK):
                taken += len(block)
                if taken > room:
                    raise InputFileError(
                        name,
                        f"unpacks to more than {room / 1e6:.0f} MB",
                        "open large folders by path on the server",
                    )
                out.write(block)
    if not taken:
        raise InputFileError(name, "holds nothing that can be opened", "add meshes or scans to it")


def _inside(entry: zipfile.ZipInfo, name: str) -> PurePosixPath | None:
    """Where an entry goes below the folder; None for what is left out.

    Raises:
        InputFileError: for a path that leads out of the folder, and for links.
    """
    path = PurePosixPath(entry.filename.replace("\\", "/"))
    odd = (
        path.is_absolute() or ".." in path.parts or ":" in entry.filename or "\0" in entry.filename
    )
    if odd:
        raise InputFileError(
            name, f"holds {entry.filename[:80]!r}, which leads out of it", "pack it again"
        )
    if stat.S_ISLNK(entry.external_attr >> 16):
        raise InputFileError(
            name, f"holds the link {entry.filename[:80]!r}", "pack the file instead"
        )
    if len(os.fsencode(str(path))) > 1000 or any(len(os.fsencode(p)) > 200 for p in path.parts):
        raise InputFileError(name, "holds a file with an endless name", "give it a shorter one")
    if path.parts[0] == "__MACOSX" or path.name.startswith("."):
        return None
    return path


def plain_name(name: str) -> str:
    """A file name without folders and odd characters, at most 120 characters."""
    last = PurePosixPath(name.replace("\\", "/")).name
    clean = re.sub(r"[^\w .()+-]", "_", last).strip(" .")
    suffix = PurePosixPath(clean).suffix[:10]
    if len(clean) > 120:
        clean = clean[: 120 - len(suffix)] + suffix
    return clean or "upload"
