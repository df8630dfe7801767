"""Text from people, made safe to show."""

from __future__ import annotations

from markdown_it import MarkdownIt

_KEEP = set(" -.,:;()/+%°·→×²³µ'")


def plain(text: str, limit: int = 120) -> str:
    """``text`` as literal markdown: no markup, no HTML, no expression survives.

    The browser compiles markdown as MDX, where braces are code; every character that is not a
    letter, a digit or harmless punctuation becomes a numeric entity.
    """
    short = text if len(text) <= limit else text[: limit - 1] + "…"
    return "".join(c if c.isalnum() or c in _KEEP else f"&#{ord(c)};" for c in short)


def markdown_html(text: str) -> str:
    """Markdown from people as HTML: HTML in it is shown as text, and nothing is loaded.

    Links lead to http, https and mailto only, in a tab of their own; images are shown as links.
    """
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = reader.parse(text)
    for token in tokens:
        for child in token.children or ():
            if child.type == "image":
                child.type, child.tag = "text", ""
                child.content = f"[{child.content}] ({child.attrs.get('src', '')})"
                child.children = None
            elif child.type == "link_open":
                link = str(child.attrs.get("href", ""))
                if not link.lower().startswith(("https://", "http://", "mailto:")):
                    child.attrs.pop("href", None)
                child.attrs.update(target="_blank", rel="noopener noreferrer nofollow")
    return reader.renderer.render(tokens, reader.options, {})


def path_with_tooltip(path: str, limit: int = 44) -> str:
    """A path as literal markdown, shortened in the middle to a panel's width; whole on hovering."""
    half = (limit - 1) // 2
    short = path if len(path) <= limit else f"{path[:half]}…{path[-half:]}"
    return f'<span title="{plain(path, 1000)}">{plain(short)}</span>'


def percent(share: float) -> str:
    """A share, 0..1, with one digit; what there is at all is never shown as nothing."""
    return "< 0.1 %" if share < 0.0005 else f"{100 * share:.1f} %"
