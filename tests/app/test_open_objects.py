"""Objects that can't be opened, and objects that nobody looks at any more."""

from __future__ import annotations

import gc
import os
import signal
import time
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from app.server import app_state as workbench
from app.server import display_tasks, segmenting_tasks
from app.server.acceptances import AssetDrafts
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.job import Job
from app.server.open_object import OpenObject
from app.server.workers import READ_CANCELLED
from model.core.errors import CommandError
from model.core.geometry import Mesh
from model.geometry.sampling import sample_surface
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.live import LiveSession
from sessions.store import Store
from tests.app.job_functions import (
    click_slowly,
    killed_while_opening,
    reads_for_ever,
    segment_and_die_of_two,
)
from tests.builders import boxes, wait_until
from tests.raw_scans import raw_scan

GOOD = trimesh.creation.box((1, 0.5, 0.7))


def settled(app_state: AppState, number: int) -> OpenObject:
    obj = app_state.object(number)
    wait_until(lambda: obj.asset and not obj.jobs, "it is open and nothing is under way")
    return obj


@pytest.fixture
def begin_app(tmp_path: Path) -> Iterator[Callable[..., AppState]]:
    made: list[AppState] = []

    def begin(*paths: Path) -> AppState:
        workspace = tmp_path / "workspace"
        config = ServeConfig(workspace=workspace)
        made.append(AppState(config, Store(workspace), list(paths)))
        return made[-1]

    yield begin
    for app_state in made:
        app_state.close()


def test_a_file_that_changed_is_tried_again(begin_app, tmp_path: Path) -> None:
    path = tmp_path / "box.ply"
    path.write_bytes(b"ply\nformat ascii 1.0\n")
    app_state = begin_app(path)
    number = app_state.queue.records()[0].id
    obj = app_state.object(number)
    wait_until(lambda: obj.problem, "the problem")
    app_state.object(number)
    assert obj.problem and "open" not in obj.jobs
    assert obj.problem.startswith("box.ply: ")  # where it is kept is nothing to tell
    assert app_state.queue.unreadable == {number}
    GOOD.export(path)
    app_state.object(number)
    wait_until(lambda: obj.asset, "it opens")
    assert obj.problem is None and not app_state.queue.unreadable


def test_what_cannot_be_read_is_taken_off_the_queue_and_put_back(begin_app, tmp_path: Path) -> None:
    app_state = begin_app()
    GOOD.export(tmp_path / "good.ply")
    (good,) = app_state.queue.add([tmp_path / "good.ply"])
    bad = app_state.add_upload("bad.ply", b"ply\nformat ascii 1.0\n")
    path = app_state.store.object(bad).path
    with pytest.raises(CommandError, match="only unreadable"):
        app_state.queue.remove(good)
    obj = app_state.object(bad)
    wait_until(lambda: obj.problem, "the problem")
    obj.do(cmd.SetCategory("Box"), "tester")
    before = [r.id for r in app_state.queue.records()]
    app_state.queue.remove(bad)
    assert [r.id for r in app_state.queue.records()] == [i for i in before if i != bad]
    assert path.is_file() and app_state.store.load(bad).present.category == "Box"
    assert app_state.queue.restore() == bad and not app_state.queue.removed
    assert sorted(r.id for r in app_state.queue.records()) == sorted(before)
    app_state.queue.remove(bad)
    assert app_state.add_upload("bad.ply", path.read_bytes()) == bad  # so it is back as well
    assert app_state.queue.records()[-1].id == bad and not app_state.queue.removed
    with pytest.raises(CommandError, match="nothing was removed"):
        app_state.queue.restore()


def test_what_was_given_or_decided_is_there_after_a_restart(begin_app, tmp_path: Path) -> None:
    good, other, new = (tmp_path / f"{name}.ply" for name in ("good", "other", "new"))
    for path in (good, other, new):
        GOOD.export(path)
    app_state = begin_app(good, other)
    decided, untouched = (r.id for r in app_state.queue.records())
    app_state.store.append(decided, cmd.AddClick(Click((0, 0, 0), 1)), who="ann", expected_seq=0)
    uploaded = app_state.add_upload("mine.ply", good.read_bytes())
    app_state.close()
    later = begin_app(new)
    (first, *rest) = [r.id for r in later.queue.records()]
    assert rest == [decided, uploaded] and first not in (decided, uploaded, untouched)
    (tmp_path / "good.ply").unlink()
    assert [r.id for r in begin_app(new).queue.records()] == [first, uploaded]


def test_what_was_taken_off_stays_off_at_the_next_start(begin_app, tmp_path: Path) -> None:
    good, *bad = (tmp_path / f"{name}.ply" for name in ("good", "one", "two"))
    GOOD.export(good)
    for path in bad:
        path.write_bytes(b"ply\nformat ascii 1.0\n")
    app_state = begin_app(good, *bad)
    ids = [r.id for r in app_state.queue.records()]
    for number in ids[:0:-1]:
        obj = app_state.object(number)
        wait_until(lambda obj=obj: obj.problem, "the problem")
        app_state.queue.remove(number)
    later = begin_app(good, *bad)
    assert [r.id for r in later.queue.records()] == ids[:1]
    assert later.queue.removed == tuple(ids[:0:-1])
    assert later.queue.restore() == ids[1]
    again = begin_app(good, *bad)
    assert [r.id for r in again.queue.records()] == ids[:2] and again.queue.removed == (ids[2],)
    assert [r.id for r in begin_app(bad[1]).queue.records()] == [ids[2]]  # it is all there is
    GOOD.export(bad[1])  # mended
    assert [r.id for r in begin_app(good, *bad).queue.records()] == ids


def test_it_is_tried_again_where_its_worker_died_or_a_person_asks(
    begin_app, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "box.ply"
    GOOD.export(path)
    app_state = begin_app(path)
    number = app_state.queue.records()[0].id
    with monkeypatch.context() as patch:
        patch.setattr(display_tasks, "open_asset", killed_while_opening)
        obj = app_state.object(number)
        wait_until(lambda: obj.problem, "the worker died")
        obj.try_again()
        wait_until(lambda: obj.problem, "it died again")
    assert "killed" in obj.problem
    app_state.object(number)
    wait_until(lambda: obj.asset, "it opens")


def test_objects_that_nobody_looks_at_are_let_go_and_come_back(
    begin_app, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workbench, "OPEN_KEPT", 1)
    paths = [tmp_path / f"box_{i}.ply" for i in range(3)]
    for path in paths:
        GOOD.export(path)
    app_state = begin_app(*paths)
    first, shown, other = [r.id for r in app_state.queue.records()]
    opened = settled(app_state, first)
    opened.do(cmd.AddPart(1, "door"), "tester")
    opened.do(cmd.SetCategory("Oven"), "tester")
    before = weakref.ref(opened)
    del opened  # nothing but the application holds it
    looked_at = settled(app_state, shown)
    stop = looked_at.watch(lambda: None, lambda *_: None)
    settled(app_state, other)
    gc.collect()
    assert before() is None
    assert app_state.object(shown) is looked_at
    back = settled(app_state, first)
    assert back.document.part_names == {1: "door"} and back.document.category == "Oven"
    back.do(cmd.Undo(), "tester")
    assert back.document.category is None
    stop()
    app_state.object(other)
    assert app_state.object(shown) is not looked_at


def test_the_next_object_is_open_before_it_is_shown(begin_app, tmp_path: Path) -> None:
    for name in ("one", "two"):
        GOOD.export(tmp_path / f"{name}.ply")
    app_state = begin_app(tmp_path / "one.ply", tmp_path / "two.ply")
    first, second = [r.id for r in app_state.queue.records()]
    one = settled(app_state, first)
    stop = one.watch(lambda: None, lambda *_: None)
    app_state.open_ahead(second, one)
    two = settled(app_state, second)
    assert two.lane is one.lane and not two.is_shown
    stop()
    one.watch(lambda: None, lambda *_: None, shows=False)  # follows what becomes of it
    two.watch(lambda: None, lambda *_: None)
    assert two.lane is one.lane, "which has it encoded"


def test_an_object_whose_reading_stops_just_before_it_is_shown_is_read(
    begin_app, tmp_path: Path
) -> None:
    GOOD.export(tmp_path / "one.ply")
    app_state = begin_app(tmp_path / "one.ply")
    (record,) = app_state.queue.records()
    held = app_state.workers.reading.submit(time.sleep, 0.3, priority=99)
    obj = app_state.object(record.id)
    obj.left()
    assert app_state.object(record.id) is obj
    wait_until(lambda: held.done and not obj.jobs, "its reading has stopped")
    assert obj.asset is None
    obj.watch(lambda: None, lambda *_: None)
    wait_until(lambda: obj.asset, "it is read", 60)


def test_a_tilted_scan_that_is_opened_ahead_is_not_encoded_as_it_lies(
    begin_app, tmp_path: Path
) -> None:
    GOOD.export(tmp_path / "one.ply")
    raw_scan(tmp_path / "two.ply", seed=3, every=5)
    app_state = begin_app(tmp_path / "one.ply", tmp_path / "two.ply")
    first, second = [r.id for r in app_state.queue.records()]
    one = settled(app_state, first)
    stop = one.watch(lambda: None, lambda *_: None)
    app_state.open_ahead(second, one)
    two, kinds = app_state.object(second, keep=0.0), set()
    two.watch(lambda: kinds.update(two.busy), lambda *_: None, shows=False)
    wait_until(lambda: two.preparing.current and not two.jobs, "it is read and found tilted")
    assert two.preparing.tilt and "prepare" in kinds and "encode" not in kinds
    stop()


def test_what_was_undone_before_it_was_answered_is_not_shown(begin_app, tmp_path: Path) -> None:
    path = tmp_path / "box.ply"
    GOOD.export(path)
    app_state = begin_app(path)
    obj = settled(app_state, app_state.queue.records()[0].id)

    def undone(command: Any) -> None:
        busy = app_state.workers.segmentation.submit(time.sleep, 0.3, priority=99)
        wait_until(lambda: busy.state == "running", "the segmenter is held up")
        obj.do(cmd.AddClick(Click((0.5, 0.0, 0.0), 1)), "tester")
        obj.do(command, "tester")
        wait_until(lambda: busy.done and not obj.jobs, "nothing is under way")

    undone(cmd.Undo())
    assert obj.labels is None and not obj.document.prompts
    obj.do(cmd.AddClick(Click((0.0, 0.0, 0.35), 2)), "tester")
    wait_until(lambda: obj.document.segmentation_current and not obj.jobs, "it is answered")
    assert obj.labels is not None and set(obj.labels.tolist()) == {0, 2}
    undone(cmd.Undo())
    assert set(obj.labels.tolist()) == {0, 2}
    # The answer is about elements that are none any more.
    undone(cmd.SetFrame("x", 1.0))
    assert obj.labels is None and obj.asset is not None


def test_what_another_server_did_is_seen(begin_app, tmp_path: Path) -> None:
    for name in ("first", "second"):
        GOOD.export(tmp_path / f"{name}.ply")
    app_state = begin_app(tmp_path / "first.ply", tmp_path / "second.ply")
    first, second = (r.id for r in app_state.queue.records())
    obj = settled(app_state, first)
    notes: list[tuple[str, str, str]] = []
    obj.watch(lambda: None, lambda *note: notes.append(note))
    obj.do(cmd.SetCategory("Box"), "ann")
    app_state.sync_remote()
    assert not notes
    store = Store(tmp_path / "workspace")
    for number in (first, second):
        LiveSession(store, number).do(cmd.AddPart(1, "lid"), "rob")
    store.close()
    app_state.sync_remote()
    assert obj.document.part_names == {1: "lid"} and obj.document.category == "Box"
    assert [n[0] for n in notes] == ["Changed elsewhere"]
    assert [r.parts for r in app_state.queue.records()] == [2, 2]


def test_who_waits_for_a_draft_hears_how_far_it_is() -> None:
    """It is written since the joints were judged; the bar stood at nothing until it was there."""
    source: Any = "the parts"
    tree: Any = "the joints"
    heard: list[Any] = []

    def submit(*_: Any, **__: Any) -> Any:
        return SimpleNamespace(listen=heard.append, cancel=lambda: heard.append("cancelled"))

    drafts = AssetDrafts(SimpleNamespace(submit=submit))  # type: ignore[arg-type]
    drafts.prepare(source, tree)
    drafts.finish(source, tree, print)
    assert heard == [print]
    drafts.prepare("other parts", tree)  # type: ignore[arg-type]
    assert heard == [print]  # what is looked at next doesn't stop it
    drafts.finish(source, "other joints", print)  # type: ignore[arg-type]
    assert heard == [print, "cancelled"]


def test_a_click_whose_worker_is_killed_is_answered_by_the_next_one(
    begin_app, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "box.ply"
    GOOD.export(path)
    app_state = begin_app(path)
    obj = settled(app_state, app_state.queue.records()[0].id)
    said: list[tuple[str, ...]] = []
    obj.watch(lambda: None, lambda *words: said.append(words))
    monkeypatch.setattr(segmenting_tasks, "segment", segment_and_die_of_two)
    obj.do(cmd.AddClick(Click((0.0, 0.0, 0.35), 1)), "ann")
    wait_until((tmp_path / "workspace" / "began").exists, "it is being answered")
    os.kill(app_state.workers.segmentation.pid, signal.SIGKILL)
    wait_until(lambda: obj.document.segmentation_current and obj.labels is not None, "labels")
    assert obj.labels is not None and (obj.labels == 1).any() and not said
    obj.do(cmd.AddClick(Click((0.0, 0.0, -0.35), 2)), "ann")
    wait_until(lambda: said, "it killed two")
    ((title, body, _),) = said
    assert title == "Failed" and "second time" in body and "isn't tried again" in body
    assert len(obj.document.prompts) == 2 and not obj.document.segmentation_current
    obj.do(cmd.AddClick(Click((0.5, 0.0, 0.0), 2)), "ann")  # the next click answers for both
    wait_until(lambda: obj.document.segmentation_current, "both clicks")


DOWN = (0.1, 0.1, 5.0), (0.0, 0.0, -1.0), None


def test_a_click_is_one_job_and_one_command(begin_app, tmp_path: Path) -> None:
    GOOD.export(tmp_path / "box.ply")
    app_state = begin_app(tmp_path / "box.ply")
    obj = settled(app_state, app_state.queue.records()[0].id)
    beside = (9.0, 9.0, 5.0), *DOWN[1:]
    assert obj.segmenting.click(beside, 1, True, "ann").result(60) is None
    wait_until(lambda: not obj.jobs, "it hit nothing")
    prompt = obj.segmenting.click(DOWN, 1, True, "ann").result(60)
    assert prompt is not None and prompt.position[2] > 0.3
    wait_until(lambda: obj.document.segmentation_current and not obj.jobs, "labels")
    (entry,) = app_state.store.history(obj.record.id)
    assert entry.who == "ann" and entry.command.click == prompt
    assert entry.command.answer.labels == obj.document.segmentation.labels
    assert obj.labels is not None and (obj.labels == 1).any()
    wait_until(lambda: [r.prompts for r in app_state.queue.records()] == [1], "the queue knows")
    assert app_state.store.load(obj.record.id) == obj.state
    obj.do(cmd.Undo(), "ann")
    assert obj.labels is None and not obj.document.prompts


def test_a_prompt_shows_at_once_and_is_stored_before_what_follows_it(
    begin_app, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    GOOD.export(tmp_path / "box.ply")
    app_state = begin_app(tmp_path / "box.ply")
    obj = settled(app_state, app_state.queue.records()[0].id)
    kinds = lambda: [e.command.kind for e in app_state.store.history(obj.record.id)]  # noqa: E731
    monkeypatch.setattr(segmenting_tasks, "click", click_slowly)
    first = obj.segmenting.click(DOWN, 1, True, "ann").result(60)
    assert obj.document.prompts == (first,) and not kinds()
    obj.do(cmd.NamePart(1, "lid"), "ann")
    assert kinds() == ["add_click", "name_part"]
    second = obj.segmenting.click(DOWN, 2, True, "ann").result(60)
    wait_until(lambda: obj.document.segmentation_current and not obj.jobs, "labels for both")
    assert obj.document.prompts == (first, second)
    assert set(obj.labels.tolist()) >= {2}
    obj.do(cmd.ClearPrompts(), "ann")
    obj.segmenting.click(DOWN, 1, True, "ann").result(60)
    app_state.hub.store_announced()  # the server ends
    assert kinds()[-1] == "add_click"


def test_prompts_being_answered_are_not_asked_for_again(
    begin_app, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    GOOD.export(tmp_path / "box.ply")
    app_state = begin_app(tmp_path / "box.ply")
    obj = settled(app_state, app_state.queue.records()[0].id)
    worker = app_state.workers.segmentation
    asked: list[Job[Any]] = []
    submit = worker.submit
    monkeypatch.setattr(
        worker, "submit", lambda *a, **k: asked.append(submit(*a, **k)) or asked[-1]
    )
    obj.do(cmd.AddClick(Click((0.0, 0.0, 0.35), 1)), "ann")
    obj.segmenting.update()  # as the end of an earlier answer does
    wait_until(lambda: obj.document.segmentation_current and not obj.jobs, "labels")
    assert [job.name for job in asked].count("segment") == 1


@pytest.mark.parametrize("by", ["a button", "leaving"])
def test_a_read_without_end_holds_nobody_up_and_can_be_ended(
    by: str, begin_app, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [tmp_path / f"{name}.ply" for name in ("worst", "good")]
    for path in paths:
        GOOD.export(path)
    app_state = begin_app(*paths)
    worst, good = (r.id for r in app_state.queue.records())
    clicked = settled(app_state, good)
    with monkeypatch.context() as patched:
        patched.setattr(display_tasks, "open_asset", reads_for_ever)
        obj = app_state.object(worst)
    leave = obj.watch(lambda: None, lambda *_: None)
    workers, asset = app_state.workers, clicked.asset
    assert asset is not None
    ray = (asset.folder, (0.1, 0.1, 5.0), (0.0, 0.0, -1.0))
    assert workers.geometry.submit(segmenting_tasks.pick, *ray).result(60) is not None
    assert "open" in obj.jobs and workers.reading.pid != workers.geometry.pid
    if by == "a button":
        obj.jobs.cancel("open")
    else:
        leave()
    wait_until(lambda: obj.problem, "it is cancelled")
    assert obj.problem == READ_CANCELLED and not app_state.queue.unreadable
    if by == "a button":
        obj.try_again()
    else:
        app_state.object(worst)
    wait_until(lambda: obj.asset, "it opens")


@pytest.mark.parametrize("degrees", [0, 90, 217])
@pytest.mark.parametrize("scanned", [False, True])
def test_an_object_is_first_seen_from_where_its_handles_stand_out(
    degrees: float, scanned: bool
) -> None:
    handles = [((x, -0.28, 0.4), (x + 0.02, -0.25, 0.5)) for x in (-0.1, 0.1)]
    cupboard = boxes(((-0.4, -0.25, 0.0), (0.4, 0.25, 0.8)), *handles)
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    points, faces = cupboard.vertices @ turn.T, cupboard.faces
    if scanned:  # all round, the back as well as the front
        rng = np.random.default_rng(0)
        points = sample_surface(Mesh(points, faces), 30_000, rng)[0].points
        points, faces = points + rng.normal(0, 0.001, points.shape), None
    front = display_tasks.front_direction(points, faces)
    assert np.dot(front, turn @ np.array((0.0, -1.0, 0.0))) > 0.9
