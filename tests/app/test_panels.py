"""The contract of panels: made of a tab alone, drawn of an object, nothing sent twice."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from app.viewer.client_app import PANELS
from app.viewer.tab import STEPS, Panel, Tab
from sessions.document import Document


class Widget(SimpleNamespace):
    """Counts what is sent."""

    def __setattr__(self, name: str, value: Any) -> None:
        vars(self)["sent"] = vars(self).get("sent", -1) + 1
        vars(self)[name] = value


@pytest.mark.parametrize(("step", "make"), PANELS)
def test_a_panel_sends_each_change_once(step: str, make: Callable[[Tab], Panel]) -> None:
    widget = Widget(content="")
    tab = MagicMock()
    tab.client.gui.add_markdown.return_value = widget
    obj: Any = MagicMock()
    obj.document, obj.record.id, obj.state.seq = Document(), 1, 0
    obj.services.store.history.return_value = []
    panel = make(tab)
    panel.draw(obj)
    sent = widget.sent
    panel.draw(obj)
    assert step in STEPS and widget.sent == sent
