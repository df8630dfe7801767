"""Cleaning text that people type."""

from __future__ import annotations

import unicodedata

from model.core.errors import CommandError

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
