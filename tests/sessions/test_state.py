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
from model.core.tree import KinematicTree, holds_part
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.document import PartInfo, acceptance_problems, prompts_key, review_problems
from sessions.serialise import state_from_json, state_to_json
from sessions.state import MAX_UNDO, SOURCE, Context, SessionState, apply

REF = "ab" * 32
OTHER_REF = "cd" * 32
FIVE = {0: 10, 1: 10, 2: 10, 3: 10, 4: 10}
ME = Context("ann", "2030-01-01T00:00:00.000000Z")
REVIEWER = Context("rob", "2030-01-02T00:00:00.000000Z")


def click(part: int, x: float = 0.0, positive: bool = True) -> cmd.AddClick:
    return cmd.AddClick(Click((x, 0.0, 0.0), part, positive))


def run(*commands, state: SessionState | None = None, context: Context = ME) -> SessionState:
    state = SessionState() if state is None else state
    for command in commands:
        state = apply(state, command, context)
    return state


def segmented(state: SessionState, ref: str = REF, counts=None) -> SessionState:
    counts = FIVE if counts is None else counts
    return run(
        cmd.RecordSegmentation(prompts_key(state.present), ref, "walk", 0.1, counts), state=state
    )


@pytest.fixture
def predicted(prediction: Prediction) -> SessionState:
    clicks = run(*(click(part) for part in (1, 2, 3, 4)))
    return run(cmd.RecordPrediction(prediction, REF), state=segmented(clicks))


def test_a_click_makes_its_part_and_asks_for_labels():
    state = run(click(2))
    assert state.present.parts == (PartInfo(0), PartInfo(2))
    assert state.present.next_part == 1
    assert state.present.review.state == "in_progress"
    assert state.present.needs_labels
    assert not segmented(state).present.needs_labels
    assert not SessionState().present.needs_labels


def test_a_click_with_its_labels_is_one_step():
    bare, two = run(click(2)), segmented(run(click(2)))
    record = cmd.RecordSegmentation(prompts_key(bare.present), REF, "walk", 0.1, FIVE)
    one = run(cmd.AddClick(click(2).click, record))
    assert (one.present, one.seq, two.seq) == (two.present, 1, 2)
    assert run(cmd.Undo(), state=one).present == SessionState().present
    late = run(cmd.AddClick(click(3).click, record))  # labels of other prompts
    assert late.present == run(click(3)).present


def test_a_late_answer_is_ignored():
    first = run(click(1))
    second = run(click(2), state=first)
    late = cmd.RecordSegmentation(prompts_key(first.present), REF, "walk", 0.1, FIVE)
    assert apply(second, late, ME) is second
    assert apply(first, late, ME).present.segmentation_current


def test_labels_are_no_step_and_keep_the_way_forward():
    state = segmented(run(click(1)))
    state = run(click(2), cmd.Undo(), state=state)
    assert state.present.segmentation_current, "the labels came back with the prompts"
    state = segmented(state, OTHER_REF)
    assert state.redo_label == "Redo: add click, part 2"
    state = run(cmd.Redo(), state=state)
    assert len(state.present.prompts) == 2
    assert state.present.needs_labels


def test_the_joints_of_a_file_are_not_undone(predicted):
    source, edit = Context(SOURCE, ME.at), cmd.SetCategory("box")
    merged = apply(SessionState(), edit, source)
    assert merged.can_undo, "parts alone, which the names of meshes gave, are"
    opened = apply(SessionState(predicted.present), edit, source)
    assert not opened.can_undo and opened.undo_label == ""
    edited = run(cmd.SetCategory("lamp"), state=opened)
    assert edited.can_undo and not run(cmd.Undo(), state=edited).can_undo
    assert state_from_json(state_to_json(edited)) == edited
    assert state_from_json({**state_to_json(edited), "opened": 0}).opened == 0


def test_undo_and_redo_walk_over_everything(predicted, cabinet):
    joint = replace(cabinet.joint_of["link_1"], upper=1.0)
    commands = (
        cmd.SetJoint(joint),
        cmd.NamePart(1, "door"),
        cmd.SetCategory("cabinet"),
        cmd.LockJoint("link_1", True),
        cmd.SetRoot("link_1"),
        cmd.SetCompletion(False),
        cmd.Accept("good"),
    )
    states = [predicted]
    for command in commands:
        states.append(run(command, state=states[-1]))
    state = states[-1]
    for former in reversed(states[:-1]):
        state = run(cmd.Undo(), state=state)
        assert state.present == former.present
        assert state.past == former.past
    for later in states[1:]:
        state = run(cmd.Redo(), state=state)
        assert state.present == later.present
    assert not state.can_redo
    with pytest.raises(CommandError, match="nothing to redo"):
        run(cmd.Redo(), state=state)
    with pytest.raises(CommandError, match="nothing to undo"):
        run(cmd.Undo())


def test_a_new_step_closes_the_way_forward():
    state = run(click(1), cmd.Undo(), click(2))
    assert not state.can_redo
    assert state.undo_label == "Undo: add click, part 2"
    assert state.seq == 3


def test_the_way_back_is_bounded():
    state = run(*(click(1, float(i)) for i in range(MAX_UNDO + 5)))
    assert len(state.past) == MAX_UNDO
    state = run(*[cmd.Undo()] * MAX_UNDO, state=state)
    assert len(state.present.prompts) == 5
    assert not state.can_undo


@pytest.mark.parametrize(
    "command",
    [
        cmd.NamePart(0, None),
        cmd.SetCategory(None),
        cmd.ClearPrompts(),
        cmd.ClearPrompts(3),
        cmd.LockJoint("link_1", False),
        cmd.SetRoot("link_0"),
        cmd.ResetJoint("link_1"),
    ],
    ids=lambda c: type(c).__name__,
)
def test_what_changes_nothing_is_no_step(command, predicted):
    empty = command if not isinstance(command, cmd.ClearPrompts) else None
    state = predicted if empty else SessionState()
    assert apply(state, command, ME) is state


def test_prompts_are_removed_and_cleared():
    state = segmented(run(click(1), click(2, 1.0), cmd.AddRegion(2, REF, count=3), click(3)))
    key = prompts_key(state.present)
    fewer = run(cmd.RemovePrompt(1), state=state)
    assert [p.part for p in fewer.present.prompts] == [1, 2, 3]
    assert not fewer.present.segmentation_current
    assert prompts_key(fewer.present) != key
    assert [p.part for p in run(cmd.ClearPrompts(2), state=state).present.prompts] == [1, 3]
    none = run(cmd.ClearPrompts(), state=state)
    assert none.present.prompts == ()
    assert none.present.segmentation is None
    assert not none.present.needs_labels
    with pytest.raises(CommandError, match=r"no prompt 4; there are prompts 0\.\.3"):
        run(cmd.RemovePrompt(4), state=state)
    with pytest.raises(CommandError, match="no prompt 0; there are no prompts"):
        run(cmd.RemovePrompt(0))


def test_prompts_that_belong_together_are_removed_in_one_step():
    state = run(click(1), click(2), cmd.AddRegion(2, REF, count=3), click(3))
    fewer = run(cmd.RemovePrompt(1, 2), state=state)
    assert [p.part for p in fewer.present.prompts] == [1, 3]
    assert run(cmd.Undo(), state=fewer).present == state.present
    with pytest.raises(CommandError, match=r"no prompt 4; there are prompts 0\.\.3"):
        run(cmd.RemovePrompt(2, 3), state=state)
    with pytest.raises(CommandError, match="1 or more"):
        cmd.RemovePrompt(1, 0)


def test_the_key_tells_prompts_and_frames_apart():
    commands = [
        [click(1)],
        [click(1, positive=False)],
        [click(2)],
        [click(1), click(1)],
        [cmd.AddClick(Click((0.0, 0.0, 0.0), 1, element=4))],
        [cmd.AddRegion(1, REF)],
        [cmd.AddRegion(1, OTHER_REF)],
        [cmd.SetFrame("y", 1.0), click(1)],
        [cmd.SetFrame("y", 0.01), click(1)],
    ]
    keys = [prompts_key(run(*c).present) for c in commands]
    assert len(set(keys)) == len(keys)
    again = run(click(1), click(2), cmd.RemovePrompt(1), cmd.NamePart(1, "door"))
    assert prompts_key(again.present) == keys[0]


def test_parts_are_added_named_and_deleted():
    state = run(cmd.AddPart(1, "door"), cmd.AddPart(3), cmd.NamePart(3, "knob"))
    assert state.present.part_names == {1: "door", 3: "knob"}
    assert state.present.next_part == 2
    with pytest.raises(CommandError, match="part 1 exists already; part 2 is free"):
        run(cmd.AddPart(1), state=state)
    with pytest.raises(CommandError, match="no part 7; there are 0, 1, 3"):
        run(cmd.NamePart(7, "x"), state=state)
    with pytest.raises(CommandError, match="no part 7"):
        run(cmd.DeletePart(7), state=state)
    state = run(click(1), click(3), cmd.DeletePart(1), state=state)
    assert [p.id for p in state.present.parts] == [0, 3]
    assert [p.part for p in state.present.prompts] == [3]


def test_a_deleted_part_leaves_the_tree(predicted):
    state = run(cmd.LockJoint("link_1", True), cmd.LockJoint("link_3", True), state=predicted)
    state = run(cmd.DeletePart(1), state=state)
    tree = state.present.tree
    assert tree is not None
    assert "link_1" not in tree.links
    assert tree.joint_of["link_2"].parent == "link_0"
    assert state.present.locked == {"link_3"}
    assert state.present.prediction_stale
    state = segmented(state, OTHER_REF, {0: 10, 2: 10, 3: 10, 4: 10})
    assert run(cmd.Accept(), state=state).present.review.state == "accepted"


def test_another_frame_starts_afresh_but_keeps_names(predicted):
    state = run(cmd.NamePart(1, "door"), cmd.SetFrame("y", 0.001), state=predicted)
    document = state.present
    assert (document.up_axis, document.unit_scale) == ("y", 0.001)
    assert (document.prompts, document.segmentation, document.tree) == ((), None, None)
    assert document.part_names == {1: "door"}
    assert document.review.state == "in_progress"
    assert run(cmd.Undo(), state=state).present.tree is not None


def test_a_prediction_sets_the_tree(predicted, prediction):
    document = predicted.present
    assert document.tree == prediction.tree
    assert document.review.state == "predicted"
    assert not document.prediction_stale
    assert document.edited_joints == ()
    assert predicted.undo_label == "Undo: prediction"
    assert run(cmd.Undo(), state=predicted).present.tree is None


def test_a_prediction_for_parts_that_are_gone_is_ignored(prediction):
    state = run(click(1), cmd.ClearPrompts())
    assert apply(state, cmd.RecordPrediction(prediction, REF), ME) is state


def test_a_failed_prediction_keeps_the_tree(predicted):
    failed = Prediction(None, problems=("no hinge found",), backend="geometric 1")
    state = run(cmd.RecordPrediction(failed, OTHER_REF), state=predicted)
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
    state = run(cmd.SetJoint(flipped), state=predicted)
    assert state.present.edited_joints == ("link_1",)
    assert state.present.review.state == "predicted"
    assert state.present.joint_edits == 1
    back = run(cmd.ResetJoint("link_1"), state=state)
    assert back.present.tree == cabinet
    assert back.present.edited_joints == ()
    with pytest.raises(CommandError, match="no joint was predicted for 'link_0'"):
        run(cmd.ResetJoint("link_0"), state=state)
    with pytest.raises(CommandError, match="'turn' is there twice"):
        run(cmd.SetJoint(replace(flipped, name="turn")), state=state)
    with pytest.raises(CommandError, match="no kinematic tree"):
        run(cmd.SetJoint(flipped))


def test_locked_joints_go_to_the_next_prediction_and_follow_the_root(predicted, cabinet):
    state = run(cmd.LockJoint("link_1", True), cmd.LockJoint("link_4", True), state=predicted)
    assert [j.name for j in state.present.locked_joints] == ["hinge", "spin"]
    turned = run(cmd.SetRoot("link_2"), state=state)
    assert turned.present.tree is not None
    assert turned.present.tree.root == "link_2"
    assert [j.name for j in turned.present.locked_joints] == ["hinge", "spin"]
    smaller = Prediction(
        type(cabinet)(("link_0", "link_1"), (Joint("a", "fixed", "link_0", "link_1"),))
    )
    assert run(cmd.RecordPrediction(smaller, REF), state=state).present.locked == {"link_1"}
    with pytest.raises(CommandError, match="'link_7'"):
        run(cmd.LockJoint("link_7", True), state=predicted)


def test_accept_undo_reject_reopen(predicted):
    accepted = run(cmd.Accept("fine", ("touches at 0.2 rad",)), state=predicted, context=REVIEWER)
    review = accepted.present.review
    assert (review.state, review.by, review.at) == ("accepted", "rob", REVIEWER.at)
    assert (review.comment, review.problems) == ("fine", ("touches at 0.2 rad",))
    assert run(cmd.Undo(), state=accepted).present.review == predicted.present.review
    with pytest.raises(CommandError, match="reopen it"):
        run(click(1), state=accepted)
    rejected = run(cmd.Reject("axis", "door hangs left"), state=accepted, context=REVIEWER)
    assert rejected.present.review.reason == "axis"
    assert rejected.present.annotator == "ann", "it goes back to who worked on the parts"
    mended = run(click(1, 3.0), state=rejected)
    assert mended.present.review.state == "in_progress"
    assert mended.present.review.comment == "door hangs left", "still to be read while mending"
    reopened = run(cmd.Reopen("new scan"), state=accepted)
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
            run(cmd.Accept(), state=state if state.seq else run(click(1)))


def test_outdated_joints_and_empty_parts_keep_a_person_from_accepting(predicted):
    assert review_problems(predicted.present) == ()
    moved = segmented(run(click(1, 9.0), state=predicted), OTHER_REF, FIVE)
    assert acceptance_problems(moved.present) == ()
    assert "predict again" in review_problems(moved.present)[0]
    added = run(cmd.AddPart(7, "knob"), state=predicted)
    assert review_problems(added.present) == ("part 7 (knob) is empty: click on it, or delete it",)
    # What was accepted before is still read.
    assert run(cmd.Accept(), state=moved).present.review.state == "accepted"


def test_unassigned_elements_count_for_the_base(predicted):
    state = run(click(1, 9.0), state=predicted)
    state = segmented(state, OTHER_REF, {-1: 4, 0: 0, 1: 1, 2: 1, 3: 1, 4: 1})
    assert acceptance_problems(state.present) == ()


def test_an_annotator_neither_decides_nor_takes_decisions_back(predicted):
    annotator = Context("ann", ME.at, "annotator")
    with pytest.raises(CommandError, match="only a reviewer may accept"):
        run(cmd.Accept(), state=predicted, context=annotator)
    accepted = run(cmd.Accept(), state=predicted, context=REVIEWER)
    with pytest.raises(CommandError, match="only a reviewer may undo"):
        run(cmd.Undo(), state=accepted, context=annotator)
    assert run(cmd.Undo(), state=predicted, context=annotator).present.tree is None


def test_saving_is_noted_without_a_step(predicted):
    accepted = run(cmd.Accept(), state=predicted)
    saved = run(cmd.Saved("out/cabinet"), state=accepted)
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
    state = run(cmd.RecordPrediction(Prediction(tree), REF), state=state)
    state = segmented(run(click(2), state=state), OTHER_REF, {0: 8, 1: 10, 2: 2})
    doc = state.present
    assert doc.tree is not None and doc.tree.joint_of["link_2"].type == "fixed"
    assert doc.tree.joint_of["link_1"] == tree.joints[0]
    assert [j.child for j in doc.new_joints] == ["link_2"] and not doc.edited_joints
    assert "predict again" in review_problems(doc)[0]
    assert run(cmd.Undo(), state=state).present.tree == tree
    gone = segmented(
        run(cmd.ClearPrompts(2), cmd.LockJoint("link_2", True), state=state), REF, {0: 9, 1: 1}
    )
    assert gone.present.tree == tree and not gone.present.locked
    edited = run(cmd.SetJoint(replace(tree.joints[0], name="j", child="link_2")), state=state)
    assert edited.present.edited_joints == ("link_2",) and not edited.present.new_joints
    # The prediction may have been asked for before the part was there.
    late = run(cmd.RecordPrediction(Prediction(tree), REF), state=state).present
    assert late.tree is not None and [j.child for j in late.new_joints] == ["link_2"]


def test_a_part_moves_by_a_screw_and_back(predicted):
    screw = Composite("screw", 0.004)
    made = run(cmd.SetComposite("link_4", screw), state=predicted)
    tree = made.present.tree
    assert composite_of(tree, "link_4", holds_part) == screw
    assert made.present.label == "link_4 moves by screw"
    assert made.present.joint_edits == predicted.present.joint_edits + 1
    lifted = tree.pose({"spin": 2 * math.pi})["link_4"][:3, 3]
    assert np.linalg.norm(lifted) == pytest.approx(0.004)
    assert run(cmd.SetComposite("link_4", screw), state=made) is made
    assert run(cmd.Undo(), state=made).present.tree == predicted.present.tree
    finer = run(cmd.SetComposite("link_4", Composite("screw", -0.002)), state=made)
    assert composite_of(finer.present.tree, "link_4", holds_part).pitch == pytest.approx(-0.002)
    # The joint as predicted is one joint again, a follower of the drawer.
    reset = run(cmd.ResetJoint("link_4"), state=finer).present.tree
    assert set(reset.links) == set(predicted.present.tree.links)
    assert reset.by_name["spin"] == predicted.present.tree.by_name["spin"]


def test_what_follows_a_part_follows_it_on(predicted):
    tree = run(cmd.SetComposite("link_3", Composite("planar")), state=predicted).present.tree
    assert composite_of(tree, "link_3", holds_part).kind == "planar"
    assert tree.by_name["spin"].mimic == Mimic("slide", 2.0)  # its own joint stayed
    with pytest.raises(CommandError, match="it is the root"):
        run(cmd.SetComposite("link_0", Composite("ball")), state=predicted)


def test_a_locked_part_keeps_its_lock(predicted):
    locked = run(cmd.LockJoint("link_1", True), cmd.SetComposite("link_1", Composite("ball")),
                 state=predicted)  # fmt: skip
    assert locked.present.locked == {"link_1"}
