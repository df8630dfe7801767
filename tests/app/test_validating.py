"""The gate around accepting, on a real workbench with its worker processes."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.server import part_tasks as judging_tasks
from app.server.acceptances import asset_folder
from app.server.accepting import accept, withdraw
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.open_object import OpenObject
from app.server.part_tasks import parts_of
from app.server.validating import UnseenWarningsError
from model.core.articulated_object import Prediction
from model.core.errors import CommandError
from model.core.files import static_assets
from model.core.tree import KinematicTree
from model.physics.collision import build
from model.validation.report import Severity
from sessions import commands as cmd
from sessions.live import LiveSession
from sessions.store import PendingAcceptance, Store
from tests.app import job_functions
from tests.builders import CUPBOARD_DOOR as DOOR
from tests.builders import wait_until, write_cupboard


@pytest.fixture(scope="module")
def app_state(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AppState]:
    """A server with a cupboard in parts, whose door swings into its shelf."""
    folder = tmp_path_factory.mktemp("cupboard")
    source = write_cupboard(folder / "cupboard")
    config = ServeConfig(workspace=folder / "workspace")
    state = AppState(config, Store(folder / "workspace"), [source])
    yield state
    state.close()


@pytest.fixture(scope="module")
def cupboard(app_state: AppState, tmp_path_factory: pytest.TempPathFactory) -> OpenObject:
    """The cupboard, open, with its joint."""
    obj = app_state.object(app_state.queue.records()[0].id)
    # The parts that the source is in come with it: nothing of them waits behind other work.
    end = tmp_path_factory.mktemp("other") / "end"
    other = app_state.workers.geometry.submit(job_functions.wait_for, end)
    wait_until(lambda: len(obj.document.parts) == 2, "the source's parts")
    assert not other.done
    end.touch()
    wait_until(
        lambda: obj.document.segmentation is not None and obj.document.segmentation_current, "parts"
    )
    inward = replace(DOOR, axis=(0, 0, 1))
    tree = KinematicTree(("link_0", "link_1"), (inward,))
    labels = obj.document.segmentation.labels
    obj.do(cmd.RecordPrediction(Prediction(tree, confidence={"link_1": 0.4}), labels), "tester")
    return obj


def judged(obj: OpenObject) -> Any:
    return wait_until(lambda: obj.validation.report, "a verdict")


def test_a_broken_object_is_mended_or_accepted_with_a_reason(cupboard: OpenObject) -> None:
    obj = cupboard
    notes: list[tuple[str, str, str]] = []
    obj.watch(lambda: None, lambda *note: notes.append(note))

    # While the gate is at work an accept waits for it, and is refused then.
    if obj.validation.report is None:
        accept(obj, "", "tester")
        wait_until(lambda: any(n[0] in ("Not accepted", "Accepting") for n in notes), "it is told")
    report = judged(obj)
    assert report.severity == Severity.ERROR
    assert report.of("door").worst.other == "link_0"
    with pytest.raises(CommandError, match=r"1 error. part 1: .* give a reason for the override"):
        accept(obj, "", "tester")
    assert obj.document.review.state == "predicted"
    assert [c.joint for c in obj.checks] == ["door"]

    # The mend goes the way of every edit: the gate runs again, and undo brings the old answer.
    fix = obj.validation.fix("door", "flip")
    obj.do(cmd.SetJoint(fix.joint), "tester")
    assert obj.validation.report is not report
    assert judged(obj).severity == Severity.OK
    with pytest.raises(CommandError, match="validated again"):
        obj.validation.fix("door", "flip")
    obj.do(cmd.Undo(), "tester")
    assert obj.validation.report is report

    accept(obj, "as on the photo", "tester", "the shelf is soft")
    notes.clear()
    accept(obj, "as on the photo", "tester", "the shelf is soft")
    assert ("Accepting", "It is being saved already", "gray") in notes
    saved = wait_until(lambda: obj.document.saved, "it is saved")
    review = obj.document.review
    assert (review.state, review.override) == ("accepted", "the shelf is soft")
    assert review.problems[0].startswith("door: Penetrates ") or "Blocked" in review.problems[0]
    gate = json.loads((Path(saved.folder) / "provenance.json").read_text())["gate"]
    assert gate["verdict"] == "broken"
    assert gate["override"] == "the shelf is soft"
    assert gate["joints"][0]["sentence"] == report.joints[0].message

    # Mended, no reason is asked for, and the record says that all is well.
    obj.do(cmd.Reopen(), "tester")
    obj.do(cmd.SetJoint(DOOR), "tester")
    judged(obj)
    # What is fine is written while the person still looks; accepting moves it.
    drafts = obj.services.workspace / "drafts"
    wait_until(lambda: any(not p.name.startswith(".") for p in drafts.glob("*")), "a draft")
    accept(obj, "", "tester")
    wait_until(lambda: obj.document.review.state == "accepted", "accepted again")
    wait_until(lambda: "save" not in obj.busy, "saved again")
    wait_until(lambda: not any(drafts.iterdir()), "no draft is left")
    gate = json.loads((Path(obj.document.saved.folder) / "provenance.json").read_text())["gate"]
    assert (gate["verdict"], gate["override"]) == ("fine", "")
    assert obj.document.review.problems == ()
    assert np.isfinite(gate["joints"][0]["depth"])


def test_what_is_offered_for_many_has_been_checked(
    cupboard: OpenObject, app_state: AppState
) -> None:
    obj, asked = cupboard, {"ids": "1", "above": "50"}
    if obj.document.review.state == "accepted":
        obj.do(cmd.Reopen(), "tester")
    labels = obj.document.segmentation.labels
    sure = Prediction(KinematicTree(("link_0", "link_1"), (DOOR,)), confidence={"link_1": 0.9})
    obj.do(cmd.RecordPrediction(sure, labels), "tester")
    judged(obj)
    assert app_state.gallery.rows(asked) == {"ids": [obj.record.id], "unchecked": []}
    turned = replace(sure, tree=sure.tree.with_joint(replace(DOOR, axis=(0, 0, 1))))
    obj.do(cmd.RecordPrediction(turned, labels), "tester")
    if obj.validation.report is None:  # not before somebody looks
        assert app_state.gallery.rows(asked) == {"ids": [], "unchecked": [obj.record.id]}
    obj.validation.update()
    wait_until(lambda: app_state.gallery.passed(app_state.queue.records()[0]) is False, "known")
    said: list[str] = []
    app_state.bulk.check([obj.record.id], lambda *note: said.append(note[1]))
    wait_until(lambda: said, "it is checked")
    assert said == ["1 of 1 done"]
    assert app_state.gallery.rows(asked) == {"ids": [], "unchecked": []}


def test_an_unlikely_size_is_a_warning_and_its_fix_keeps_the_work(cupboard: OpenObject) -> None:
    obj = cupboard
    if obj.document.review.state == "accepted":
        obj.do(cmd.Reopen(), "tester")
    obj.do(cmd.SetJoint(DOOR), "tester")
    judged(obj)
    obj.do(cmd.SetCategory("Refrigerator"), "tester")
    assert judged(obj).of("").message == "0.4 m high; refrigerator: usually 1.5 to 1.9 m."
    with pytest.raises(UnseenWarningsError, match=r"1 warning\. base: 0\.4 m high"):
        accept(obj, "", "tester")
    fix = obj.validation.fix("", "size")
    before = obj.document
    obj.preparing.turn(np.diag([fix.scale] * 3 + [1.0]), "1.7 m high", "tester")
    doc = obj.document
    assert doc.tree.by_name["door"].origin == pytest.approx([fix.scale * v for v in DOOR.origin])
    assert doc.segmentation_current and not doc.prediction_stale
    assert (doc.prompts, doc.segmentation.labels) == (before.prompts, before.segmentation.labels)
    wait_until(lambda: obj.asset and "open" not in obj.jobs, "it is read again")
    assert obj.asset.bounds[1, 2] == pytest.approx(1.69, abs=0.01)
    assert judged(obj).severity == Severity.OK
    for _ in range(2):
        obj.do(cmd.Undo(), "tester")
    wait_until(lambda: obj.asset and "open" not in obj.jobs, "it is read again")
    assert (obj.document.tree, obj.document.category) == (before.tree, None)


def test_an_asset_comes_back_where_the_next_one_is_not_accepted(cupboard: OpenObject) -> None:
    obj = cupboard
    notes: list[str] = []
    obj.watch(lambda: None, lambda *note: notes.append(note[0]))
    obj.do(cmd.SetJoint(DOOR), "tester")
    judged(obj)
    if obj.document.review.state != "accepted":
        accept(obj, "", "tester")
        wait_until(lambda: obj.document.review.state == "accepted", "accepted")
    saved = wait_until(lambda: obj.document.saved, "saved")
    before = (Path(saved.folder) / "provenance.json").read_bytes()
    obj.do(cmd.Reopen(), "tester")
    obj.do(cmd.SetJoint(replace(DOOR, upper=1.2)), "tester")
    judged(obj)
    obj.services.workers.saving.submit(time.sleep, 1.0, priority=9)
    accept(obj, "too early", "tester")
    obj.do(cmd.SetJoint(replace(DOOR, upper=1.1)), "tester")
    wait_until(lambda: "Not accepted" in notes, "it is told")
    assert obj.document.review.state != "accepted"
    assert not Path(saved.folder).exists(), "it is reopened"
    while obj.document.review.state != "accepted":
        obj.do(cmd.Undo(), "tester")
    assert (Path(saved.folder) / "provenance.json").read_bytes() == before


def test_what_the_gate_wants_looked_at_is_not_accepted_unseen(cupboard: OpenObject) -> None:
    obj = cupboard
    if obj.document.review.state == "accepted":
        obj.do(cmd.Reopen(), "tester")
    # The hinge lies beside the board's edge: the door runs 12 mm into it, which may be meant.
    obj.do(cmd.SetJoint(replace(DOOR, origin=(-0.28, -0.003, 0.2))), "tester")
    said: list[CommandError] = []
    if obj.validation.report is None:  # asked for before the gate has answered: told, not accepted
        accept(obj, "", "tester", refused=said.append)
        wait_until(lambda: said, "it is told to whoever asked")
        assert isinstance(said[0], UnseenWarningsError)
    report = judged(obj)
    assert report.severity == Severity.WARNING
    with pytest.raises(UnseenWarningsError, match=r"1 warning.*Press Y again"):
        accept(obj, "", "tester")
    assert obj.document.review.state != "accepted"

    # What was seen of other joints doesn't count.
    obj.do(cmd.SetJoint(replace(DOOR, origin=(-0.279, -0.003, 0.2))), "tester")
    judged(obj)
    with pytest.raises(UnseenWarningsError):
        accept(obj, "", "tester", seen=report)
    accept(obj, "", "tester", seen=obj.validation.report)
    wait_until(
        lambda: obj.document.review.state == "accepted" and "save" not in obj.busy, "accepted"
    )
    gate = json.loads((Path(obj.document.saved.folder) / "provenance.json").read_text())["gate"]
    assert (gate["verdict"], gate["looked_at"]) == ("look", True)


def test_what_another_person_decided_meanwhile_is_not_overruled(cupboard: OpenObject) -> None:
    obj = cupboard
    if obj.document.review.state == "accepted":
        obj.do(cmd.Reopen(), "tester")
    obj.do(cmd.SetJoint(DOOR), "tester")
    said: list[CommandError] = []
    judged(obj)
    store = Store(obj.services.workspace)
    elsewhere = LiveSession(store, obj.record.id)  # as of another server
    busy = obj.services.workers.saving.submit(time.sleep, 0.5, priority=9)
    wait_until(lambda: busy.state == "running", "saving is held up")
    accept(obj, "", "tester", refused=said.append)
    elsewhere.do(cmd.Reject("axis"), "rob")
    store.close()
    wait_until(lambda: said, "it is told")
    assert "rejected meanwhile by rob" in str(said[0])
    assert obj.document.review.state == "rejected"

    # Nor while the gate is still at work, and what was edited meanwhile is another object.
    for upper, meanwhile, told in (
        (1.3, cmd.Reject("axis"), "rejected meanwhile by rob"),
        (1.31, cmd.SetJoint(replace(DOOR, upper=1.32)), "edited meanwhile"),
    ):
        said.clear()
        busy = obj.services.workers.prediction.submit(time.sleep, 0.5, priority=9)
        wait_until(lambda busy=busy: busy.state == "running", "the gate is held up")
        obj.do(cmd.SetJoint(replace(DOOR, upper=upper)), "tester")
        assert obj.validation.report is None
        accept(obj, "", "tester", refused=said.append)
        obj.do(meanwhile, "rob")
        wait_until(lambda: said or obj.document.review.state == "accepted", "it is told")
        assert said and told in str(said[0])
        assert obj.document.review.state != "accepted"


def test_what_the_predictor_does_not_believe_is_not_accepted_unseen(cupboard: OpenObject) -> None:
    obj = cupboard
    if obj.document.review.state == "accepted":
        obj.do(cmd.Reopen(), "tester")
    labels = obj.document.segmentation.labels
    tree = KinematicTree(("link_0", "link_1"), (DOOR,))
    obj.do(cmd.RecordPrediction(Prediction(tree, confidence={"link_1": 0.02}), labels), "tester")
    report = judged(obj)
    assert report.severity == Severity.WARNING  # though nothing is in its way
    assert report is obj.validation.report
    with pytest.raises(UnseenWarningsError, match="Low confidence"):
        accept(obj, "", "tester")
    # What a person settled is nobody's guess any more.
    obj.do(cmd.LockJoint("link_1", True), "tester")
    assert judged(obj).severity == Severity.OK
    obj.do(cmd.LockJoint("link_1", False), "tester")
    assert judged(obj).severity == Severity.WARNING
    accept(obj, "", "tester", seen=obj.validation.report)
    wait_until(
        lambda: obj.document.review.state == "accepted" and "save" not in obj.busy, "accepted"
    )
    gate = json.loads((Path(obj.document.saved.folder) / "provenance.json").read_text())["gate"]
    assert (gate["verdict"], gate["looked_at"]) == ("look", True)
    assert gate["joints"][0]["findings"][0]["kind"] == "unsure"


def test_what_the_gate_said_is_kept(cupboard: OpenObject, monkeypatch: pytest.MonkeyPatch) -> None:
    tree = cupboard.document.tree
    assert tree is not None
    source = cupboard.source()
    first = judging_tasks.validate_joints(source, tree)
    monkeypatch.setattr(judging_tasks, "validate", None)
    assert judging_tasks.validate_joints(source, tree) == first
    other = replace(tree, joints=(replace(tree.joints[0], upper=0.7), *tree.joints[1:]))
    with pytest.raises(TypeError):
        judging_tasks.validate_joints(source, other)
    monkeypatch.setattr(judging_tasks, "validation_version", lambda: "another")
    with pytest.raises(TypeError):
        judging_tasks.validate_joints(source, tree)


def test_what_was_kept_is_forgotten_when_a_threshold_changes(tmp_path: Path) -> None:
    for package in judging_tasks.DEPENDENCIES:
        shutil.copytree(static_assets().parent / "model" / package, tmp_path / "model" / package)
    assert judging_tasks.validation_version(tmp_path) == judging_tasks.validation_version()
    examine = tmp_path / "model" / "validation" / "examine.py"
    examine.write_text(examine.read_text() + "\nSHALLOW = 0.02\n")
    judging_tasks.validation_version.cache_clear()
    assert judging_tasks.validation_version(tmp_path) != judging_tasks.validation_version()


def test_bodies_are_made_while_joints_are_predicted(
    cupboard: OpenObject, app_state: AppState, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the process that would be idle; most of what the gate waits for knows no joint."""
    obj = cupboard
    if obj.document.review.state == "accepted":
        with pytest.raises(CommandError, match="reopen it"):
            obj.predict("tester")  # at once, not after the prediction
        obj.do(cmd.Reopen(), "tester")
    shutil.rmtree(app_state.workspace / "collision", ignore_errors=True)
    held = app_state.workers.prediction.submit(time.sleep, 600.0, priority=99)
    wait_until(lambda: held.state == "running", "prediction is held up")
    obj.predict("tester")
    wait_until(
        lambda: len(list((app_state.workspace / "collision").glob("*.npz"))) == 2, "both bodies"
    )
    monkeypatch.setattr(build, "hollow_bodies", None)
    build.prepare_bodies(parts_of(obj.source()), app_state.workspace / "collision")
    obj.jobs.cancel("predict")
    held.cancel()
    wait_until(lambda: "predict" not in obj.jobs, "it is cancelled")


def test_what_was_said_while_the_joints_were_being_judged_is_kept(
    cupboard: OpenObject, app_state: AppState
) -> None:
    obj = cupboard
    if obj.document.review.state == "accepted":
        obj.do(cmd.Reopen(), "tester")
    refused: list[CommandError] = []
    for upper, reason, accepted in ((1.04, "", False), (1.03, "it gives way", True)):
        held = app_state.workers.prediction.submit(time.sleep, 600.0, priority=99)
        wait_until(lambda held=held: held.state == "running", "judging is held up")
        obj.do(cmd.SetJoint(replace(DOOR, axis=(0, 0, 1), upper=upper)), "tester")
        refused.clear()
        accept(obj, "seen in person", "tester", reason, refused=refused.append)
        kept = PendingAcceptance(obj.state.seq, "seen in person", reason)
        assert app_state.store.pending_acceptances() == {obj.record.id: kept}
        held.cancel()
        judged(obj)
        wait_until(
            lambda: not obj.jobs and (refused or not app_state.store.pending_acceptances()),
            "it is decided",
        )
        assert (obj.document.review.state == "accepted", bool(refused)) == (accepted, not accepted)


def test_what_the_gate_holds_back_after_a_person_went_on_waits_for_another_look(
    cupboard: OpenObject, app_state: AppState
) -> None:
    obj = cupboard
    if obj.document.review.state == "accepted":
        obj.do(cmd.Reopen(), "tester")
    told: list[None] = []
    app_state.queue.subscribe(lambda: told.append(None))
    held = app_state.workers.prediction.submit(time.sleep, 600.0, priority=99)
    wait_until(lambda: held.state == "running", "judging is held up")
    obj.do(cmd.SetJoint(replace(DOOR, axis=(0, 0, 1), upper=1.02)), "tester")
    told.clear()
    accept(obj, "seen in person", "ann")
    record = app_state.store.object(obj.record.id)
    assert (
        told
        and obj.validation.acceptance_waits
        and app_state.is_accepting(record.id)
        and obj.in_use
    )
    accept(obj, "", "rob")  # in another tab: what the first one typed stays
    assert app_state.store.pending_acceptances()[record.id].comment == "seen in person"
    held.cancel()
    why = wait_until(lambda: app_state.on_hold(record), "it is held back")
    assert "1 error. part 1" in why and obj.hold_reason == why
    assert obj.document.review.state != "accepted" and not obj.interrupted
    assert not app_state.is_accepting(record.id) and "save" not in obj.jobs
    kept = PendingAcceptance(record.seq, "seen in person", "", why)
    assert obj.pending_acceptance == kept and app_state.store.pending_acceptances() == {
        record.id: kept
    }
    app_state.sync_remote()
    assert app_state.on_hold(record) == why
    # The next server says so, too.
    other = AppState(app_state.config, Store(app_state.workspace), [Path(obj.record.path)])
    try:
        assert other.on_hold(record) == why and not other.was_interrupted(record)
    finally:
        other.close()
    # What is changed is another object; asked for with a reason it is accepted.
    obj.do(cmd.SetJoint(replace(DOOR, axis=(0, 0, 1), upper=1.01)), "tester")
    assert not obj.hold_reason and not app_state.on_hold(app_state.store.object(record.id))
    judged(obj)
    accept(obj, "", "ann", "it gives way")
    wait_until(lambda: obj.document.review.state == "accepted" and not obj.jobs, "accepted")
    wait_until(lambda: not app_state.store.pending_acceptances(), "it is over")


def test_a_wish_hears_at_once_that_the_joints_changed(
    cupboard: OpenObject, app_state: AppState
) -> None:
    """Also where nothing will be judged any more."""
    obj = cupboard
    if obj.document.review.state == "accepted":
        obj.do(cmd.Reopen(), "tester")
    held = app_state.workers.prediction.submit(time.sleep, 600.0, priority=99)
    wait_until(lambda: held.state == "running", "judging is held up")
    obj.do(cmd.SetJoint(replace(DOOR, upper=0.97)), "tester")
    said: list[CommandError] = []
    accept(obj, "", "ann", refused=said.append)
    assert not said and obj.validation.acceptance_waits
    obj.do(cmd.SetJoint(replace(DOOR, upper=0.96)), "rob")
    wait_until(lambda: said, "it is told")
    assert (
        "edited meanwhile" in str(said[0])
        and not obj.validation.acceptance_waits
        and not obj.hold_reason
    )
    held.cancel()
    judged(obj)
    assert obj.document.review.state != "accepted" and not app_state.store.pending_acceptances()


def test_a_wish_can_be_taken_back(cupboard: OpenObject, app_state: AppState) -> None:
    obj = cupboard
    if obj.document.review.state == "accepted":
        obj.do(cmd.Reopen(), "tester")
    notes: list[tuple[str, str, str]] = []
    stop = obj.watch(lambda: None, lambda *note: notes.append(note))
    assert not withdraw(obj) and not notes
    held = app_state.workers.prediction.submit(time.sleep, 600.0, priority=99)
    wait_until(lambda: held.state == "running", "judging is held up")
    obj.do(cmd.SetJoint(replace(DOOR, upper=0.94)), "tester")
    accept(obj, "seen in person", "ann")
    assert app_state.is_accepting(obj.record.id) and app_state.store.pending_acceptances()
    # Another object is on the screen by the time that it is read.
    waits = f"{obj.record.name}: when the checks pass"
    assert notes[-1] == ("Accepting", waits, "blue")
    assert withdraw(obj)
    assert notes[-1] == ("Not accepted", "Cancelled before the checks were done", "gray")
    assert not app_state.is_accepting(obj.record.id) and not app_state.store.pending_acceptances()
    held.cancel()
    assert judged(obj).severity == Severity.OK
    wait_until(lambda: not obj.jobs, "nothing goes on")
    assert obj.document.review.state != "accepted" and not obj.hold_reason and not obj.interrupted
    stop()


def test_what_could_not_be_judged_is_not_accepted_unseen(
    cupboard: OpenObject, app_state: AppState
) -> None:
    obj = cupboard
    judged(obj)
    held = app_state.workers.prediction.submit(time.sleep, 600.0, priority=99)
    wait_until(lambda: held.state == "running", "judging is held up")
    obj.do(cmd.SetJoint(replace(DOOR, upper=0.95)), "tester")
    wait_until(lambda: "check" in obj.jobs, "the gate is asked")
    accept(obj, "", "ann")
    obj.validation.failed("its process ended")
    assert "checks failed: its process ended" in obj.hold_reason
    assert obj.document.review.state != "accepted" and "save" not in obj.jobs
    held.cancel()
    judged(obj)
    obj.do(cmd.SetJoint(DOOR), "tester")
    judged(obj)


def test_what_a_server_was_accepting_when_it_ended_is_told_at_the_next_start(
    cupboard: OpenObject, app_state: AppState, tmp_path: Path
) -> None:
    obj, before = cupboard, app_state
    if obj.document.review.state == "accepted":
        obj.do(cmd.Reopen(), "tester")
    obj.do(cmd.SetJoint(replace(DOOR, upper=1.05)), "tester")
    judged(obj)
    held = before.workers.saving.submit(time.sleep, 600.0, priority=9)
    wait_until(lambda: held.state == "running", "saving is held up")
    accept(obj, "hinge seen in person", "tester", "it gives way")
    wait_until(lambda: "save" in obj.busy, "it is being saved")
    before.close()
    source = [Path(obj.record.path)]

    state = AppState(before.config, Store(before.workspace), source)
    try:
        (record,) = state.queue.records()
        assert record.state != "accepted" and state.was_interrupted(record)
        notes: list[tuple[str, ...]] = []
        again = state.object(record.id)
        again.watch(lambda: None, lambda *note: notes.append(note))
        judged(again)
        assert again.interrupted
        assert again.pending_acceptance == PendingAcceptance(
            again.state.seq, "hinge seen in person", "it gives way"
        )
        assert any(n[0] == "Not accepted yet" and "Press Y to accept" in n[1] for n in notes)
        accept(again, "", "tester")
        wait_until(lambda: again.document.review.state == "accepted" and not again.jobs, "accepted")
        wait_until(lambda: not state.store.pending_acceptances(), "nothing is pending")
        assert not again.interrupted
        assert not state.was_interrupted(*state.queue.records())
        folder = Path(again.document.saved.folder)
    finally:
        state.close()

    # One that was decided, and whose asset was just taking the place of another one.
    store = Store(tmp_path)
    (known,) = store.open_objects([(source[0], None, "cupboard")])
    history = Store(before.workspace).history(record.id)
    first = next(e.seq for e in history if isinstance(e.command, cmd.Accept))
    for e in history[:first]:
        store.append(known.id, e.command, e.who, e.seq - 1, at=e.at)
    store.begin_acceptance(known.id, PendingAcceptance(first - 1))
    store.close()
    target = asset_folder(tmp_path, known)
    shutil.copytree(folder, target.with_name(f".{target.name}.0123456789ab.old"))
    config = replace(before.config, workspace=tmp_path)
    state = AppState(config, Store(tmp_path), source)
    try:
        assert (target / "provenance.json").is_file() and not state.store.pending_acceptances()
        saved = state.store.load(known.id).present.saved
        assert saved is not None and Path(saved.folder) == target
        assert not state.was_interrupted(*state.queue.records())
    finally:
        state.close()


def test_what_another_server_is_saving_is_told_until_that_ends(
    cupboard: OpenObject, tmp_path: Path
) -> None:
    """Also where it ends without a decision, as when it is cancelled."""
    store = Store(tmp_path)
    (known,) = store.open_objects([(Path(cupboard.record.path), None, "cupboard")])
    store.begin_acceptance(known.id, PendingAcceptance(known.seq))
    config = replace(cupboard.services.config, workspace=tmp_path)
    state = AppState(config, Store(tmp_path), [Path(cupboard.record.path)])
    try:
        told: list[None] = []
        state.queue.subscribe(lambda: told.append(None))
        state.sync_remote()
        assert state.was_interrupted(*state.queue.records()) and not told
        store.end_acceptance(known.id)
        state.sync_remote()
        assert not state.was_interrupted(*state.queue.records()) and told
    finally:
        state.close()
        store.close()
