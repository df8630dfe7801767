"""What tools did is one step, and stands in the session without any segmenter."""

from dataclasses import replace

import pytest

from model.core.errors import CommandError
from model.geometry.splitting import Plane
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.document import Placement, RegionRef
from sessions.serialise import state_from_json, state_to_json
from sessions.state import Context, SessionState, apply

A, B = "ab" * 32, "cd" * 32
HERE = Context("ann", "2030-01-01T00:00:00Z")


def done(*commands) -> SessionState:
    state = SessionState()
    for command in commands:
        state = apply(state, command, HERE)
    return state


def test_many_regions_are_one_step():
    tool = cmd.ApplyTool(
        "same shape", tuple(cmd.ToolRegion(i, A, True, 4, "knob") for i in (2, 3, 4))
    )
    state = done(cmd.AddClick(Click((0, 0, 0), 1)), tool)
    assert [p.name for p in state.present.parts] == [None, None, "knob", "knob", "knob"]
    assert state.present.label == "same shape, 3 parts"
    undone = apply(state, cmd.Undo(), HERE).present
    assert [p.id for p in undone.parts] == [0, 1] and len(undone.prompts) == 1


def names(state: SessionState) -> list[str | None]:
    return [p.name for p in state.present.parts]


def alike(*parts: int, like: int = 1, tool: str = "same shape") -> cmd.ApplyTool:
    return cmd.ApplyTool(tool, tuple(cmd.ToolRegion(i, A, True, 4, like=like) for i in parts))


def test_one_name_is_for_all_that_were_found_alike():
    found = done(cmd.AddClick(Click((0, 0, 0), 1)), alike(2, 3), cmd.AddClick(Click((1, 0, 0), 4)))
    for said in (1, 3):
        named = apply(found, cmd.NamePart(said, "knob"), HERE)
        assert names(named) == [None, "knob", "knob", "knob", None]
        assert names(apply(named, cmd.Undo(), HERE)) == [None] * 5
    # What has a name already keeps it, and another name is for one part alone.
    own = done(
        cmd.AddClick(Click((0, 0, 0), 1)),
        alike(2, 3),
        cmd.NamePart(2, "knob"),
        cmd.NamePart(3, "dial"),
    )
    assert names(own) == [None, "knob", "knob", "dial"]
    assert names(apply(own, cmd.NamePart(1, None), HERE)) == [None, None, "knob", "dial"]
    assert state_from_json(state_to_json(own)) == own


def test_one_name_is_for_equal_parts_that_nobody_named():
    named = cmd.NamePart(1, "door", (2, 3))
    state = done(*(cmd.AddPart(k, "drawer" if k == 3 else None) for k in (1, 2, 3)), named)
    assert state.present.part_names == {1: "door", 2: "door", 3: "drawer"}


def test_parts_stay_alike_when_the_first_is_deleted():
    state = done(cmd.AddClick(Click((0, 0, 0), 1)), alike(2, 3), cmd.DeletePart(1))
    state = apply(state, cmd.AddClick(Click((1, 0, 0), 1)), HERE)
    assert names(apply(state, cmd.NamePart(1, "door"), HERE)) == [None, "door", None, None]
    assert names(apply(state, cmd.NamePart(3, "knob"), HERE)) == [None, None, "knob", "knob"]


def test_a_part_that_is_no_number_is_like_none():
    with pytest.raises(CommandError):
        cmd.ToolRegion(2, A, like=-3)


def test_merging_gives_the_elements_and_removes_the_part():
    first = done(
        cmd.AddClick(Click((0, 0, 0), 1)),
        cmd.AddClick(Click((1, 0, 0), 2)),
        cmd.NamePart(1, "door"),
    )
    merge = cmd.ApplyTool("merge", (cmd.ToolRegion(1, A, True, 7),), 0, (2,))
    document = apply(first, merge, HERE).present
    assert [(p.id, p.name) for p in document.parts] == [(0, None), (1, "door")]
    assert document.prompts == (Click((0, 0, 0), 1), RegionRef(1, A, True, 7, "merge"))


def test_another_mask_takes_the_place_of_the_last():
    state = done(
        cmd.AddClick(Click((0, 0, 0), 1)),
        cmd.ApplyTool("next mask", (cmd.ToolRegion(1, A, False, 3), cmd.ToolRegion(1, B, True, 5))),
        cmd.ApplyTool("next mask", (cmd.ToolRegion(1, B, False, 2),), 2),
    )
    assert state.present.prompts[1:] == (RegionRef(1, B, False, 2, "next mask"),)
    with pytest.raises(CommandError, match="next mask"):
        apply(state, cmd.ApplyTool("next mask", (), 5), HERE)


def test_leaving_out_starts_afresh_and_undo_brings_everything_back():
    state = done(cmd.AddClick(Click((0, 0, 0), 1)), cmd.AddPart(2, "door"))
    before = state.present.key
    left = apply(state, cmd.LeaveOut(A, 100), HERE)
    assert left.present.prompts == () and left.present.left_out is not None
    clicked = apply(left, cmd.AddClick(Click((0, 0, 0), 1)), HERE)
    assert clicked.present.key != before, "the same click means another element now"
    assert apply(left, cmd.Undo(), HERE).present == state.present
    assert apply(left, cmd.LeaveOut(None), HERE).present.left_out is None
    assert apply(state, cmd.LeaveOut(None), HERE) is state


def test_a_crop_keeps_its_pose_on_both_sides():
    pose = ((1.0, 2.0, 0.5), (1.0, 0.0, 0.0, 0.0))
    room = done(cmd.CropOut("fridge", "/w/fridge.ply", A, 9, *pose)).present
    assert room.crops[0].position == pose[0] and room.label == "cut out fridge"
    fridge = done(cmd.Placed("/w/room.ply", "", A, *pose))
    assert fridge.present.placement == Placement("/w/room.ply", "", A, *pose)
    assert not fridge.can_undo and fridge.present.review.state == "todo"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: cmd.ApplyTool("cut", (), 0, (0,)), "base"),
        (lambda: cmd.ApplyTool("cut", (), -1), "replaces"),
        (lambda: cmd.ToolRegion(1, "nonsense"), "reference"),
        (lambda: cmd.CropOut("a", "/a", A, 1, (0.0, float("nan"), 0.0)), "finite"),
        (lambda: cmd.Placed("/a", "", A, (0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)), "unit"),
    ],
)
def test_nonsense_is_refused(make, message):
    with pytest.raises(CommandError, match=message):
        make()


def test_a_cut_through_faces_keeps_the_parts_by_their_new_numbers():
    state = done(cmd.AddClick(Click((0, 0, 0), 1)), cmd.NamePart(1, "door"))
    before = state.present
    cut = cmd.FaceCut(A, (Plane((0.5, 0, 0), (1, 0, 0)),))
    regions = (cmd.ToolRegion(1, A, True, 7), cmd.ToolRegion(2, B, True, 9))
    command = cmd.CutFaces("rectangle", cut, regions)
    assert cmd.from_json(cmd.to_json(command)) == command
    state = apply(state, command, HERE)
    after = state.present
    assert after.face_cuts == (cut,) and after.segmentation is None
    assert after.prompts == (
        RegionRef(1, A, True, 7, "rectangle"),
        RegionRef(2, B, True, 9, "rectangle"),
    )
    assert [(p.id, p.name) for p in after.parts] == [(0, None), (1, "door"), (2, None)]
    assert after.label == "rectangle through faces"
    assert state_from_json(state_to_json(state)) == state
    # The same prompts without the cut are about other faces.
    assert replace(after, face_cuts=()).key != after.key
    # Read in another frame, the planes would lie elsewhere.
    assert apply(state, cmd.SetFrame("y", 1.0), HERE).present.face_cuts == ()
    undone = apply(state, cmd.Undo(), HERE).present
    assert (undone.prompts, undone.face_cuts, undone.key) == (before.prompts, (), before.key)


def test_a_cut_without_planes_is_refused():
    with pytest.raises(CommandError, match="plane"):
        cmd.FaceCut(A, ())
    with pytest.raises(CommandError):
        cmd.from_json(
            {"kind": "cut_faces", "tool": "line", "regions": [], "cut": {"elements": "x"}}
        )
