"""Commands as JSON: what version 1 wrote stays readable, and bad input is named."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from model.core.articulated_object import Prediction
from model.core.errors import CommandError
from model.segmentation.prompts import Click
from sessions import commands as cmd

DATA = Path(__file__).with_name("data")
REF = "ab" * 32
VERSION_1 = list(map(json.loads, (DATA / "commands_1.jsonl").read_text().splitlines()))
JOINT = next(d["joint"] for d in VERSION_1 if d["kind"] == "set_joint")
PREPARED = next(d for d in VERSION_1 if d["kind"] == "prepare")
ANSWER = next(d for d in VERSION_1 if d["kind"] == "record_segmentation")
PREDICTED = next(d for d in VERSION_1 if d["kind"] == "record_prediction")
FLAT = {"kind": "screw", "pitch": 0.0}


NEWER_FIELDS = {
    "add_click": {"answer": None, "name": None},
    "accept": {"override": "", "decided_at": ""},
    "reject": {"decided_at": "", "joint": "", "place": None, "listed": False},
    "remove_prompt": {"count": 1},
    "decide_objects": {"looked": False},
    "prepare": {"resizes": False},
    "name_part": {"others": []},
    "set_joint": {"others": []},
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
    (PREPARED | {"frame": {"scale": -1.0}}, "scale", "-1"),
    ({"kind": "delete_part", "part": 0}, "part 0", "base"),
    ({"kind": "reject", "reason": "ugly"}, "reason", "'ugly'"),
    ({"kind": "lock_joint", "child": "link_1", "locked": 1}, "locked", "1"),
    ({"kind": "set_joint", "joint": JOINT | {"axis": [0, 0, 0]}}, "axis", "zero"),
    ({"kind": "set_joint", "joint": JOINT | {"lower": 2.0}}, "lower", "114.6°"),
    ({"kind": "set_joint", "joint": JOINT | {"type": "screw"}}, "type", "'screw'"),
    ({"kind": "set_composite", "child": "link_1", "motion": FLAT}, "screw", "0.0"),
    (ANSWER | {"counts": {"one": 3}}, "counts", "'one'"),
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
    data = {**PREDICTED, "prediction": PREDICTED["prediction"] | {"tree": tree}}
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
    assert [f.name for f in fields(cmd.AddClick)] == ["click", "answer", "name"]
