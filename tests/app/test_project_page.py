"""Who may let predictions learn."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from app.viewer.panels.project_page import ProjectPage
from sessions.review import NotPermittedError


@pytest.mark.parametrize("role", ["annotator", "reviewer", "manager", None])
def test_only_managers_let_predictions_learn_whatever_a_script_sends(role: str | None) -> None:
    pressed: dict[str, Callable[[str], None]] = {}
    presses: Any = SimpleNamespace(on=lambda name, then, **_: pressed.setdefault(name, then))
    tab, app_state = MagicMock(), MagicMock()
    tab.account = None if role is None else SimpleNamespace(name="anna", role=role)
    ProjectPage(tab, app_state, presses, lambda _: None)
    if role in ("manager", None):
        pressed["project_learn"]("")
    else:
        with pytest.raises(NotPermittedError, match="only managers"):
            pressed["project_learn"]("")
    assert app_state.learning.start.called == (role in ("manager", None))
