"""Controls that several panels share: HTML buttons that call back, a list of known words with a box
for any other one, the buttons that predict joints, the name that signs decisions.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from html import escape
from typing import Any

import viser
from viser._icons import svg_from_icon

from app.server.page import ArtiworldPressMessage, show_markup
from app.viewer.tab import Tab, plain
from app.viewer.words import common as words
from app.viewer.words.common import NONE, OTHER
from sessions import commands as cmd


def put(handle: Any, **values: Any) -> None:
    """Assign the properties of a widget that differ: nothing is sent twice."""
    for name, value in values.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)


def push_button(tab: Tab, label: str, action: Callable[[], None], **look: Any) -> Any:
    """Add a button that has the tab carry out ``action``; ``look`` as viser names it."""
    handle = tab.client.gui.add_button(label, **look)
    handle.on_click(lambda _: tab.act(action))
    return handle


def push_buttons(
    tab: Tab, label: str, options: tuple[str, ...], chosen: Callable[[str], None], **look: Any
) -> Any:
    """Add a row of buttons; ``chosen`` gets the text of the one that was clicked."""
    handle = tab.client.gui.add_button_group(label, options, **look)
    handle.on_click(lambda event: tab.act(lambda: chosen(event.target.value)))
    return handle


def differs(a: tuple[float, ...], b: tuple[float, ...], tolerance: float = 1e-6) -> bool:
    """True if two vectors of a widget differ by more than it shows."""
    return any(abs(x - y) > tolerance for x, y in zip(a, b, strict=True))


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


class Dialog:
    """A dialog over the picture, which a button or a key closes."""

    def __init__(self, tab: Tab) -> None:
        self._tab = tab
        self._modal: Any = None

    def _open(self, title: str) -> Any:
        """Begin another dialog; returns it, for its widgets."""
        self.close()
        self._modal = self._tab.client.gui.add_modal(title)
        return self._modal

    def _add_close(self, label: str) -> None:
        self._tab.client.gui.add_button(label, color="gray").on_click(self._close_clicked)

    def _close_clicked(self, _: Any) -> None:
        self.close()

    def close(self) -> bool:
        """Close the dialog; whether it was there."""
        modal, self._modal = self._modal, None
        if modal is not None:
            modal.close()
        return modal is not None


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


class Choice:
    """A dropdown, and a text box that shows where its last entry, “Other…”, is chosen.

    Args:
        labels: of the dropdown and of the text box.
        known: the entries of the list.
        current: the value that holds now.
        chosen: gets another one; None where nothing is chosen.
    """

    def __init__(
        self,
        tab: Tab,
        labels: tuple[str, str],
        known: tuple[str, ...],
        current: Callable[[], str | None],
        chosen: Callable[[str | None], None],
    ) -> None:
        self._known, self._current, self._chosen = known, current, chosen
        gui = tab.client.gui
        self._list = gui.add_dropdown(labels[0], (NONE, *known, OTHER), initial_value=NONE)
        self._box = gui.add_text(labels[1], "", visible=False)
        tab.on_update(self._list, self._picked)
        tab.on_update(self._box, self._typed)

    def _picked(self) -> None:
        option = self._list.value
        self._box.visible = option == OTHER
        if option != OTHER and option != self._option(self._current()):
            self._chosen(None if option == NONE else option)

    def _typed(self) -> None:
        if self._box.value.strip():
            self._chosen(self._box.value)

    def _option(self, value: str | None) -> str:
        """The entry for ``value``: "washing machine" is WashingMachine."""
        if value is None:
            return NONE
        said = value.replace(" ", "").lower()
        return next((k for k in self._known if k.lower() == said), OTHER)

    def offer(self, known: tuple[str, ...]) -> None:
        """Have other entries in the list."""
        if known != self._known:
            self._known = known
            self._list.options = (NONE, *known, OTHER)

    def show(self, value: str | None, visible: bool) -> None:
        """Show ``value`` in the list, or in the box where the list hasn't got it."""
        option = self._option(value)
        if self._list.value != option and not (value is None and self._list.value == OTHER):
            self._list.value = option
        other = option == OTHER
        put(self._box, visible=other and visible)
        if other:
            put(self._box, value=value)
        put(self._list, visible=visible)


def offered(own: tuple[str, ...], usual: tuple[str, ...], strict: bool) -> tuple[str, ...]:
    """A project's own names before the usual ones; those alone where no others are allowed."""
    return own if strict and own else tuple(dict.fromkeys((*own, *usual)))


class PredictButtons:
    """The same two buttons in the steps before the review."""

    def __init__(self, tab: Tab) -> None:
        self._tab = tab
        gui = tab.client.gui
        self._predict = gui.add_button(words.PREDICT, icon=viser.Icon.WAND, color="blue")
        self._here = gui.add_button(
            words.PREDICT_LOCALLY, icon=viser.Icon.CPU, color="gray", visible=False
        )
        self._predict.on_click(lambda _: tab.act(lambda: predict(tab)))
        self._here.on_click(lambda _: tab.act(lambda: predict(tab, here=True)))

    def show(self, visible: bool, color: Any = "blue") -> None:
        """Show or hide the first button; an accepted object has to be reopened first."""
        obj = self._tab.selection.object
        accepted = obj is not None and obj.document.review.state == "accepted"
        put(self._predict, visible=visible, disabled=accepted, color=color)

    def show_here(self, visible: bool) -> None:
        """Show or hide the second one."""
        put(self._here, visible=visible)


def predict(tab: Tab, *, here: bool = False) -> None:
    """Ask for the joints of the open object; ``here`` without the backend."""
    tab.selection.need_object().predict(tab.user, here=here)


class UserName:
    """The user's name; ``remember`` is called once it changed."""

    def __init__(self, tab: Tab, remember: Callable[[], None]) -> None:
        self._tab, self._remember = tab, remember
        if tab.account is not None:
            about = words.account(plain(tab.user), tab.account.role)
            tab.client.gui.add_markdown(about)
            self._box = None
            return
        self._box = tab.client.gui.add_text(words.USER_NAME, tab.user, hint=words.USER_NAME_HINT)
        tab.on_update(self._box, self._renamed)

    def show(self) -> None:
        """Put the name that the browser remembered into its box."""
        if self._box is not None:
            put(self._box, value=self._tab.user)

    def _renamed(self) -> None:
        if self._box is None:
            return
        user = cmd.clean_text(self._box.value, 60, "your name")
        if user:
            self._tab.user = user
            self._remember()
