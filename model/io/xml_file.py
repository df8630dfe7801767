"""XML files that describe robots, opened with care."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from model.core.errors import InputFileError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MAX_BYTES = 64 * 2**20
"""No honest URDF or MJCF is larger; its meshes lie beside it."""


def parse(path: Path, roots: tuple[str, ...], kind: str) -> Element:
    """The root element of a file without DTD and entities.

    Args:
        path: the file.
        roots: what the root may be called.
        kind: such as ``a URDF``, for messages.

    Raises:
        InputFileError: where it can't be read, is too large, or is none of ``kind``.
    """
    from xml.etree.ElementTree import ParseError

    import defusedxml
    from defusedxml import ElementTree

    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputFileError(path, f"is larger than 64 MiB, too large for {kind}")
        data = path.read_bytes()
    except OSError as error:
        raise InputFileError(path, error.strerror or "can't be read") from error
    try:
        root = ElementTree.fromstring(data, forbid_dtd=True)
    except defusedxml.DefusedXmlException as error:
        raise InputFileError(path, "declares a DTD or entities", "remove them") from error
    except (ParseError, ValueError, LookupError) as error:
        raise InputFileError(
            path, f"is not well-formed XML ({error})", f"{kind} is an XML file"
        ) from error
    if root.tag not in roots:
        raise InputFileError(path, f"begins with <{root.tag}>", f"{kind} begins with <{roots[0]}>")
    return root
