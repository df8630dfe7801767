"""The fields for motions of several joints, and for what a joint follows."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from app.viewer.panels.joint_editor import JointMotion
from app.viewer.words import joints as words
from app.viewer.words.common import NONE
from model.core.articulated_object import Prediction
from model.core.composite_joints import Composite
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree
from sessions.commands import RecordPrediction, RecordSegmentation, SetComposite, SetJoint
from sessions.document import prompts_key
from sessions.state import Context, SessionState, apply

CAP = Joint("cap", "continuous", "link_0", "link_1", (0, 0, 1))
GEAR = Joint("gear", "continuous", "link_0", "link_2", (0, 0, 1), (0.1, 0, 0))
TREE = KinematicTree(("link_0", "link_1", "link_2"), (CAP, GEAR))


class Fields:
    """Widgets by label, and the edits that they are wired to."""

    def __init__(self) -> None:
        self.of: dict[str, Any] = {}
        self.edits: dict[str, Any] = {}
        self.done: list[Any] = []
        me = Context("ann", "2026-01-01T00:00:00Z")
        state = SessionState()
        key = prompts_key(state.present)
        state = apply(state, RecordSegmentation(key, "ab" * 32, "s", 0.1, {0: 1, 1: 1, 2: 1}), me)
        self.state = apply(state, RecordPrediction(Prediction(TREE), "ab" * 32), me)
        self.joint = CAP
        gui = MagicMock(add_dropdown=self.add, add_number=self.add)
        tab: Any = SimpleNamespace(selection=self, client=MagicMock(gui=gui), do=self.do)
        self.me, self.panel = me, JointMotion(tab, self.wire)
        self.draw()

    @property
    def document(self) -> Any:
        return self.state.present

    def need_object(self) -> Fields:
        return self

    def add(self, label: str, value: Any, *_: Any, **__: Any) -> Any:
        self.of[label] = SimpleNamespace(
            value=value, options=(), visible=True, disabled=False, label=label
        )
        return self.of[label]

    def wire(self, field: Any, edit: Any) -> None:
        self.edits[field.label] = edit

    def do(self, command: Any) -> None:
        self.done.append(command)
        self.state = apply(self.state, command, self.me)
        self.joint = self.document.tree.joint_of[self.joint.child]

    def draw(self) -> None:
        self.panel.draw(self, self.document.tree, self.joint)  # type: ignore[arg-type]

    def set(self, label: str, value: Any) -> None:
        self.of[label].value = value
        self.edits[label]()
        self.draw()


@pytest.fixture
def fields() -> Fields:
    return Fields()


def test_a_cap_becomes_a_screw_with_a_pitch(fields: Fields) -> None:
    assert fields.of[words.MOTION].value == "One joint"
    assert not fields.of[words.PITCH].visible
    fields.set(words.MOTION, "Screw")
    assert fields.done == [SetComposite("link_1", Composite("screw", 0.004))]
    assert fields.of[words.PITCH].visible and fields.of[words.PITCH].value == 4.0
    fields.set(words.PITCH, -2.5)
    assert fields.done[1:] == [SetComposite("link_1", Composite("screw", -0.0025))]
    # The slide of the chain is the same part's.
    fields.joint = fields.document.tree.joint_of["helper_1"]
    fields.draw()
    assert fields.of[words.MOTION].value == "Screw"
    fields.set(words.MOTION, "Ball")
    assert fields.done[2] == SetComposite("link_1", Composite("ball"))


def test_a_gear_follows_another_with_a_ratio(fields: Fields) -> None:
    fields.joint = GEAR
    fields.draw()
    assert len(fields.of[words.FOLLOWS].options) == 2 and not fields.of[words.RATIO].visible
    fields.set(words.FOLLOWS, fields.of[words.FOLLOWS].options[1])
    assert fields.done == [SetJoint(replace(GEAR, mimic=Mimic("cap")))]
    assert fields.of[words.RATIO].visible
    fields.set(words.RATIO, -0.5)
    assert fields.document.tree.by_name["gear"].mimic == Mimic("cap", -0.5)
    fields.set(words.RATIO, -0.5)
    assert len(fields.done) == 2, "nothing changed"
    fields.set(words.FOLLOWS, NONE)
    assert fields.document.tree.by_name["gear"].mimic is None
