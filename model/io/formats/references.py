"""Files that a file names: they may not leave its folder."""

from __future__ import annotations

import re
from pathlib import Path

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
        inside = target.is_relative_to(root.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise ReferenceRefused(f"{shown} can't be followed: {error}") from None
    if not inside:
        raise ReferenceRefused(f"{shown} leads outside the folder {root.name or str(root)!r}")
    return target
