"""What the editor of a joint makes of another type."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

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
def app(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A tab with a door that was predicted, whose geometry says a drawer."""
    app = SimpleNamespace(joint=DOOR, asked=[])

    def submit(task: Any, _source: Any, tree: KinematicTree, *rest: Any, **_: Any) -> Future[Joint]:
        app.asked.append((task, tree.joint_of["link_1"], *rest))
        done: Future[Joint] = Future()
        done.set_result(DRAWER)
        return done

    tree = KinematicTree(("link_0", "link_1"), (DOOR,))
    doc = Document(tree=tree, prediction=Prediction(tree))
    app.object = SimpleNamespace(document=doc, source=lambda: None)
    app.need_object = lambda: app.object
    app.set_joint = lambda joint: setattr(app, "joint", joint)
    app.app_state = SimpleNamespace(
        workers=SimpleNamespace(prediction=SimpleNamespace(submit=submit))
    )
    monkeypatch.setattr(JointEditor, "__init__", lambda self, app: setattr(self, "_app", app))
    return app


def test_a_door_made_a_drawer_takes_axis_and_range_from_the_geometry(app: Any) -> None:
    JointEditor(cast(Any, app)).set_type("prismatic")
    assert app.asked == [(snapping_tasks.retype_joint, DOOR, "link_1", "prismatic")]
    assert app.joint == DRAWER


def test_the_predicted_type_comes_back_as_predicted(app: Any) -> None:
    app.joint = replace(DRAWER, name="front")
    JointEditor(cast(Any, app)).set_type("revolute")
    assert app.joint == replace(DOOR, name="front")
    assert not app.asked
    app.joint = replace(DRAWER, parent="link_2")
    JointEditor(cast(Any, app)).set_type("revolute")
    assert app.asked, "the prediction is of a joint on another part"


def test_an_axis_is_shown_without_a_trace_of_the_other_side() -> None:
    box = SimpleNamespace(value=(0.0, 0.0, 1.0))
    _put_vector(box, (-1.0, -4e-5, -0.0), 5e-4)
    assert [str(v) for v in box.value] == ["-1.0", "0.0", "0.0"]
