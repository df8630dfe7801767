"""What commands make of a session, as a person meets it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from model.core.articulated_object import Prediction
from model.core.composite_joints import Composite, composite_of
from model.core.errors import CommandError
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree
from model.segmentation.prompts import Click
from sessions.commands import (
    Accept,
    AddClick,
    AddPart,
    AddRegion,
    ClearPrompts,
    DeletePart,
    LockJoint,
    NamePart,
    RecordPrediction,
    RecordSegmentation,
    Redo,
    Reject,
    RemovePrompt,
    Reopen,
    ResetJoint,
    Saved,
    SetCategory,
    SetCompletion,
    SetComposite,
    SetFrame,
    SetJoint,
    SetRoot,
    Undo,
)
from sessions.document import PartInfo
from sessions.state import (
    MAX_UNDO,
    Context,
    SessionState,
    acceptance_problems,
    apply,
    needed_jobs,
    prompts_key,
    review_problems,
)
from sessions.tree_edits import holds_part

REF = "ab" * 32
OTHER_REF = "cd" * 32
FIVE = {0: 10, 1: 10, 2: 10, 3: 10, 4: 10}
ME = Context("ann", "2030-01-01T00:00:00.000000Z")
REVIEWER = Context("rob", "2030-01-02T00:00:00.000000Z")


def click(part: int, x: float = 0.0, positive: bool = True) -> AddClick:
    return AddClick(Click((x, 0.0, 0.0), part, positive))


def run(*commands, state: SessionState | None = None, context: Context = ME) -> SessionState:
    state = SessionState() if state is None else state
    for command in commands:
        state = apply(state, command, context)
    return state


def segmented(state: SessionState, ref: str = REF, counts=None) -> SessionState:
    counts = FIVE if counts is None else counts
    return run(
        RecordSegmentation(prompts_key(state.present), ref, "walk", 0.1, counts), state=state
    )


@pytest.fixture
def predicted(prediction: Prediction) -> SessionState:
    clicks = run(*(click(part) for part in (1, 2, 3, 4)))
    return run(RecordPrediction(prediction, REF), state=segmented(clicks))


def test_a_click_makes_its_part_and_asks_for_labels():
    state = run(click(2))
    assert state.present.parts == (PartInfo(0), PartInfo(2))
    assert state.present.next_part == 1
    assert state.present.review.state == "in_progress"
    assert [job.prompts_key for job in needed_jobs(state)] == [prompts_key(state.present)]
    assert not needed_jobs(segmented(state))
    assert not needed_jobs(SessionState())


def test_a_late_answer_is_ignored():
    first = run(click(1))
    second = run(click(2), state=first)
    late = RecordSegmentation(prompts_key(first.present), REF, "walk", 0.1, FIVE)
    assert apply(second, late, ME) is second
    assert apply(first, late, ME).present.segmentation_current


def test_labels_are_no_step_and_keep_the_way_forward():
    state = segmented(run(click(1)))
    state = run(click(2), Undo(), state=state)
    assert state.present.segmentation_current, "the labels came back with the prompts"
    state = segmented(state, OTHER_REF)
    assert state.redo_label == "Redo: add click, part 2"
    state = run(Redo(), state=state)
    assert len(state.present.prompts) == 2
    assert needed_jobs(state)


def test_undo_and_redo_walk_over_everything(predicted, cabinet):
    joint = replace(cabinet.joint_of["link_1"], upper=1.0)
    commands = (
        SetJoint(joint),
        NamePart(1, "door"),
        SetCategory("cabinet"),
        LockJoint("link_1", True),
        SetRoot("link_1"),
        SetCompletion(False),
        Accept("good"),
    )
    states = [predicted]
    for command in commands:
        states.append(run(command, state=states[-1]))
    state = states[-1]
    for former in reversed(states[:-1]):
        state = run(Undo(), state=state)
        assert state.present == former.present
        assert state.past == former.past
    for later in states[1:]:
        state = run(Redo(), state=state)
        assert state.present == later.present
    assert not state.can_redo
    with pytest.raises(CommandError, match="nothing to redo"):
        run(Redo(), state=state)
    with pytest.raises(CommandError, match="nothing to undo"):
        run(Undo())


def test_a_new_step_closes_the_way_forward():
    state = run(click(1), Undo(), click(2))
    assert not state.can_redo
    assert state.undo_label == "Undo: add click, part 2"
    assert state.seq == 3


def test_the_way_back_is_bounded():
    state = run(*(click(1, float(i)) for i in range(MAX_UNDO + 5)))
    assert len(state.past) == MAX_UNDO
    state = run(*[Undo()] * MAX_UNDO, state=state)
    assert len(state.present.prompts) == 5
    assert not state.can_undo


@pytest.mark.parametrize(
    "command",
    [
        NamePart(0, None),
        SetCategory(None),
        ClearPrompts(),
        ClearPrompts(3),
        LockJoint("link_1", False),
        SetRoot("link_0"),
        ResetJoint("link_1"),
    ],
    ids=lambda c: type(c).__name__,
)
def test_what_changes_nothing_is_no_step(command, predicted):
    empty = command if not isinstance(command, ClearPrompts) else None
    state = predicted if empty else SessionState()
    assert apply(state, command, ME) is state


def test_prompts_are_removed_and_cleared():
    state = segmented(run(click(1), click(2, 1.0), AddRegion(2, REF, count=3), click(3)))
    key = prompts_key(state.present)
    fewer = run(RemovePrompt(1), state=state)
    assert [p.part for p in fewer.present.prompts] == [1, 2, 3]
    assert not fewer.present.segmentation_current
    assert prompts_key(fewer.present) != key
    assert [p.part for p in run(ClearPrompts(2), state=state).present.prompts] == [1, 3]
    none = run(ClearPrompts(), state=state)
    assert none.present.prompts == ()
    assert none.present.segmentation is None
    assert not needed_jobs(none)
    with pytest.raises(CommandError, match=r"no prompt 4; there are prompts 0\.\.3"):
        run(RemovePrompt(4), state=state)
    with pytest.raises(CommandError, match="no prompt 0; there are no prompts"):
        run(RemovePrompt(0))


def test_prompts_that_belong_together_are_removed_in_one_step():
    state = run(click(1), click(2), AddRegion(2, REF, count=3), click(3))
    fewer = run(RemovePrompt(1, 2), state=state)
    assert [p.part for p in fewer.present.prompts] == [1, 3]
    assert run(Undo(), state=fewer).present == state.present
    with pytest.raises(CommandError, match=r"no prompt 4; there are prompts 0\.\.3"):
        run(RemovePrompt(2, 3), state=state)
    with pytest.raises(CommandError, match="1 or more"):
        RemovePrompt(1, 0)


def test_the_key_tells_prompts_and_frames_apart():
    commands = [
        [click(1)],
        [click(1, positive=False)],
        [click(2)],
        [click(1), click(1)],
        [AddClick(Click((0.0, 0.0, 0.0), 1, element=4))],
        [AddRegion(1, REF)],
        [AddRegion(1, OTHER_REF)],
        [SetFrame("y", 1.0), click(1)],
        [SetFrame("y", 0.01), click(1)],
    ]
    keys = [prompts_key(run(*c).present) for c in commands]
    assert len(set(keys)) == len(keys)
    again = run(click(1), click(2), RemovePrompt(1), NamePart(1, "door"))
    assert prompts_key(again.present) == keys[0]


def test_parts_are_added_named_and_deleted():
    state = run(AddPart(1, "door"), AddPart(3), NamePart(3, "knob"))
    assert state.present.part_names == {1: "door", 3: "knob"}
    assert state.present.next_part == 2
    with pytest.raises(CommandError, match="part 1 exists already; part 2 is free"):
        run(AddPart(1), state=state)
    with pytest.raises(CommandError, match="no part 7; there are 0, 1, 3"):
        run(NamePart(7, "x"), state=state)
    with pytest.raises(CommandError, match="no part 7"):
        run(DeletePart(7), state=state)
    state = run(click(1), click(3), DeletePart(1), state=state)
    assert [p.id for p in state.present.parts] == [0, 3]
    assert [p.part for p in state.present.prompts] == [3]


def test_a_deleted_part_leaves_the_tree(predicted):
    state = run(LockJoint("link_1", True), LockJoint("link_3", True), state=predicted)
    state = run(DeletePart(1), state=state)
    tree = state.present.tree
    assert tree is not None
    assert "link_1" not in tree.links
    assert tree.joint_of["link_2"].parent == "link_0"
    assert state.present.locked == {"link_3"}
    assert state.present.prediction_stale
    state = segmented(state, OTHER_REF, {0: 10, 2: 10, 3: 10, 4: 10})
    assert run(Accept(), state=state).present.review.state == "accepted"


def test_another_frame_starts_afresh_but_keeps_names(predicted):
    state = run(NamePart(1, "door"), SetFrame("y", 0.001), state=predicted)
    document = state.present
    assert (document.up_axis, document.unit_scale) == ("y", 0.001)
    assert (document.prompts, document.segmentation, document.tree) == ((), None, None)
    assert document.part_names == {1: "door"}
    assert document.review.state == "in_progress"
    assert run(Undo(), state=state).present.tree is not None


def test_a_prediction_sets_the_tree(predicted, prediction):
    document = predicted.present
    assert document.tree == prediction.tree
    assert document.review.state == "predicted"
    assert not document.prediction_stale
    assert document.edited_joints == ()
    assert predicted.undo_label == "Undo: prediction"
    assert run(Undo(), state=predicted).present.tree is None


def test_a_prediction_for_parts_that_are_gone_is_ignored(prediction):
    state = run(click(1), ClearPrompts())
    assert apply(state, RecordPrediction(prediction, REF), ME) is state


def test_a_failed_prediction_keeps_the_tree(predicted):
    failed = Prediction(None, problems=("no hinge found",), backend="geometric 1")
    state = run(RecordPrediction(failed, OTHER_REF), state=predicted)
    assert state.present.tree == predicted.present.tree
    assert state.present.prediction == failed
    assert state.present.prediction_for == REF


def test_new_labels_make_the_prediction_stale(predicted):
    state = run(click(1, 5.0), state=predicted)
    assert state.present.prediction_stale
    assert state.present.review.state == "in_progress"
    assert not segmented(state, REF).present.prediction_stale, "the same labels again"
    assert segmented(state, OTHER_REF).present.prediction_stale


def test_joint_edits_are_told_from_the_prediction(predicted, cabinet):
    flipped = cabinet.joint_of["link_1"].flipped()
    state = run(SetJoint(flipped), state=predicted)
    assert state.present.edited_joints == ("link_1",)
    assert state.present.review.state == "predicted"
    assert state.present.joint_edits == 1
    back = run(ResetJoint("link_1"), state=state)
    assert back.present.tree == cabinet
    assert back.present.edited_joints == ()
    with pytest.raises(CommandError, match="no joint was predicted for 'link_0'"):
        run(ResetJoint("link_0"), state=state)
    with pytest.raises(CommandError, match="'turn' is there twice"):
        run(SetJoint(replace(flipped, name="turn")), state=state)
    with pytest.raises(CommandError, match="no kinematic tree"):
        run(SetJoint(flipped))


def test_locked_joints_go_to_the_next_prediction_and_follow_the_root(predicted, cabinet):
    state = run(LockJoint("link_1", True), LockJoint("link_4", True), state=predicted)
    assert [j.name for j in state.present.locked_joints] == ["hinge", "spin"]
    turned = run(SetRoot("link_2"), state=state)
    assert turned.present.tree is not None
    assert turned.present.tree.root == "link_2"
    assert [j.name for j in turned.present.locked_joints] == ["hinge", "spin"]
    smaller = Prediction(
        type(cabinet)(("link_0", "link_1"), (Joint("a", "fixed", "link_0", "link_1"),))
    )
    assert run(RecordPrediction(smaller, REF), state=state).present.locked == {"link_1"}
    with pytest.raises(CommandError, match="'link_7'"):
        run(LockJoint("link_7", True), state=predicted)


def test_accept_undo_reject_reopen(predicted):
    accepted = run(Accept("fine", ("touches at 0.2 rad",)), state=predicted, context=REVIEWER)
    review = accepted.present.review
    assert (review.state, review.by, review.at) == ("accepted", "rob", REVIEWER.at)
    assert (review.comment, review.problems) == ("fine", ("touches at 0.2 rad",))
    assert run(Undo(), state=accepted).present.review == predicted.present.review
    with pytest.raises(CommandError, match="reopen it"):
        run(click(1), state=accepted)
    rejected = run(Reject("axis", "door hangs left"), state=accepted, context=REVIEWER)
    assert rejected.present.review.reason == "axis"
    assert rejected.present.annotator == "ann", "it goes back to who worked on the parts"
    mended = run(click(1, 3.0), state=rejected)
    assert mended.present.review.state == "in_progress"
    assert mended.present.review.comment == "door hangs left", "still to be read while mending"
    reopened = run(Reopen("new scan"), state=accepted)
    assert reopened.present.review.state == "in_progress"


def test_what_keeps_an_object_from_being_accepted(predicted):
    assert acceptance_problems(predicted.present) == ()
    for state, words in (
        (SessionState(), "predict it first"),
        (run(click(1, 9.0), state=predicted), "still being computed"),
        (
            segmented(run(click(1, 9.0), state=predicted), OTHER_REF, FIVE | {3: 0}),
            "link_3 is in the kinematic tree but has no points",
        ),
    ):
        assert words in "; ".join(acceptance_problems(state.present))
        with pytest.raises(CommandError, match=words):
            run(Accept(), state=state if state.seq else run(click(1)))


def test_outdated_joints_and_empty_parts_keep_a_person_from_accepting(predicted):
    assert review_problems(predicted.present) == ()
    moved = segmented(run(click(1, 9.0), state=predicted), OTHER_REF, FIVE)
    assert acceptance_problems(moved.present) == ()
    assert "predict again" in review_problems(moved.present)[0]
    added = run(AddPart(7, "knob"), state=predicted)
    assert review_problems(added.present) == ("part 7 (knob) is empty: click on it, or delete it",)
    # What was accepted before is still read.
    assert run(Accept(), state=moved).present.review.state == "accepted"


def test_unassigned_elements_count_for_the_base(predicted):
    state = run(click(1, 9.0), state=predicted)
    state = segmented(state, OTHER_REF, {-1: 4, 0: 0, 1: 1, 2: 1, 3: 1, 4: 1})
    assert acceptance_problems(state.present) == ()


def test_an_annotator_neither_decides_nor_takes_decisions_back(predicted):
    annotator = Context("ann", ME.at, "annotator")
    with pytest.raises(CommandError, match="only a reviewer may accept"):
        run(Accept(), state=predicted, context=annotator)
    accepted = run(Accept(), state=predicted, context=REVIEWER)
    with pytest.raises(CommandError, match="only a reviewer may undo"):
        run(Undo(), state=accepted, context=annotator)
    assert run(Undo(), state=predicted, context=annotator).present.tree is None


def test_saving_is_noted_without_a_step(predicted):
    accepted = run(Accept(), state=predicted)
    saved = run(Saved("out/cabinet"), state=accepted)
    assert saved.present.saved is not None
    assert saved.present.saved.folder == "out/cabinet"
    assert saved.past == accepted.past
    assert saved.seq == accepted.seq + 1
    assert saved.undo_label == "Undo: accept"


def test_a_new_part_is_fixed_until_it_is_predicted() -> None:
    tree = KinematicTree(
        ("link_0", "link_1"), (Joint("door", "revolute", "link_0", "link_1", lower=0, upper=1),)
    )
    state = segmented(run(click(1)), counts={0: 10, 1: 10})
    state = run(RecordPrediction(Prediction(tree), REF), state=state)
    state = segmented(run(click(2), state=state), OTHER_REF, {0: 8, 1: 10, 2: 2})
    doc = state.present
    assert doc.tree is not None and doc.tree.joint_of["link_2"].type == "fixed"
    assert doc.tree.joint_of["link_1"] == tree.joints[0]
    assert [j.child for j in doc.new_joints] == ["link_2"] and not doc.edited_joints
    assert "predict again" in review_problems(doc)[0]
    assert run(Undo(), state=state).present.tree == tree
    gone = segmented(
        run(ClearPrompts(2), LockJoint("link_2", True), state=state), REF, {0: 9, 1: 1}
    )
    assert gone.present.tree == tree and not gone.present.locked
    edited = run(SetJoint(replace(tree.joints[0], name="j", child="link_2")), state=state)
    assert edited.present.edited_joints == ("link_2",) and not edited.present.new_joints
    # The prediction may have been asked for before the part was there.
    late = run(RecordPrediction(Prediction(tree), REF), state=state).present
    assert late.tree is not None and [j.child for j in late.new_joints] == ["link_2"]


def test_a_part_moves_by_a_screw_and_back(predicted):
    screw = Composite("screw", 0.004)
    made = run(SetComposite("link_4", screw), state=predicted)
    tree = made.present.tree
    assert composite_of(tree, "link_4", holds_part) == screw
    assert made.present.label == "link_4 moves by screw"
    assert made.present.joint_edits == predicted.present.joint_edits + 1
    lifted = tree.pose({"spin": 2 * math.pi})["link_4"][:3, 3]
    assert np.linalg.norm(lifted) == pytest.approx(0.004)
    assert run(SetComposite("link_4", screw), state=made) is made
    assert run(Undo(), state=made).present.tree == predicted.present.tree
    finer = run(SetComposite("link_4", Composite("screw", -0.002)), state=made)
    assert composite_of(finer.present.tree, "link_4", holds_part).pitch == pytest.approx(-0.002)
    # The joint as predicted is one joint again, a follower of the drawer.
    reset = run(ResetJoint("link_4"), state=finer).present.tree
    assert set(reset.links) == set(predicted.present.tree.links)
    assert reset.by_name["spin"] == predicted.present.tree.by_name["spin"]


def test_what_follows_a_part_follows_it_on(predicted):
    tree = run(SetComposite("link_3", Composite("planar")), state=predicted).present.tree
    assert composite_of(tree, "link_3", holds_part).kind == "planar"
    assert tree.by_name["spin"].mimic == Mimic("slide", 2.0)  # its own joint stayed
    with pytest.raises(CommandError, match="it is the root"):
        run(SetComposite("link_0", Composite("ball")), state=predicted)


def test_a_locked_part_keeps_its_lock(predicted):
    locked = run(LockJoint("link_1", True), SetComposite("link_1", Composite("ball")),
                 state=predicted)  # fmt: skip
    assert locked.present.locked == {"link_1"}
