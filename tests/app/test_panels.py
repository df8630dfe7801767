"""The contract of panels: made of a tab alone, drawn of an object, nothing sent twice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from app.server.validating import alike
from app.viewer.client_app import PANELS
from app.viewer.tab import STEPS, Panel, Tab
from model.core.joint import Joint
from model.validation.report import Finding, Fix, JointReport, Severity, ValidationReport
from sessions.document import Document, PartInfo


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


def test_parts_of_one_name_with_the_same_finding_are_one_group() -> None:
    """Four correct knobs were four warnings; what has a fix to choose stays by itself."""
    names = {1: "knob", 2: "knob", 3: "knob", 4: "door", 5: None, 6: None}
    doc = Document(parts=tuple(PartInfo(i, name) for i, name in names.items()))
    low = Finding("unsure", Severity.WARNING, "Low confidence (35 %).")
    hits = Finding("collision", Severity.WARNING, "Penetrates base by 3 mm.")
    joint = Joint("j3", "revolute", "link_0", "link_3", lower=0, upper=1)
    reports = [JointReport(f"j{i}", f"link_{i}", (low,)) for i in names]
    reports[2] = replace(reports[2], findings=(hits,), fixes=(Fix("limits", joint, "Set."),))
    report = ValidationReport((*reports, JointReport("j7", "link_7")), 1.0)
    groups = [[j.joint for j in group] for group in alike(doc, report, Severity.WARNING)]
    assert groups == [["j1", "j2"], ["j3"], ["j4"], ["j5"], ["j6"]]
    assert alike(doc, report, Severity.ERROR) == []
