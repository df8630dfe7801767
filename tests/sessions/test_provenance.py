"""An asset tells where it comes from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from model.core.asset import Source
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.live import LiveSession
from sessions.provenance import provenance

SOURCE = Source(Path("scans/cabinet.ply"), "e" * 64, "y", 0.001)


@pytest.fixture
def live(store, labels_ref, prediction, cabinet):
    live = LiveSession(store, store.open_object(SOURCE.path, SOURCE.sha256, "cabinet").id)
    for part in (1, 2, 3, 4):
        live.do(cmd.AddClick(Click((0.0, 0.0, float(part)), part)), "ann")
    live.do(cmd.AddRegion(1, labels_ref, count=50), "ann")
    live.do(cmd.Undo(), "ann")
    live.do(cmd.NamePart(1, "door"), "ann")
    live.do(cmd.SetCategory("cabinet"), "ann")
    answer = cmd.RecordSegmentation(
        live.document.key, labels_ref, "walk", 0.1, dict.fromkeys(range(5), 10)
    )
    live.do(answer, "ann")
    live.do(cmd.SetCategory("kitchen cabinet"), "ann")
    live.do(cmd.RecordPrediction(prediction, labels_ref), "ann")
    hinge = cabinet.joint_of["link_1"]
    live.do(cmd.SetJoint(replace(hinge, upper=1.0)), "rob")
    live.do(cmd.SetJoint(replace(hinge, upper=1.2)), "rob")
    live.do(cmd.Undo(), "rob")
    live.do(cmd.Accept("good"), "rob")
    live.do(cmd.Saved("out"), "rob")
    return live


def told(live, store):
    out = provenance(live.state, store.history(live.object_id), SOURCE)
    return json.loads(json.dumps(out, allow_nan=False))


def test_it_tells_source_prompts_predictor_edits_and_people(live, store):
    out = told(live, store)
    assert out["source"] == {
        "path": "scans/cabinet.ply",
        "sha256": "e" * 64,
        "up_axis": "y",
        "unit_scale": 0.001,
    }
    assert out["category"] == "kitchen cabinet"
    assert out["parts"][1] == {"id": 1, "link": "link_1", "name": "door", "elements": 10}
    assert [p["kind"] for p in out["prompts"]] == ["click"] * 4
    assert out["segmenter"]["name"] == "walk"
    assert out["predictor"]["backend"] == "geometric 1"
    assert out["predictor"]["by"] == "ann"
    assert out["predictor"]["confidence"]["link_1"] == 0.9
    assert out["review"]["state"] == "accepted"
    assert out["review"]["by"] == "rob"
    assert out["people"] == [{"who": "ann", "decisions": 8}, {"who": "rob", "decisions": 2}]
    assert out["started"] < out["finished"]
    assert out["commands"] == 16
    assert out["versions"]["python"].startswith("3.")


def test_edits_that_were_undone_are_not_told(live, store):
    out = told(live, store)
    assert [e["command"]["joint"]["upper"] for e in out["edits"]] == [1.0]
    assert out["edits"][0]["who"] == "rob"
    assert out["edited_joints"] == ["link_1"]


def test_a_new_prediction_starts_the_list_of_edits_afresh(live, store, prediction, labels_ref):
    live.do(cmd.Undo(), "rob")  # the acceptance
    live.do(cmd.RecordPrediction(prediction, labels_ref), "ann")
    assert told(live, store)["edits"] == []


def test_an_object_that_nobody_touched_has_a_provenance(store):
    live = LiveSession(store, store.open_object(Path("x.ply"), None, "x").id)
    out = provenance(live.state, [], None)
    assert (out["source"], out["predictor"], out["edits"], out["started"]) == (None, None, [], None)
