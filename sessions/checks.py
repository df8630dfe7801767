"""Checks of the fields of commands, and cleaning of text that people type."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable

from model.core.errors import CommandError
from model.segmentation.prompts import MAX_PARTS

_BIDI_CONTROLS = frozenset(
    map(chr, (0x61C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A)))
)
_STRIPPED_CATEGORIES = frozenset({"Cc", "Cs", "Zl", "Zp"})


def clean_text(text: str, limit: int, what: str, *, lines: bool = False) -> str:
    """Return ``text`` without control characters and outer blanks.

    Args:
        text: what a person typed.
        limit: most characters allowed.
        what: how errors call it.
        lines: whether line breaks stay.

    Raises:
        CommandError: where it is no text, or too long.
    """
    if not isinstance(text, str):
        raise CommandError(f"{what} must be text, got {text!r}")
    text = text.replace("\r\n", "\n").replace("\t", " ")
    kept = "".join(c for c in text if (lines and c == "\n") or _kept(c)).strip()
    if len(kept) > limit:
        raise CommandError(f"{what} has {len(kept)} characters; at most {limit} are allowed")
    return kept


def clipped(text: str, limit: int) -> str:
    """Return clean text, cut to ``limit`` characters."""
    kept = clean_text(text, len(text), "text")
    return kept if len(kept) <= limit else kept[: limit - 1].rstrip() + "…"


def _kept(character: str) -> bool:
    return (
        unicodedata.category(character) not in _STRIPPED_CATEGORIES
        and character not in _BIDI_CONTROLS
    )


NAME_LIMIT = 80
PATH_LIMIT = 1000

_ARRAY_REF = re.compile(r"[0-9a-f]{64}")


def put_field(command: object, field: str, value: object) -> None:
    """Set a field of a frozen dataclass in its ``__post_init__``."""
    object.__setattr__(command, field, value)


def clean_field(command: object, field: str, limit: int, what: str, *, lines: bool = False) -> None:
    """Clean a text of a frozen dataclass in its ``__post_init__``; see :func:`clean_text`."""
    put_field(command, field, clean_text(getattr(command, field), limit, what, lines=lines))


def name_field(command: object, field: str, what: str) -> None:
    """The same for a short name; None and "" are none."""
    put_field(command, field, clean_text(getattr(command, field) or "", NAME_LIMIT, what) or None)


def check_part(part: int) -> None:
    """Refuse an invalid part id."""
    if isinstance(part, bool) or not 0 <= part < MAX_PARTS:
        raise CommandError(f"part must be 0..{MAX_PARTS - 1}, got {part}")


def check_ref(ref: str, what: str) -> None:
    """Refuse an invalid reference of a stored array."""
    if not _ARRAY_REF.fullmatch(ref):
        raise CommandError(f"{what} must be the reference of a stored array, got {ref[:80]!r}")


def check_count(count: int, what: str = "count") -> None:
    """Refuse negative numbers."""
    if count < 0:
        raise CommandError(f"{what} must be 0 or more, got {count}")


def check_finite(values: Iterable[float], what: str) -> None:
    """Refuse NaN and infinity."""
    if not all(math.isfinite(v) for v in values):
        raise CommandError(f"{what} must be finite numbers, got {tuple(values)}")


def check_unit_scale(scale: float, what: str) -> None:
    """Refuse a scale that isn't a positive number."""
    if not (math.isfinite(scale) and scale > 0):
        raise CommandError(f"{what} must be a positive number, got {scale}")


def check_pose(
    position: tuple[float, float, float], wxyz: tuple[float, float, float, float]
) -> None:
    """Refuse a position that isn't finite, or a quaternion that isn't of unit length."""
    check_finite(position, "position")
    check_finite(wxyz, "wxyz")
    length = sum(v * v for v in wxyz)
    if abs(length - 1.0) > 1e-6:
        raise CommandError(f"wxyz must be a unit quaternion, got one of squared length {length:g}")
