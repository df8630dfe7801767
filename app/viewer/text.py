"""Text from people, made safe to show."""

from __future__ import annotations

_KEEP = set(" -.,:;()/+%°·→×²³µ'")


def plain(text: str, limit: int = 120) -> str:
    """``text`` as literal markdown: no markup, no HTML, no expression survives.

    The browser compiles markdown as MDX, where braces are code; every character that is not a
    letter, a digit or harmless punctuation becomes a numeric entity.
    """
    short = text if len(text) <= limit else text[: limit - 1] + "…"
    return "".join(c if c.isalnum() or c in _KEEP else f"&#{ord(c)};" for c in short)


def percent(share: float) -> str:
    """A share, 0..1, with one digit; what there is at all is never shown as nothing."""
    return "< 0.1 %" if share < 0.0005 else f"{100 * share:.1f} %"
