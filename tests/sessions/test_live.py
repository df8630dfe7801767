"""The session loop: everybody sees the same, in order, whatever threads and processes do."""

import gc
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model.core.errors import CommandError, StoreError
from model.segmentation.prompts import Click
from sessions.commands import (
    AddClick,
    Command,
    NamePart,
    RecordPrediction,
    Reject,
    Saved,
    SetCategory,
    Undo,
    to_json,
)
from sessions.live import LiveSession, SessionHub
from sessions.store import ConflictError, Store


def click(part: int) -> AddClick:
    return AddClick(Click((0.0, 0.0, float(part)), part))


@pytest.fixture
def live(store: Store) -> LiveSession:
    return LiveSession(store, store.open_object(Path("oven.ply"), None, "oven").id)


def test_what_is_done_is_kept_and_told(live, store):
    heard = []
    unsubscribe = live.subscribe(lambda state, command: heard.append((state.seq, command)))
    state = live.do(click(1), "ann")
    assert state is live.state
    assert store.load(live.object_id) == state
    live.do(Undo(), "ann")
    unsubscribe()
    unsubscribe()
    live.do(click(2), "ann")
    assert heard == [(1, click(1)), (2, Undo())]


def test_a_refused_or_empty_command_is_neither_kept_nor_told(live, store):
    heard = []
    live.subscribe(lambda state, command: heard.append(command))
    before = live.state
    with pytest.raises(CommandError, match="no part 5"):
        live.do(NamePart(5, "door"), "ann")
    assert live.do(SetCategory(None), "ann") is before
    assert heard == []
    assert store.history(live.object_id) == []


def test_roles_are_checked(live):
    live.do(click(1), "ann", role="annotator")
    with pytest.raises(CommandError, match="only a reviewer"):
        live.do(Reject("axis"), "ann", role="annotator")


def test_subscribers_are_called_in_order_outside_of_the_lock(live):
    heard: list[int] = []

    def slow(state, command):
        # Another thread gets the lock meanwhile, or this would hang.
        thread = threading.Thread(target=lambda: live.state)
        thread.start()
        thread.join(timeout=5)
        assert not thread.is_alive()
        heard.append(state.seq)

    live.subscribe(slow)
    threads = [
        threading.Thread(target=lambda: [live.do(click(1), "ann") for _ in range(10)])
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert heard == list(range(1, 41))
    assert len(live.document.prompts) == 40


def test_a_subscriber_may_command(live):
    heard = []

    def answer(state, command):
        heard.append((state.seq, type(command).__name__))
        if isinstance(command, AddClick):
            live.do(NamePart(command.click.part, f"part {state.seq}"), "robot")

    live.subscribe(answer)
    live.subscribe(lambda state, command: heard.append((state.seq, "second")))
    live.do(click(1), "ann")
    assert heard == [(1, "AddClick"), (1, "second"), (2, "NamePart"), (2, "second")]


def test_a_failing_subscriber_costs_the_others_nothing(live, caplog):
    heard = []
    live.subscribe(lambda state, command: 1 / 0)
    live.subscribe(lambda state, command: heard.append(state.seq))
    live.do(click(1), "ann")
    live.do(click(2), "ann")
    assert heard == [1, 2]
    assert "division by zero" in caplog.text


def test_one_who_leaves_is_not_called_any_more(live):
    heard = []

    def leave_both(state, command):
        for leave in leaving:
            leave()

    leaving = [live.subscribe(leave_both), live.subscribe(lambda s, c: heard.append(s.seq))]
    live.do(click(1), "ann")
    assert heard == []


def test_all_tabs_share_one_session(store):
    hub = SessionHub(store)
    object_id = store.open_object(Path("oven.ply"), None, "oven").id
    first, second = hub.session(object_id), hub.session(object_id)
    assert first is second
    first.do(click(1), "ann")
    assert len(second.document.prompts) == 1
    del first, second
    gc.collect()
    assert len(hub.session(object_id).document.prompts) == 1, "read back from the store"
    with pytest.raises(StoreError, match="no object 99"):
        hub.session(99)


def test_another_server_is_followed(live, store):
    elsewhere = LiveSession(Store(store.workspace), live.object_id)
    heard = []
    live.subscribe(lambda state, command: heard.append((state.seq, command)))
    elsewhere.do(click(1), "rob")
    elsewhere.do(click(2), "rob")
    live.do(click(3), "ann")
    assert heard == [(1, click(1)), (2, click(2)), (3, click(3))]
    assert elsewhere.refresh() == live.state
    assert live.refresh() is live.state
    assert [e.who for e in store.history(live.object_id)] == ["rob", "rob", "ann"]
    elsewhere.store.close()


def test_a_command_that_another_server_made_impossible_is_refused_up_to_date(live, store):
    live.do(click(1), "ann")
    elsewhere = LiveSession(Store(store.workspace), live.object_id)
    elsewhere.do(Undo(), "rob")
    with pytest.raises(CommandError, match="nothing to undo"):
        live.do(Undo(), "ann")
    assert live.state.seq == 2
    elsewhere.store.close()


def test_a_store_that_fails_changes_nothing(live, store, monkeypatch):
    def fail(*_args: object, **_named: object) -> int:
        raise StoreError("no room is left on the disk")

    heard = []
    live.subscribe(lambda state, command: heard.append(command))
    live.do(click(1), "ann")
    before = live.state
    monkeypatch.setattr(store, "append", fail)
    with pytest.raises(StoreError, match="no room"):
        live.do(click(2), "ann")
    monkeypatch.undo()
    assert live.state is before
    assert live.do(click(2), "ann").seq == 2
    assert heard == [click(1), click(2)]


def test_endless_conflicts_end(live, store, monkeypatch):
    def conflict(*_args: object, **_named: object) -> int:
        raise ConflictError("again")

    monkeypatch.setattr(store, "append", conflict)
    monkeypatch.setattr("sessions.live.MAX_WAIT", 0.0)
    with pytest.raises(ConflictError):
        live.do(click(1), "ann")


def test_what_is_applied_is_what_was_written(live, store, prediction, labels_ref):
    live.do(AddClick(Click(tuple(np.float32([0.1, 0.2, 0.3])), np.int64(1))), "ann")
    assert live.document.key == store.load(live.object_id).present.key
    live.do(Saved("out"), "ann")
    live.do(RecordPrediction(prediction, labels_ref), "ann")
    assert store.load(live.object_id) == live.state


def test_an_announced_click_stays_while_it_is_stored(
    live: LiveSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody who reads meanwhile sees the object without it."""
    announced = live.announce(click(1), "tester")
    seen: list[int] = []

    def written(command: Command) -> Any:
        reader = threading.Thread(target=lambda: seen.append(len(live.document.prompts)))
        reader.start()
        reader.join()
        return to_json(command)

    monkeypatch.setattr("sessions.live.to_json", written)
    assert live.complete(announced, click(1))
    assert seen == [1] and len(live.document.prompts) == 1
