"""Custom controls beside viser's: HTML buttons that call back when they are pressed."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from html import escape
from typing import Any

from viser._icons import svg_from_icon

from app.server.pointer_messages import ArtiworldPressMessage, show_markup
from app.viewer.tab import Tab


class Presses:
    """Calls back for the controls of one tab, by their action."""

    def __init__(self, tab: Tab) -> None:
        self._tab = tab
        self._actions: dict[str, tuple[Callable[[str], None], bool]] = {}
        endpoint = tab.client._websock_connection
        endpoint.register_handler(ArtiworldPressMessage, lambda _, m: self._pressed(m))

    def on(self, action: str, callback: Callable[[str], None], *, at_once: bool = False) -> None:
        """Have ``callback`` get the value of the control; ``at_once`` on viser's thread, also
        while other actions run."""
        self._actions[action] = callback, at_once

    def _pressed(self, message: ArtiworldPressMessage) -> None:
        callback, at_once = self._actions.get(str(message.action), (None, False))
        if callback is None:
            return
        value = str(message.value)
        if at_once:
            callback(value)
        else:
            self._tab.act(lambda: callback(value))


class Place:
    """A place over the picture; nothing is sent twice."""

    def __init__(self, tab: Tab, name: str) -> None:
        self._tab, self._name, self._shown = tab, name, ""

    def show(self, html: str) -> None:
        """Show ``html``; nothing where it is ""."""
        if html != self._shown:
            self._shown = html
            show_markup(self._tab.client, self._name, html)


@lru_cache(maxsize=128)
def icon(name: Any) -> str:
    """An icon as SVG, which says nothing to screen readers."""
    return svg_from_icon(name).replace("<svg", '<svg aria-hidden="true"', 1)


def button(
    action: str,
    value: str,
    label: str,
    *,
    content: str | None = None,
    tip: str = "",
    style: str = "",
    pressed: bool | None = None,
    disabled: bool = False,
) -> str:
    """A button as HTML.

    Args:
        action, value: what :class:`Presses` gets.
        label: its name for screen readers, and its text where there is no ``content``.
        content: HTML to show instead.
        tip: shown under the pointer.
        style: its class.
        pressed: whether it is chosen; None where it can't be.
    """
    state = "" if pressed is None else f' aria-pressed="{str(pressed).lower()}"'
    tip = f' data-tip="{escape(tip)}"' if tip else ""
    off = " disabled" if disabled else ""
    return (
        f'<button type="button" class="aw-button {style}" data-press="{escape(action)}" '
        f'value="{escape(value)}" aria-label="{escape(label)}"{state}{tip}{off}>'
        f"{escape(label) if content is None else content}</button>"
    )
