"""What the editor of a joint makes of another type."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from app.server import part_tasks
from app.viewer.panels.joint_editor import JointEditor
from app.viewer.words.joints import AXIS
from model.core.articulated_object import Prediction
from model.core.errors import CommandError
from model.core.joint import Joint
from model.core.tree import KinematicTree
from sessions.document import Document

DOOR = Joint("j", "revolute", "link_0", "link_1", (0, 0, 1), (0.1, 0.2, 0.0), 0.0, 1.65)
DRAWER = replace(DOOR, type="prismatic", axis=(-1, 0, 0), lower=0.0, upper=0.4)


@pytest.fixture
def editor() -> Any:
    """Edits a door that was predicted, whose geometry says a drawer.

    It also has what it ``asked`` for, its ``vectors`` by label, and its ``selection``.
    """
    asked: list[Any] = []
    vectors: dict[str, Any] = {}

    def add_vector(label: str, value: Any, **_: Any) -> Any:
        vectors[label] = SimpleNamespace(value=value, visible=True, disabled=False)
        return vectors[label]

    def submit(task: Any, _source: Any, tree: KinematicTree, *rest: Any, **_: Any) -> Future[Joint]:
        asked.append((task, tree.joint_of["link_1"], *rest))
        done: Future[Joint] = Future()
        done.set_result(DRAWER)
        return done

    tree = KinematicTree(("link_0", "link_1"), (DOOR,))
    doc = Document(tree=tree, prediction=Prediction(tree))
    obj = SimpleNamespace(document=doc, source=lambda: None, checks=[])
    selection = SimpleNamespace(joint=DOOR, need_object=lambda: obj, choose_joint=str)
    tab = MagicMock(selection=selection)
    tab.do = lambda command: setattr(selection, "joint", command.joint)
    tab.client.gui.add_vector3 = add_vector
    worker: Any = SimpleNamespace(submit=submit)
    editor: Any = JointEditor(tab, MagicMock(), worker, lambda: None)
    editor.asked, editor.vectors, editor.selection = asked, vectors, selection
    return editor


def test_a_door_made_a_drawer_takes_axis_and_range_from_the_geometry(editor: Any) -> None:
    editor.set_type("prismatic")
    assert editor.asked == [(part_tasks.change_type, DOOR, "link_1", "prismatic")]
    assert editor.selection.joint == DRAWER


def test_the_predicted_type_comes_back_as_predicted(editor: Any) -> None:
    editor.selection.joint = replace(DRAWER, name="front")
    editor.set_type("revolute")
    assert editor.selection.joint == replace(DOOR, name="front")
    assert not editor.asked
    editor.selection.joint = replace(DRAWER, parent="link_2")
    editor.set_type("revolute")
    assert editor.asked, "the prediction is of a joint on another part"


def test_the_likely_motions_of_a_prediction_come_one_after_the_other(editor: Any) -> None:
    with pytest.raises(CommandError, match="no other motion"):
        editor.next_likely()
    obj = editor.selection.need_object()
    other_side = replace(DOOR, axis=(0, 0, -1), origin=(0.5, 0.2, 0.0))
    prediction = Prediction(obj.document.tree, alternatives={"link_1": (other_side, DRAWER)})
    obj.document = replace(obj.document, prediction=prediction)
    editor.selection.joint = replace(DOOR, name="front", upper=0.3)  # the range was edited
    taken = []
    for _ in range(3):
        editor.next_likely()
        taken.append(editor.selection.joint)
    assert taken == [replace(j, name="front") for j in (other_side, DRAWER, DOOR)]
    editor.selection.joint = replace(DOOR, axis=(1, 0, 0))  # by hand, none of them
    editor.next_likely()
    assert editor.selection.joint == DOOR
    editor.selection.joint = replace(DOOR, parent="link_7")
    editor.next_likely()
    assert editor.selection.joint == replace(other_side, parent="link_7"), "the parent stays"
    editor.selection.joint = replace(DOOR, parent="helper_1")
    with pytest.raises(CommandError, match="no other motion"):
        editor.next_likely()


def test_an_axis_is_shown_without_a_trace_of_the_other_side(editor: Any) -> None:
    joint = editor.selection.joint = replace(DOOR, axis=(-1.0, -4e-5, -0.0))
    tree = KinematicTree(("link_0", "link_1"), (joint,))
    editor.draw(editor.selection.need_object(), tree)
    assert [str(v) for v in editor.vectors[AXIS].value] == ["-1.0", "0.0", "0.0"]
