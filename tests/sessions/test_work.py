"""Assignments, leases and presence, and the way of a submitted object."""

import threading
from pathlib import Path

import pytest

from model.core.errors import CommandError, ConfigurationError
from model.segmentation.prompts import Click
from sessions import people as work_module
from sessions.commands import AddClick, RecordPrediction, RecordSegmentation, Reject, Submit, Undo
from sessions.live import LiveSession
from sessions.review import NotPermittedError
from sessions.store import Store

CLICK = AddClick(Click((0.0, 0.0, 0.0), 1))


@pytest.fixture
def objects(store: Store) -> list[int]:
    paths = [Path(f"/scans/{name}.ply") for name in ("oven", "safe", "lamp")]
    return [r.id for r in store.open_objects((p, None, p.stem) for p in paths)]


def account(people, name: str):
    return people.accounts.find(name)


def test_two_get_different_objects_and_nobody_the_same(store, people, objects):
    work = people.work
    assert work.next(account(people, "ann"), store.objects()) == objects[0]
    assert work.next(account(people, "bob"), store.objects()) == objects[1]
    assert work.next(account(people, "ann"), store.objects()) == objects[0], "she has it already"


def test_twenty_at_once_get_one_object_each_or_none(store, people, objects):
    accounts = [
        people.accounts.add(f"worker {k}", "annotator", "a long password") for k in range(20)
    ]
    records, given = store.objects(), []

    def ask(one) -> None:
        given.append(people.work.next(one, records))

    threads = [threading.Thread(target=ask, args=(one,)) for one in accounts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(given) == 20
    assert sorted(g for g in given if g is not None) == objects


def test_another_annotator_is_kept_out_while_one_works(store, people, objects):
    live = LiveSession(store, objects[0])
    live.do(CLICK, "ann")
    with pytest.raises(NotPermittedError, match="ann works on this object now"):
        live.do(CLICK, "bob")
    live.do(CLICK, "rob")  # who reviews may
    assert [(p.name, p.leased) for p in people.work.present(objects[0])] == [("ann", True)]
    people.work.leave(objects[0], account(people, "ann"))
    live.do(CLICK, "bob")


def test_a_lease_ends_by_itself_and_lasts_with_each_decision(store, people, objects, monkeypatch):
    live = LiveSession(store, objects[0])
    monkeypatch.setattr(work_module, "LEASE_SECONDS", -1.0)
    live.do(CLICK, "ann")
    live.do(CLICK, "bob")
    monkeypatch.undo()
    live.do(CLICK, "bob")
    with pytest.raises(CommandError, match="bob works"):
        live.do(CLICK, "ann")


def test_presence_alone_keeps_nobody_out(store, people, objects):
    people.work.enter(objects[0], account(people, "ann"))
    people.work.enter(objects[0], account(people, "bob"))
    assert [p.name for p in people.work.present(objects[0])] == ["ann", "bob"]
    LiveSession(store, objects[0]).do(CLICK, "bob")


def test_assignment_by_hand_and_in_turn(store, people, objects):
    ann, bob = account(people, "ann"), account(people, "bob")
    assert people.work.assign(objects, [ann, bob], "mia") == dict(
        zip(objects, ("ann", "bob", "ann"), strict=True)
    )
    assert people.work.next(bob, store.objects()) == objects[1]
    with pytest.raises(CommandError, match="assigned to ann"):
        LiveSession(store, objects[0]).do(CLICK, "bob")
    people.work.assign([objects[0]], [], "mia")
    assert people.work.assigned() == {objects[1]: "bob", objects[2]: "ann"}
    assert people.work.next(ann, store.objects()) == objects[2], "what is assigned comes first"
    with pytest.raises(ConfigurationError, match="no object 99"):
        people.work.assign([99], [ann], "mia")
    for by in ("ann", "rob", "nobody"):
        with pytest.raises(NotPermittedError, match="only a manager"):
            people.work.assign(objects, [ann], by)
    people.accounts.disable("bob")
    with pytest.raises(ConfigurationError, match="disabled"):
        people.work.assign(objects, [account(people, "bob")], "mia")


@pytest.fixture
def predicted(store, objects, prediction, labels_ref) -> LiveSession:
    """The second object, with parts and joints by ann."""
    live = LiveSession(store, objects[1])
    live.do(CLICK, "ann")
    counts = {k: 10 for k in range(5)}
    key = live.document.key
    live.do(RecordSegmentation(key, labels_ref, "default", 0.1, counts), "segmenter")
    live.do(RecordPrediction(prediction, labels_ref), "ann")
    return live


def test_submitted_sent_back_and_first_in_the_annotators_queue(store, people, objects, predicted):
    predicted.do(Submit("look at the door"), "ann")
    review = predicted.document.review
    assert (review.state, review.by, review.comment) == ("submitted", "ann", "look at the door")
    rob = account(people, "rob")
    assert people.work.next(rob, store.objects()) == objects[1], "what waits for review comes first"
    back = Reject("axis", "the axis is off", joint="link_1", place=(0.1, 0.2, 0.3))
    review = predicted.do(back, "rob").present.review
    assert (review.reason, review.joint, review.place) == ("axis", "link_1", (0.1, 0.2, 0.3))
    assert store.load(objects[1]).present.review == review, "it is read back alike"
    assert people.work.next(account(people, "bob"), store.objects()) == objects[0]
    assert people.work.next(account(people, "ann"), store.objects()) == objects[1]


def test_an_annotator_neither_undoes_a_rejection_nor_submits_what_is_not_done(
    store, people, objects, predicted
):
    predicted.do(Submit(), "ann")
    predicted.do(Reject("axis"), "rob")
    with pytest.raises(CommandError, match="only a reviewer may undo"):
        predicted.do(Undo(), "ann")
    with pytest.raises(CommandError, match="can't submit: there is no kinematic tree"):
        LiveSession(store, objects[0]).do(Submit(), "ann")
    with pytest.raises(CommandError, match="has no joint here"):
        predicted.do(Reject("axis", joint="link_9"), "rob")


def test_an_annotator_may_take_a_submission_back(predicted):
    predicted.do(Submit(), "ann")
    assert predicted.do(Undo(), "ann").present.review.state == "predicted"
    predicted.do(Submit(), "ann")
    assert predicted.do(CLICK, "ann").present.review.state == "in_progress"
