from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from app.server.gallery import UNKNOWN, ReviewOrder, confidence
from model.core.articulated_object import Prediction
from model.core.joint import Joint
from model.core.tree import KinematicTree
from sessions.database import ObjectRecord
from sessions.document import Document

TREE = KinematicTree(
    ("link_0", "link_1", "link_2", "link_3"),
    (
        Joint("a", "continuous", "link_0", "link_1"),
        Joint("b", "continuous", "link_0", "link_2"),
        Joint("c", "fixed", "link_0", "link_3"),
    ),
)


def predicted(a: float, b: float) -> Document:
    told = {"link_1": a, "link_2": b, "link_3": 0.01}
    return Document(tree=TREE, prediction=Prediction(TREE, confidence=told))


def record(number: int, state: str, seq: int = 1) -> ObjectRecord:
    known = (number, Path(f"{number}.ply"), str(number), None, state)
    return ObjectRecord(*known, 0, 0, None, "", "", "", None, seq)  # type: ignore[arg-type]


def test_the_least_sure_moving_joint_decides_and_a_hand_edit_is_sure():
    assert confidence(predicted(0.9, 0.4)) == 0.4
    assert confidence(Document()) == UNKNOWN
    mended = TREE.with_joint(replace(TREE.joints[1], axis=(1.0, 0.0, 0.0)))
    assert confidence(replace(predicted(0.9, 0.4), tree=mended)) == 0.9


def test_the_least_confident_prediction_comes_first():
    documents = {1: predicted(0.9, 0.9), 2: predicted(0.2, 0.9), 3: predicted(0.5, 0.9)}
    asked: list[int] = []

    def document(number: int) -> Document:
        asked.append(number)
        return documents[number]

    order = ReviewOrder(document)
    queue = [record(1, "predicted"), record(2, "predicted"), record(3, "predicted")]
    assert order.next(queue, 1) == 2
    assert order.next([queue[0], record(2, "accepted"), queue[2]], 2) == 3
    assert sorted(asked) == [1, 2, 3]  # nothing is read twice
    documents[1] = predicted(0.1, 0.1)
    assert order.next([record(1, "predicted", seq=2), queue[2]], 2) == 1


def test_what_is_to_be_looked_at_again_comes_before_what_is_new():
    order = ReviewOrder({1: predicted(0.9, 0.9), 2: predicted(0.1, 0.9)}.__getitem__)
    queue = [record(1, "predicted"), record(2, "predicted"), record(3, "todo")]
    assert order.next(queue, 3, again={1}) == 1
    assert order.next(queue, 3, {1}, {1}) == 2  # it was gone past


def test_where_nothing_is_predicted_the_next_unfinished_object_follows():
    order = ReviewOrder(lambda number: pytest.fail("no prediction needs to be read"))
    queue = [record(1, "todo"), record(2, "accepted"), record(3, "rejected"), record(4, "todo")]
    assert order.next(queue, 2) == 4
    assert order.next(queue, 4) == 1
    assert order.next([record(1, "accepted"), record(2, "accepted")], 1) is None


def test_what_was_skipped_comes_last():
    documents = {1: predicted(0.1, 0.9), 2: predicted(0.5, 0.9), 3: predicted(0.6, 0.9)}
    order = ReviewOrder(documents.__getitem__)
    queue = [record(1, "predicted"), record(2, "predicted"), record(3, "predicted")]
    assert order.next(queue, 2, {1}) == 3
    assert order.next([queue[0], record(2, "accepted"), record(3, "accepted")], 3, {1}) == 1
    queue = [record(1, "todo"), record(2, "todo"), record(3, "accepted"), record(4, "todo")]
    assert order.next(queue, 3, {1, 4}) == 2
    queue = [record(1, "todo"), record(2, "accepted"), record(3, "accepted"), record(4, "todo")]
    assert order.next(queue, 3, {1, 4}) == 4
    assert order.next([queue[0], record(4, "accepted")], 4, {1}) == 1
