"""Whatever people do in whatever order: undo inverts, replay equals live, JSON keeps everything."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from model.core.articulated_object import Prediction
from model.core.errors import CommandError
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.live import LiveSession
from sessions.provenance import effective, provenance
from sessions.serialise import state_from_json, state_to_json
from sessions.state import Context, SessionState, apply, replay
from sessions.store import Store

parts = st.integers(0, 4)
links = st.integers(0, 4).map("link_{}".format)
refs = st.sampled_from(["ab" * 32, "cd" * 32])
shares = st.floats(0, 1)
coordinate = st.floats(-2, 2, allow_nan=False)
point = st.tuples(coordinate, coordinate, coordinate)
texts = st.sampled_from([None, "door", "Türe 門", 'a "quoted" \\ name'])
comments = st.text(max_size=20)
axes = st.sampled_from([(1.0, 0.0, 0.0), (0.0, 0.6, 0.8), (0.3, -0.2, 0.7)])


@st.composite
def joints(draw, child=links) -> Joint:
    name = draw(child)
    return Joint(
        draw(st.sampled_from(["a", "b", f"joint_{name}", f"new_{name}", f"joint_{name}"])),
        draw(st.sampled_from(["revolute", "continuous", "prismatic", "fixed"])),
        draw(links.filter(lambda n: n != name)),
        name,
        draw(axes),
        draw(point),
        -0.1,
        draw(st.floats(0, 3)),
    )


@st.composite
def predictions(draw) -> Prediction:
    if draw(st.integers(0, 5)) == 0:
        return Prediction(None, ("nothing found",), backend="geometric 1")
    tree = KinematicTree(
        tuple(f"link_{i}" for i in range(5)),
        tuple(
            replace(
                draw(joints(st.just(f"link_{i}"))),
                name=f"joint_link_{i}",
                parent=f"link_{draw(st.integers(0, i - 1))}",
            )
            for i in range(1, 5)
        ),
    )
    confidence = draw(st.dictionaries(links, st.floats(0, 1), max_size=3))
    return Prediction(tree, confidence=confidence, seconds=draw(st.floats(0, 9)))


places = st.builds(Click, point, parts, st.booleans(), st.none() | parts)
clicks = st.builds(cmd.AddClick, places)
counts = st.just(dict.fromkeys(range(5), 10)) | st.fixed_dictionaries(
    {i: st.integers(0, 3) for i in range(-1, 5)}
)
answers = st.builds(cmd.RecordSegmentation, st.just("?"), refs, st.just("walk"), coordinate, counts)
commands: st.SearchStrategy[cmd.Command] = st.one_of(
    clicks,
    st.builds(cmd.AddClick, places, answers),
    answers,
    answers,
    st.builds(cmd.AddRegion, parts, refs, st.booleans(), parts),
    st.builds(
        cmd.ApplyTool,
        st.just("cut"),
        st.lists(
            st.builds(cmd.ToolRegion, parts, refs, st.booleans(), parts, texts), max_size=3
        ).map(tuple),
        st.integers(0, 2),
        st.sampled_from([(), (1,), (3,)]),
    ),
    st.builds(cmd.LeaveOut, st.none() | refs, parts),
    st.builds(cmd.CropOut, st.just("oven"), st.just("/w/oven.ply"), refs, parts, point),
    st.builds(cmd.Placed, st.just("/w/room.ply"), st.just(""), refs, point),
    st.builds(cmd.SetArticulable, texts.filter(bool), st.none() | st.booleans()),
    st.builds(
        cmd.DecideObjects,
        st.sampled_from(["accept", "reject"]),
        st.tuples(parts),
        st.none() | shares,
    ),
    st.builds(cmd.RemovePrompt, parts, st.integers(1, 3)),
    st.builds(cmd.ClearPrompts, st.none() | parts),
    st.builds(cmd.AddPart, parts, texts),
    st.builds(cmd.NamePart, parts, texts),
    st.builds(cmd.DeletePart, st.integers(1, 4)),
    st.builds(cmd.SetCategory, texts),
    st.builds(cmd.SetCompletion, st.booleans()),
    st.builds(cmd.SetJoint, joints()),
    st.builds(cmd.SetFrame, st.sampled_from(["y", "-z"]), st.sampled_from([1.0, 0.001])),
    st.builds(cmd.RecordPrediction, predictions(), refs),
    st.builds(cmd.RecordPrediction, predictions(), refs),
    st.builds(cmd.SetJoint, joints()),
    st.builds(cmd.SetJoint, joints()),
    st.builds(cmd.SetRoot, links),
    st.builds(cmd.ResetJoint, links),
    st.builds(cmd.LockJoint, links, st.booleans()),
    st.builds(cmd.Accept, comments, st.just(("close",))),
    st.builds(cmd.Reject, st.just("axis"), comments),
    st.builds(cmd.Reopen, comments),
    st.builds(cmd.Saved, st.just("out")),
    st.builds(cmd.Undo),
    st.builds(cmd.Undo),
    st.builds(cmd.Redo),
)
start = st.tuples(
    clicks,
    st.just(cmd.RecordSegmentation("?", "ab" * 32, "walk", 0.1, dict.fromkeys(range(5), 10))),
    st.builds(cmd.RecordPrediction, predictions(), refs),
).map(list)
beginnings = st.just([]) | start | start.map(lambda done: [*done, cmd.Accept("fine")])


def begun(rest: st.SearchStrategy[list[cmd.Command]]) -> st.SearchStrategy[list[cmd.Command]]:
    """Left to chance alone, hardly any history would come as far as a tree."""
    return st.tuples(beginnings, rest).map(lambda both: [*both[0], *both[1]])


_NOTED = (cmd.RecordSegmentation, cmd.Saved, cmd.Placed)  # answers and facts, no steps
sequences = begun(st.lists(commands, min_size=12, max_size=50))
quick = settings(max_examples=35, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def contexts(index: int) -> Context:
    return Context(("ann", "rob")[index % 2], f"2030-01-01T00:{index // 60:02}:{index % 60:02}Z")


def meant(command: cmd.Command, state: SessionState) -> cmd.Command:
    """Most answers fit the prompts, as they do in life."""
    if isinstance(command, cmd.RecordSegmentation) and state.present.needs_labels:
        return replace(command, prompts_key=state.present.key)
    if isinstance(command, cmd.AddClick) and command.answer is not None:
        clicked = cmd.AddClick(command.click).edit(state.present, contexts(0))
        return replace(command, answer=replace(command.answer, prompts_key=clicked.key))
    return command


def play(sequence) -> tuple[SessionState, list[tuple[int, cmd.Command, Context]]]:
    state, log = SessionState(), []
    for i, raw in enumerate(sequence):
        command = meant(raw, state)
        try:
            after = apply(state, command, contexts(i))
        except CommandError:
            continue
        if after is not state:
            log.append((after.seq, command, contexts(i)))
        state = after
    return state, log


@quick
@given(sequences)
def test_replay_of_the_written_log_equals_live(sequence):
    state, log = play(sequence)
    assert [seq for seq, _, _ in log] == list(range(1, len(log) + 1))
    written = [(s, cmd.from_json(json.loads(json.dumps(cmd.to_json(c)))), x) for s, c, x in log]
    assert replay(written) == state


@quick
@given(sequences, commands)
def test_undo_inverts_every_step_and_redo_inverts_undo(sequence, last):
    before, _ = play(sequence)
    try:
        after = apply(before, meant(last, before), contexts(0))
    except CommandError:
        return
    if len(after.past) != len(before.past) + 1 or isinstance(last, cmd.Redo):
        return
    undone = apply(after, cmd.Undo(), contexts(1))
    assert (undone.present, undone.past) == (before.present, before.past)
    redone = apply(undone, cmd.Redo(), contexts(2))
    assert (redone.present, redone.past, redone.future) == (after.present, after.past, ())


@quick
@given(sequences)
def test_a_written_state_is_read_back_whole(sequence):
    state, _ = play(sequence)
    written = json.loads(json.dumps(state_to_json(state), allow_nan=False))
    assert state_from_json(written) == state


@quick
@given(sequences, st.floats(0, 1))
def test_a_snapshot_and_the_tail_equal_the_full_replay(sequence, where):
    state, log = play(sequence)
    cut = int(where * len(log))
    snapshot = json.loads(json.dumps(state_to_json(replay(log[:cut]))))
    assert replay(log[cut:], state_from_json(snapshot)) == state


@quick
@given(sequences)
def test_what_must_hold_of_every_document(sequence):
    state, _ = play(sequence)
    for document in (*state.past, state.present, *state.future):
        ids = [p.id for p in document.parts]
        assert ids == sorted(set(ids))
        assert ids[0] == 0
        assert {p.part for p in document.prompts} <= set(ids)
        assert document.next_part not in ids
        if document.tree is None:
            assert not document.locked
        else:
            assert document.locked <= set(document.tree.joint_of)
        if document.review.state in ("predicted", "accepted"):
            assert document.tree is not None
        if document.review.state == "accepted":
            assert document.segmentation_current


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(begun(st.lists(commands, min_size=40, max_size=80)))
def test_the_store_gives_back_what_was_live(sequence):
    with TemporaryDirectory() as folder, patch("sessions.store.SNAPSHOT_EVERY", 7):
        store = Store(Path(folder))
        live = LiveSession(store, store.open_object(Path("a.ply"), None, "a").id)
        for i, raw in enumerate(sequence):
            try:
                live.do(meant(raw, live.state), contexts(i).who)
            except CommandError:
                continue
        assert store.load(live.object_id) == live.state
        history = store.history(live.object_id)
        # The way back holds just the steps that are in force.
        steps = [e for e in effective(history) if not isinstance(e.command, _NOTED)]
        assert len(steps) == len(live.state.past) == live.document.edits
        json.dumps(provenance(live.state, history, None), allow_nan=False)
        record = store.object(live.object_id)
        assert record.seq == live.state.seq == len(history)
        assert (record.state, record.prompts) == (
            live.document.review.state,
            len(live.document.prompts),
        )
        store.close()
