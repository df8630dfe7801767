"""What the editor of a joint makes of another type."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from app.server import snapping_tasks
from app.viewer.panels.joint_editor import JointEditor, _put_vector
from model.core.articulated_object import Prediction
from model.core.joint import Joint
from model.core.tree import KinematicTree
from sessions.document import Document

DOOR = Joint("j", "revolute", "link_0", "link_1", (0, 0, 1), (0.1, 0.2, 0.0), 0.0, 1.65)
DRAWER = replace(DOOR, type="prismatic", axis=(-1, 0, 0), lower=0.0, upper=0.4)


@pytest.fixture
def editor(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Edits a door that was predicted, whose geometry says a drawer."""
    monkeypatch.setattr(JointEditor, "__init__", lambda self: None)
    editor: Any = JointEditor()  # type: ignore[call-arg]
    editor.asked = []

    def submit(task: Any, _source: Any, tree: KinematicTree, *rest: Any, **_: Any) -> Future[Joint]:
        editor.asked.append((task, tree.joint_of["link_1"], *rest))
        done: Future[Joint] = Future()
        done.set_result(DRAWER)
        return done

    tree = KinematicTree(("link_0", "link_1"), (DOOR,))
    doc = Document(tree=tree, prediction=Prediction(tree))
    obj = SimpleNamespace(document=doc, source=lambda: None)
    selection = SimpleNamespace(joint=DOOR, need_object=lambda: obj)
    editor._tab = SimpleNamespace(
        selection=selection, do=lambda command: setattr(selection, "joint", command.joint)
    )
    editor._worker = SimpleNamespace(submit=submit)
    editor.selection = selection
    return editor


def test_a_door_made_a_drawer_takes_axis_and_range_from_the_geometry(editor: Any) -> None:
    editor.set_type("prismatic")
    assert editor.asked == [(snapping_tasks.change_type, DOOR, "link_1", "prismatic")]
    assert editor.selection.joint == DRAWER


def test_the_predicted_type_comes_back_as_predicted(editor: Any) -> None:
    editor.selection.joint = replace(DRAWER, name="front")
    editor.set_type("revolute")
    assert editor.selection.joint == replace(DOOR, name="front")
    assert not editor.asked
    editor.selection.joint = replace(DRAWER, parent="link_2")
    editor.set_type("revolute")
    assert editor.asked, "the prediction is of a joint on another part"


def test_an_axis_is_shown_without_a_trace_of_the_other_side() -> None:
    box = SimpleNamespace(value=(0.0, 0.0, 1.0))
    _put_vector(box, (-1.0, -4e-5, -0.0), 5e-4)
    assert [str(v) for v in box.value] == ["-1.0", "0.0", "0.0"]
