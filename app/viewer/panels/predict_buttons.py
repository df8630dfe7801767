"""The buttons that predict joints: by the backend, or on this machine where that is away."""

from __future__ import annotations

from typing import Any

import viser

from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.words import common as words


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
        put(self._predict, "visible", visible)
        put(self._predict, "disabled", accepted)
        put(self._predict, "color", color)

    def show_here(self, visible: bool) -> None:
        """Show or hide the second one."""
        put(self._here, "visible", visible)


def predict(tab: Tab, *, here: bool = False) -> None:
    """Ask for the joints of the open object; ``here`` without the backend."""
    tab.selection.need_object().predict(tab.user, here=here)
