"""What is decided about a scene as a whole."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from model.core.errors import CommandError
from sessions.commands import Undo, from_json, to_json
from sessions.document import DecisionRecord, Picked
from sessions.scene_commands import DecideObjects, PickOut, SetArticulable
from sessions.serialise import state_from_json, state_to_json
from sessions.state import Context, SessionState, apply

HERE = Context("ann", "2030-01-01T00:00:00Z")
PICK = PickOut("room", "oven 1", "oven", "/w/oven.ply", "/w/rest.ply", 70, (1, 2, 0), (1, 0, 0, 0),
               (0, 0, 0), (1, 0, 0, 0))  # fmt: skip


def test_what_a_person_says_of_an_object_stands_until_it_is_taken_back():
    state = apply(SessionState(), SetArticulable("table-1", True), HERE)
    assert state.present.articulable == {"table-1": True}
    assert state.present.label == "table-1 is articulable"
    assert apply(state, SetArticulable("table-1", True), HERE) is state
    both = apply(state, SetArticulable("fan", False), HERE)
    cleared = apply(both, SetArticulable("table-1", None), HERE)
    assert cleared.present.articulable == {"fan": False}
    assert apply(cleared, Undo(), HERE).present == both.present
    empty = SessionState()
    assert apply(empty, SetArticulable("table-1", None), HERE) is empty


def test_a_decision_for_several_is_one_step():
    state = apply(SessionState(), DecideObjects("accept", (4, 7), above=0.8), HERE)
    assert state.present.decided == (
        DecisionRecord("accept", (4, 7), 0.8, "other", HERE.who, HERE.at),
    )
    assert state.present.label == "accept 2 objects above 80 %"
    assert apply(state, Undo(), HERE).present.decided == ()
    with pytest.raises(CommandError, match="reviewer"):
        apply(state, DecideObjects("reject", (4,)), Context("bob", HERE.at, "annotator"))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SetArticulable("", True), "id"),
        (lambda: replace(PICK, id="room"), "of its own"),
        (lambda: replace(PICK, wxyz=(2, 0, 0, 0)), "unit quaternion"),
        (lambda: replace(PICK, position=(float("nan"), 0, 0)), "finite"),
        (lambda: DecideObjects("accept", ()), "at least one"),
        (lambda: DecideObjects("accept", (1, 1)), "different"),
        (lambda: DecideObjects("accept", (1,), above=1.5), "0..1"),
        (lambda: DecideObjects("maybe", (1,)), "accept or reject"),  # type: ignore[arg-type]
        (lambda: DecideObjects("reject", (1,), reason="ugly"), "reason"),  # type: ignore[arg-type]
    ],
)
def test_nonsense_is_refused(make, message):
    with pytest.raises(CommandError, match=message):
        make()


def test_what_is_picked_out_is_one_step_and_is_written():
    state = apply(SessionState(), PICK, HERE)
    assert (
        state.present.picked == (Picked(**vars(PICK)),)
        and state.present.label == "pick oven out of room"
    )
    assert from_json(json.loads(json.dumps(to_json(PICK)))) == PICK
    assert state_from_json(json.loads(json.dumps(state_to_json(state)))) == state
    assert apply(state, Undo(), HERE).present.picked == ()
    with pytest.raises(CommandError, match="already"):
        apply(state, PICK, HERE)
