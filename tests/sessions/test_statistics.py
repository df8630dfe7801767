"""Figures about work: scripted sequences whose times are known."""

import csv
import io
import math
import random
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from model.core.articulated_object import Prediction
from model.core.tree import KinematicTree
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.command_log import BULK, FILE, TimedJob, WorkLog, counts, read_work, record_job
from sessions.statistics import PAUSE, STEPS, acts_of, csv_text, figures_of, grouped, rows_of
from sessions.store import Store

BEGIN = datetime(2026, 3, 2, 9, tzinfo=UTC)
SEGMENTED, JOINED = "segmenter", "anna"


class Script:
    """Writes commands at known seconds of a morning."""

    def __init__(self, store: Store, labels: str, prediction: Prediction) -> None:
        self.store, self.labels, self.prediction = store, labels, prediction
        self.ids = [
            store.open_object(store.workspace / f"{name}.ply", None, name).id
            for name in ("oven", "chair")
        ]

    def at(self, second: float, object: int, command: cmd.Command, who: str = "anna") -> None:
        """One command."""
        id, at = self.ids[object], BEGIN + timedelta(seconds=second)
        stamp = at.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        self.store.append(id, command, who, self.store.load(id).seq, at=stamp)

    def job(self, second: float, object: int, kind: str, seconds: float) -> None:
        """One job that was waited for."""
        start = BEGIN.timestamp() + second
        record_job(self.store.workspace, TimedJob(self.ids[object], kind, start, seconds))

    def click(self, second: float, object: int, part: int = 1, who: str = "anna") -> None:
        """A click, answered after half a second."""
        position = (0.1, 0.2, random.Random(second).random())
        self.at(second, object, cmd.AddClick(Click(position, part)), who)
        self.job(second, object, "segment", 0.5)

    def segment(self, second: float, object: int) -> None:
        """The segmenter's answer."""
        key = self.store.load(self.ids[object]).present.key
        counts = {i: 10 for i in range(5)}
        found = cmd.RecordSegmentation(key, self.labels, "default", 0.2, counts)
        self.at(second, object, found, "segmenter")

    def predict(self, asked: float, seconds: float, object: int) -> None:
        """A prediction that was asked for earlier."""
        self.job(asked, object, "predict", seconds)
        found = cmd.RecordPrediction(self.prediction, self.labels)
        self.at(asked + seconds, object, found)

    def log(self) -> WorkLog:
        """What is in the workspace now."""
        return read_work(self.store.workspace)


@pytest.fixture
def script(store: Store, labels_ref: str, prediction: Prediction) -> Script:
    return Script(store, labels_ref, prediction)


def morning(script: Script, cabinet: KinematicTree) -> None:
    """Anna takes the oven from opening to accepted in known steps, with a pause."""
    script.job(0, 0, "open", 4)  # she opens it, and sees it after 4 s
    for second, part in ((10, 1), (13, 2), (16, 3), (19, 4)):
        script.click(second, 0, part)
    script.segment(20, 0)
    script.at(119, 0, cmd.SetCategory("Oven"))  # away for 100 s
    script.predict(124, 40, 0)
    script.at(174, 0, cmd.SetJoint(replace(cabinet.joint_of["link_1"], upper=1.2)))
    script.at(180, 0, cmd.Undo())
    script.job(190, 0, "accept", 20)
    script.at(210, 0, cmd.Accept())
    script.at(210.1, 0, cmd.Saved("/assets/oven"))


def test_known_times_come_out(script: Script, cabinet: KinematicTree) -> None:
    morning(script, cabinet)
    log = script.log()
    acts = acts_of(log)
    steps = grouped(log, acts, "step")
    # Annotate: 10 s from opening to the first click, three clicks 3 s apart; after the pause the
    # category counts nothing. Joints: 5 s to P, the answer after 40 s is over PAUSE and waited
    # for, 10 s of looking, 6 s to the undo. Review: 10 s to Y, and the saving is nobody's time.
    assert {s: f.active for s, f in steps.items()} == pytest.approx(
        {"Annotate": 19.0, "Joints": 5 + 10 + 6, "Review": 10.0}
    )
    assert {s: f.waiting for s, f in steps.items()} == pytest.approx(
        {"Annotate": 4 + 3 * 0.5 + 0.5, "Joints": 40.0, "Review": 0.0}
    )
    (anna,) = grouped(log, acts, "person").values()
    assert (anna.objects, anna.accepted, anna.clicks, anna.commands) == (1, 1, 4, 9)
    assert anna.corrections == 2, "the edit of a predicted joint, and the undo"
    assert math.isnan(anna.per_hour) and anna.to_json()["accepted_per_hour"] is None
    assert replace(anna, accepted=10).per_hour == pytest.approx(36000 / 50)
    assert replace(anna, active=3600.0).per_hour == anna.accepted
    assert anna.cost(36.0) == pytest.approx(0.5)
    assert list(grouped(log, acts, "predictor")) == ["geometric 1"]
    assert list(grouped(log, acts, "category")) == ["oven"]
    assert list(grouped(log, acts, "day")) == ["2026-03-02"]
    assert grouped(log, acts, "person", BEGIN.timestamp() + 1000) == {}


def test_two_objects_two_people_and_bulk_work(script: Script, cabinet: KinematicTree) -> None:
    morning(script, cabinet)
    script.click(200, 1)  # anna goes on while the oven is saved
    script.click(205, 1, who="ben")
    script.click(212, 1, who="ben")
    script.job(300, 1, BULK, 20)
    script.at(310, 1, cmd.SetCategory("Chair"), "ben")
    script.at(315, 1, cmd.SetCategory("Armchair"), "ben")
    log = script.log()
    people = grouped(log, acts_of(log), "person")
    assert people["anna"].active == pytest.approx(50 + 10), "10 s from Y to the click on the chair"
    assert people["ben"].active == pytest.approx(7.0), "bulk work is nobody's time"
    assert people["ben"].commands == 4
    objects = grouped(log, acts_of(log), "object")
    assert {name: f.active for name, f in objects.items()} == pytest.approx(
        {"oven (1)": 50.0, "chair (2)": 17.0}
    )


def test_a_pause_begins_just_beyond_the_limit(script: Script) -> None:
    script.click(0, 0)
    script.click(PAUSE, 0, 2)
    script.click(2 * PAUSE + 0.1, 0, 3)
    assert figures_of(acts_of(script.log())).active == pytest.approx(PAUSE)


def test_a_slow_pick_begins_with_its_own_click_alone(script: Script) -> None:
    script.job(0, 0, "open", 1)
    script.job(2, 0, "pick", 6)
    script.click(8, 0)
    script.click(9, 0, 2)
    first, second = acts_of(script.log())
    assert (first.active, first.waiting) == pytest.approx((2.0, 1.0)), "asked for at 2 s"
    assert (second.active, second.waiting) == pytest.approx((7.0, 6.5)), "the answer came at 8 s"


def test_reopened_objects_are_not_accepted(script: Script, cabinet: KinematicTree) -> None:
    morning(script, cabinet)
    script.at(230, 0, cmd.Reopen(), "ben")
    log = script.log()
    found = grouped(log, acts_of(log), "person")
    assert {w: f.accepted for w, f in found.items()} == {"anna": 0, "ben": 0}
    assert set(grouped(log, acts_of(log), "step")) <= set(STEPS)


@pytest.mark.parametrize(
    ("kind", "seconds", "kept"),
    [
        ("pick", 0.01, False),
        ("pick", 0.3, True),
        ("segment", 0.04, False),
        ("open", 0.01, True),
        ("accept", 0.0, True),
        ("encode", 9.0, False),
        ("check", 9.0, False),
    ],
)
def test_openings_are_kept_however_short(kind: str, seconds: float, kept: bool) -> None:
    """An opening is an act, and its moment counts."""
    assert counts(kind, seconds) == kept


def test_damaged_lines_of_the_job_log_are_left_out(script: Script) -> None:
    script.job(0, 0, "open", 4)
    with (script.store.workspace / FILE).open("a") as file:
        file.write('{"object": 1, "kind": "open"\n[]\n{"object":1,"kind":"open","at":1,"seconds":')
        file.write("NaN}\n{}\n")
    script.job(9, 0, "open", 2)
    assert [job.seconds for job in script.log().jobs] == [4, 2]


def test_names_in_a_csv_are_no_formulas(script: Script) -> None:
    script.click(0, 0, who="=1+1")
    log = script.log()
    text = csv_text(rows_of(grouped(log, acts_of(log), "person"), "person", 20.0))
    (row,) = csv.DictReader(io.StringIO(text))
    assert row["person"] == "'=1+1" and row["clicks"] == "1" and row["cost_per_accepted"] == ""
