"""Commands as JSON: what version 1 wrote stays readable, and bad input is named."""

from __future__ import annotations

import json
from dataclasses import fields

import numpy as np
import pytest

from model.core.articulated_object import Prediction
from model.core.errors import CommandError
from model.segmentation.prompts import Click
from sessions import commands as cmd

REF = "ab" * 32
JOINT = {
    "name": "hinge",
    "type": "revolute",
    "parent": "link_0",
    "child": "link_1",
    "axis": [0.0, 0.0, 1.0],
    "origin": [0.5, 0.0, 0.0],
    "lower": 0.0,
    "upper": 1.5,
    "mimic": None,
    "give_way": False,
    "dynamics": None,
}
SPIN = JOINT | {
    "name": "spin",
    "type": "continuous",
    "child": "link_2",
    "lower": None,
    "upper": None,
    "mimic": {"joint": "hinge", "multiplier": 2.0, "offset": 0.0},
}
PREDICTION = {
    "tree": {"links": ["link_0", "link_1", "link_2"], "joints": [JOINT, SPIN]},
    "problems": ["small"],
    "confidence": {"link_1": 0.9},
    "backend": "geometric 1",
    "seed": 0,
    "seconds": 0.5,
    "raw_text": "",
    "notes": {"link_1": "contact"},
}
VERSION_1 = [
    {
        "kind": "add_click",
        "click": {"position": [0.1, 0.2, 0.3], "part": 1, "positive": False, "element": 7},
    },
    {
        "kind": "add_region",
        "part": 2,
        "elements": REF,
        "positive": True,
        "count": 12,
        "tool": "lasso",
    },
    {
        "kind": "apply_tool",
        "tool": "cut",
        "regions": [
            {"part": 3, "elements": REF, "positive": True, "count": 9, "name": "door"},
            {"part": 1, "elements": REF, "positive": False, "count": 9, "name": None},
        ],
        "replaces": 1,
        "delete": [2],
    },
    {
        "kind": "cut_faces",
        "tool": "rectangle",
        "cut": {
            "elements": REF,
            "planes": [{"point": [0.5, 0.0, 0.25], "normal": [0.0, 0.0, -1.0]}],
        },
        "regions": [{"part": 2, "elements": REF, "positive": True, "count": 5, "name": None}],
    },
    {"kind": "leave_out", "elements": REF, "count": 7, "what": "floor and walls"},
    {"kind": "leave_out", "elements": None, "count": 0, "what": "floor and walls"},
    {
        "kind": "crop_out",
        "name": "fridge",
        "path": "/w/crops/fridge.ply",
        "elements": REF,
        "count": 5,
        "position": [1.0, 2.0, 0.0],
        "wxyz": [1.0, 0.0, 0.0, 0.0],
    },
    {
        "kind": "placed",
        "scene": "/scans/room.ply",
        "scene_sha256": "e" * 64,
        "elements": REF,
        "position": [1.0, 2.0, 0.0],
        "wxyz": [1.0, 0.0, 0.0, 0.0],
    },
    {"kind": "set_articulable", "object": "cabinet-0 (kitchen)", "articulable": False},
    {"kind": "set_articulable", "object": "table", "articulable": None},
    {
        "kind": "pick_out",
        "object": "room",
        "id": "oven 1",
        "name": "oven",
        "path": "/w/oven.ply",
        "rest": "/w/without_oven.ply",
        "count": 70,
        "position": [1.0, 2.0, 0.5],
        "wxyz": [1.0, 0.0, 0.0, 0.0],
        "rest_position": [0.0, 0.0, 0.0],
        "rest_wxyz": [1.0, 0.0, 0.0, 0.0],
    },
    {
        "kind": "decide_objects",
        "decision": "accept",
        "objects": [3, 5],
        "above": 0.8,
        "reason": "other",
    },
    {"kind": "remove_prompt", "index": 0},
    {"kind": "clear_prompts", "part": None},
    {"kind": "clear_prompts", "part": 3},
    {"kind": "add_part", "part": 4, "name": "door"},
    {"kind": "name_part", "part": 4, "name": None},
    {"kind": "delete_part", "part": 4},
    {"kind": "set_category", "category": "oven"},
    {"kind": "set_frame", "up_axis": "-y", "unit_scale": 0.001},
    {"kind": "set_completion", "complete": False},
    {
        "kind": "prepare",
        "unit_scale": 0.001,
        "frame": {"position": [0.1, 0, 2], "wxyz": [0.6, 0, 0.8, 0], "scale": 1.5},
        "leave_out": {"elements": REF, "count": 3, "what": "support"},
        "what": "level by 34°",
    },
    {
        "kind": "record_segmentation",
        "prompts_key": "k",
        "labels": REF,
        "segmenter": "walk",
        "seconds": 0.1,
        "counts": {"-1": 3, "0": 4},
    },
    {"kind": "record_prediction", "prediction": PREDICTION, "segmentation": REF},
    {
        "kind": "record_prediction",
        "prediction": PREDICTION | {"tree": None},
        "segmentation": REF,
    },
    {"kind": "set_joint", "joint": JOINT},
    {"kind": "set_composite", "child": "link_1", "motion": {"kind": "screw", "pitch": 0.004}},
    {"kind": "set_root", "link": "link_1"},
    {"kind": "reset_joint", "child": "link_1"},
    {"kind": "lock_joint", "child": "link_1", "locked": True},
    {"kind": "submit", "comment": "done"},
    {"kind": "accept", "comment": "fine\nreally", "note_problems": ["touches at 0.2 rad"]},
    {"kind": "reject", "reason": "not_articulated", "comment": ""},
    {"kind": "add_comment", "text": "too far", "joint": "link_1", "place": [0.1, 0.2, 0.3]},
    {"kind": "resolve_comment", "number": 1, "done": False},
    {"kind": "reopen", "comment": "again"},
    {"kind": "saved", "folder": "out/oven"},
    {"kind": "undo"},
    {"kind": "redo"},
]


NEWER_FIELDS = {
    "add_click": {"answer": None},
    "accept": {"override": "", "decided_at": ""},
    "reject": {"decided_at": "", "joint": "", "place": None, "listed": False},
    "remove_prompt": {"count": 1},
    "decide_objects": {"looked": False},
}
"""What later versions added, with its default."""
NEWER_REGION = {"like": None}
"""The same for each region of a tool."""
NEWER_PREDICTION = {"alternatives": {}, "file": None}
"""The same for a prediction."""


@pytest.mark.parametrize("data", VERSION_1, ids=lambda d: d["kind"])
def test_what_version_1_wrote_is_read_and_written_alike(data):
    command = cmd.from_json(json.loads(json.dumps(data)))
    newer = data | NEWER_FIELDS.get(data["kind"], {})
    if "regions" in data:
        newer["regions"] = [region | NEWER_REGION for region in data["regions"]]
    if "prediction" in data:
        newer["prediction"] = data["prediction"] | NEWER_PREDICTION
    assert cmd.to_json(command) == newer
    assert cmd.from_json(cmd.to_json(command)) == command
    assert command.kind == data["kind"]
    assert command.describe()


def test_every_kind_has_a_version_1_example():
    assert {d["kind"] for d in VERSION_1} == set(cmd.KINDS)


def test_numpy_numbers_become_plain_ones():
    position = tuple(np.array([0.1, 0.2, 0.3], dtype=np.float32))
    command = cmd.AddClick(Click(position, np.int64(2), True, np.int32(5)))
    again = cmd.from_json(json.loads(json.dumps(cmd.to_json(command))))
    assert isinstance(again, cmd.AddClick)
    assert type(again.click.element) is int
    assert type(again.click.part) is int
    assert again.click.position == pytest.approx((0.1, 0.2, 0.3))


BAD = [
    ({"kind": "add_click", "click": {"position": [0, 0], "part": 1}}, "position", "[0, 0]"),
    ({"kind": "add_click", "click": {"position": [0, 0, "x"], "part": 1}}, "position[2]", "'x'"),
    ({"kind": "add_click", "click": {"position": [0, 0, 0], "part": 5000}}, "click", "5000"),
    ({"kind": "add_click", "click": {"position": [0, 0, 1e999], "part": 0}}, "position[2]", "inf"),
    ({"kind": "add_click", "click": {"position": [0, 0, 0], "part": True}}, "part", "True"),
    ({"kind": "add_click", "click": 3}, "click", "3"),
    ({"kind": "add_click"}, "click", "missing"),
    ({"kind": "remove_prompt", "index": 1.5}, "index", "1.5"),
    ({"kind": "remove_prompt", "index": 1, "why": "x"}, "why", "newer version"),
    ({"kind": "add_region", "part": 1, "elements": "../../etc/passwd"}, "elements", "../../etc"),
    ({"kind": "add_region", "part": -1, "elements": REF}, "part", "-1"),
    ({"kind": "add_region", "part": 1, "elements": REF, "count": -4}, "count", "-4"),
    ({"kind": "set_frame", "up_axis": "w", "unit_scale": 1.0}, "up_axis", "'w'"),
    ({"kind": "set_frame", "up_axis": "z", "unit_scale": 0}, "unit_scale", "0"),
    ({"kind": "set_frame", "up_axis": "z", "unit_scale": 10**400}, "unit_scale", "finite"),
    (
        {
            "kind": "prepare",
            "unit_scale": 1.0,
            "frame": {"scale": -1.0},
            "leave_out": {"elements": None},
            "what": "",
        },
        "scale",
        "-1",
    ),
    ({"kind": "delete_part", "part": 0}, "part 0", "base"),
    ({"kind": "reject", "reason": "ugly"}, "reason", "'ugly'"),
    ({"kind": "lock_joint", "child": "link_1", "locked": 1}, "locked", "1"),
    ({"kind": "set_joint", "joint": JOINT | {"axis": [0, 0, 0]}}, "axis", "zero"),
    ({"kind": "set_joint", "joint": JOINT | {"lower": 2.0}}, "lower", "114.6°"),
    ({"kind": "set_joint", "joint": JOINT | {"type": "screw"}}, "type", "'screw'"),
    (
        {"kind": "set_composite", "child": "link_1", "motion": {"kind": "screw", "pitch": 0.0}},
        "screw",
        "0.0",
    ),
    (
        {"kind": "record_segmentation", "prompts_key": "k", "labels": REF, "segmenter": "s"}
        | {"seconds": 0.1, "counts": {"one": 3}},
        "counts",
        "'one'",
    ),
    ({"kind": "teleport", "to": 3}, "teleport", "newer version"),
    ({"to": 3}, "None", "newer version"),
    ([1, 2], "[1, 2]", "object"),
]


@pytest.mark.parametrize(("data", "field", "value"), BAD)
def test_bad_input_names_field_and_value(data, field, value):
    with pytest.raises(CommandError) as error:
        cmd.from_json(data)
    assert field in str(error.value)
    assert value in str(error.value)
    assert "\n" not in str(error.value)


def test_a_tree_that_is_none_is_refused_with_all_that_is_wrong():
    tree = {"links": ["link_0", "link_1", "link_2"], "joints": [JOINT, JOINT]}
    data = {
        "kind": "record_prediction",
        "prediction": PREDICTION | {"tree": tree},
        "segmentation": REF,
    }
    with pytest.raises(CommandError, match=r"hinge.*twice.*two parents.*roots"):
        cmd.from_json(data)


def test_nan_can_not_be_written():
    with pytest.raises(CommandError, match="seconds"):
        cmd.to_json(cmd.RecordSegmentation("k", REF, "s", float("nan"), {0: 1}))
    with pytest.raises(CommandError, match="confidence"):
        cmd.to_json(
            cmd.RecordPrediction(Prediction(None, confidence={"link_1": float("inf")}), REF)
        )


def test_text_is_cleaned_and_limited():
    assert cmd.NamePart(1, "  do\x00or\x1b[31m\u202e \n").name == "door[31m"
    assert cmd.NamePart(1, " \t ").name is None
    assert cmd.AddPart(1, "Tür 門 ñ 🚪").name == "Tür 門 ñ 🚪"
    assert cmd.Accept("a\r\nb\x07\ud800").comment == "a\nb"
    assert cmd.AddRegion(1, REF, tool="box\n").tool == "box"
    assert len(cmd.Accept(note_problems=("x" * 10_000,)).note_problems[0]) == 500
    with pytest.raises(CommandError, match="81 characters; at most 80"):
        cmd.NamePart(1, "x" * 81)
    with pytest.raises(CommandError, match="2001 characters"):
        cmd.Reject("other", "x" * 2001)


def test_commands_are_immutable_values():
    for kind, cls in cmd.KINDS.items():
        assert cls.__dataclass_params__.frozen, kind
    assert cmd.SetFrame("z", 1.0) == cmd.SetFrame("z", 1.0)
    assert [f.name for f in fields(cmd.AddClick)] == ["click", "answer"]
