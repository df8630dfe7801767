"""Marks of joints follow the pose; what is drawn goes to a client that only notes it."""

from __future__ import annotations

import math
import threading
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.server.display_tasks import PartPayload
from app.server.validating import JointCollision
from app.viewer.picture.marks import AxisMark, JointMarks
from app.viewer.picture.motion import Motion
from app.viewer.picture.object_nodes import MovingParts
from app.viewer.tab import Selection
from model.core.joint import Joint
from model.core.tree import KinematicTree

LOWER = Joint("lower", "revolute", "link_0", "link_1", (1, 0, 0), (0, 0, 0.1), -1.6, 1.6)
UPPER = Joint("upper", "revolute", "link_1", "link_2", (1, 0, 0), (0, 0, 0.6), -1.6, 1.6)
TREE = KinematicTree(("link_0", "link_1", "link_2"), (LOWER, UPPER))


class Notes:
    """A client whose scene keeps what was added by name, and counts it."""

    def __init__(self) -> None:
        self.nodes: dict[str, Any] = {}
        self.added = 0
        self.scene = self
        self.atomic = nullcontext
        self.add_arrows = self.add_icosphere = self.add_label = self._add
        self.add_frame = self.add_glb = self.add_mesh_simple = self._add

    def _add(self, name: str, *_: Any, position: Any = (0, 0, 0), **__: Any) -> Any:
        self.added += 1
        node = SimpleNamespace(wxyz=(1, 0, 0, 0), position=position, visible=True)
        node.remove = lambda: self.nodes.pop(name)
        self.nodes[name] = node
        return node


@pytest.fixture
def drawn() -> tuple[Notes, JointMarks]:
    client = Notes()
    marks = JointMarks(client, 1.0)  # type: ignore[arg-type]
    marks.show_axes(
        AxisMark(j.name, j.parent, j.origin, j.axis, 0.3, (0, 0, 0), False) for j in TREE.joints
    )
    return client, marks


def test_axes_move_with_what_the_joint_hangs_on(drawn: tuple[Notes, JointMarks]) -> None:
    client, marks = drawn
    before = client.added
    marks.pose(TREE.pose({"lower": math.pi / 2, "upper": 0.3}))
    upper, lower = client.nodes["/axis/upper"], client.nodes["/axis/lower"]
    half = math.sqrt(0.5)
    np.testing.assert_allclose(upper.wxyz, (half, half, 0, 0), atol=1e-9)
    np.testing.assert_allclose(upper.position, (0, 0.1, 0.1), atol=1e-9)
    np.testing.assert_allclose(lower.position, 0, atol=1e-9)
    marks.pose(TREE.pose({}))
    np.testing.assert_allclose(upper.position, 0, atol=1e-9)
    assert client.added == before  # a pose sends no geometry


def test_contacts_show_in_their_pose_alone(drawn: tuple[Notes, JointMarks]) -> None:
    client, marks = drawn
    where = (0.0, -0.2, 0.4)
    marks.show_contacts([JointCollision("upper", 1.2, 0.01, where, "link_1")], TREE)
    ball = client.nodes["/contact/0"]

    def shown(**q: float) -> bool:
        marks.pose(TREE.pose(q))
        return ball.visible

    assert not shown()
    assert not shown(upper=0.6)
    assert shown(upper=1.18)
    np.testing.assert_allclose(ball.position, where)
    # What carries both takes the mark along.
    assert shown(lower=math.pi / 2, upper=1.2)
    np.testing.assert_allclose(ball.position, (0.0, -0.3, -0.1), atol=1e-9)
    marks.show_contacts([], None)
    assert "/contact/0" not in client.nodes


def test_handles_go_with_what_the_joint_hangs_on_and_give_the_axis_at_rest() -> None:
    client = Notes()
    handles = SimpleNamespace(on_update=lambda callback: callback, remove=lambda: None)

    def add(name: str, **properties: Any) -> Any:
        vars(handles).update(properties)
        return handles

    client.add_transform_controls = add  # type: ignore[attr-defined]
    changed: list[Joint] = []
    selection = Selection(lambda: None, "the queue")
    selection.object = SimpleNamespace(  # type: ignore[assignment]
        document=SimpleNamespace(tree=TREE), asset=SimpleNamespace(diagonal=1.0)
    )
    selection.child = "link_2"
    tab: Any = SimpleNamespace(
        client=client, selection=selection, do=lambda command: changed.append(command.joint)
    )
    picture: Any = SimpleNamespace(parts=JointMarks(client), marks=JointMarks(client))  # type: ignore[arg-type]
    motion = Motion(tab, picture)
    motion.handles.on = True
    motion.q = {"lower": math.pi / 2}
    motion.handles.draw()
    np.testing.assert_allclose(handles.position, (0, -0.5, 0.1), atol=1e-9)
    with selection.lock:  # as while the screen is drawn
        posed = threading.Thread(target=motion.set_q, args=("lower", 0.0))
        posed.start()
        posed.join(0.1)
        np.testing.assert_allclose(handles.position, (0, -0.5, 0.1), atol=1e-9)
    posed.join()
    np.testing.assert_allclose(handles.position, UPPER.origin, atol=1e-9)
    motion.set_q("lower", math.pi / 2)
    handles.position = (0, -0.6, 0.1)  # a person pulls them on, by as far as the arm is long then
    motion.handles.release()
    np.testing.assert_allclose(changed[0].origin, (0, 0, 0.7), atol=1e-9)
    np.testing.assert_allclose(changed[0].axis, UPPER.axis, atol=1e-9)


def test_a_click_meets_the_part_where_it_is_now() -> None:
    flat = np.array([(-0.1, -0.1, 0.6), (0.1, -0.1, 0.6), (0, 0.1, 0.6)], np.float32)
    faces = np.array([(0, 1, 2)], np.int32)
    parts = MovingParts(Notes())  # type: ignore[arg-type]
    parts.draw([PartPayload(2, b"", None, None, flat, faces)])
    down = ((0, 0, 5), (0, 0, -1))
    assert parts.pick(*down, frozenset()) == 2
    assert parts.pick(*down, frozenset({2})) is None
    parts.pose(TREE.pose({"lower": math.pi / 2}))
    assert parts.pick(*down, frozenset()) is None
    assert parts.pick((0, -5, 0.1), (0, 1, 0), frozenset()) == 2
    # A few pixels beside it count too, where nothing else is met.
    parts.pose({})
    assert parts.pick((0, -0.115, 5), (0, 0, -1), frozenset()) == 2
    assert parts.pick((0, -0.13, 5), (0, 0, -1), frozenset()) is None


def test_directions_are_named_beside_the_object(drawn: tuple[Notes, JointMarks]) -> None:
    client, marks = drawn
    before = dict(client.nodes)
    marks.show_directions(np.array([1.0, 2.0, 3.0]))
    labels = [np.subtract(client.nodes[f"/direction/{k}"].position, (1, 2, 3)) for k in "XYZ"]
    assert [int(np.argmax(at)) for at in labels] == [0, 1, 2]
    added = client.added
    marks.show_directions(np.array([1.0, 2.0, 3.0]))
    assert client.added == added  # nothing is sent twice
    marks.pose(TREE.pose({"lower": 1.0}))
    marks.show_directions(None)
    assert client.nodes == before
