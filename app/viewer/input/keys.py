"""Keys, as the field's habits have them. W A S D Q E and the arrows belong to the camera."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from html import escape
from typing import Any

from app.viewer.tab import Tab
from app.viewer.words import keys as words

_STYLE = (
    "display:grid;grid-template-columns:max-content 1fr;gap:0.05em 1.2em;"
    "font-size:0.82em;line-height:1.22"
)


@dataclass(frozen=True)
class Binding:
    """One command of the palette (Ctrl+K).

    Attributes:
        label: its name there.
        key: the key that triggers it too, or None.
        action: what it does.
        modifier: the keys that are held with it, or None.
        decides: whether it decides about what is on the screen.
    """

    label: str
    key: Any
    action: Callable[[], None]
    modifier: Any = None
    decides: bool = False


def add_keys(
    tab: Tab, bindings: Iterable[Binding], decide: Callable[[Callable[[], None]], None]
) -> None:
    """Register commands with their keys; ``decide`` carries out those that decide."""
    for binding in bindings:
        command = tab.client.gui.add_command(
            binding.label, hotkey=binding.key, modifier=binding.modifier
        )
        carry_out = decide if binding.decides else tab.act
        command.on_trigger(lambda _, run=carry_out, action=binding.action: run(action))


class KeySheet:
    """The sheet of keys, over the picture."""

    def __init__(self, tab: Tab) -> None:
        self._tab = tab
        self._modal: Any = None

    def toggle(self) -> None:
        """Show the sheet, or close it."""
        if self.close():
            return
        gui = self._tab.client.gui
        self._modal = gui.add_modal(words.TITLE)
        with self._modal:
            close = gui.add_button(words.CLOSE, color="gray")
            rows = "".join(f"<b>{escape(k)}</b><span>{escape(v)}</span>" for k, v in words.SHEET)
            gui.add_html(f'<div style="{_STYLE}">{rows}</div>')
        close.on_click(lambda _: self._close_clicked())

    def _close_clicked(self) -> None:
        self.close()

    def close(self) -> bool:
        """Close the sheet; whether it was there."""
        modal, self._modal = self._modal, None
        if modal is not None:
            modal.close()
        return modal is not None
