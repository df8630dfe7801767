"""Objects that can't be opened, and objects that nobody looks at any more."""

from __future__ import annotations

import gc
import time
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import trimesh

from app.server import app_state as workbench
from app.server import display_tasks
from app.server.app_state import Workbench
from app.server.config import ServeConfig
from app.server.open_object import OpenObject
from model.core.errors import CommandError
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.live import LiveSession
from sessions.store import Store
from tests.app.job_functions import killed_while_opening

GOOD = trimesh.creation.box((1, 0.5, 0.7))


def wait(condition: Callable[[], Any], what: str, seconds: float = 120.0) -> Any:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := condition():
            return value
        time.sleep(0.02)
    raise AssertionError(f"waited in vain for: {what}")


def settled(bench: Workbench, number: int) -> OpenObject:
    obj = bench.object(number)
    wait(lambda: obj.asset and not obj.jobs, "it is open and nothing is under way")
    return obj


@pytest.fixture
def bench_of(tmp_path: Path) -> Iterator[Callable[..., Workbench]]:
    made: list[Workbench] = []

    def begin(*paths: Path) -> Workbench:
        workspace = tmp_path / "workspace"
        config = ServeConfig(workspace=workspace)
        made.append(Workbench(config, Store(workspace), list(paths)))
        return made[-1]

    yield begin
    for bench in made:
        bench.close()


def test_a_file_that_changed_is_tried_again(bench_of, tmp_path: Path) -> None:
    path = tmp_path / "box.ply"
    path.write_bytes(b"ply\nformat ascii 1.0\n")
    bench = bench_of(path)
    number = bench.records()[0].id
    obj = bench.object(number)
    wait(lambda: obj.problem, "the problem")
    bench.object(number)
    assert obj.problem and "open" not in obj.jobs
    assert obj.problem.startswith("box.ply: ")  # where it is kept is nothing to tell
    assert bench.broken == {number}
    GOOD.export(path)
    bench.object(number)
    wait(lambda: obj.asset, "it opens")
    assert obj.problem is None and not bench.broken


def test_what_cannot_be_read_is_taken_off_the_queue_and_put_back(bench_of, tmp_path: Path) -> None:
    bench = bench_of()
    GOOD.export(tmp_path / "good.ply")
    (good,) = bench.add_paths([tmp_path / "good.ply"])
    bad = bench.add_upload("bad.ply", b"ply\nformat ascii 1.0\n")
    path = bench.store.object(bad).path
    with pytest.raises(CommandError, match="only what can't be read"):
        bench.take_off(good)
    obj = bench.object(bad)
    wait(lambda: obj.problem, "the problem")
    obj.do(cmd.SetCategory("Box"), "tester")
    before = [r.id for r in bench.records()]
    bench.take_off(bad)
    assert [r.id for r in bench.records()] == [i for i in before if i != bad]
    assert path.is_file() and bench.store.load(bad).present.category == "Box"
    assert bench.put_back() == bad and not bench.taken_off
    assert sorted(r.id for r in bench.records()) == sorted(before)
    bench.take_off(bad)
    assert bench.add_upload("bad.ply", path.read_bytes()) == bad  # so it is back as well
    assert bench.records()[-1].id == bad and not bench.taken_off
    with pytest.raises(CommandError, match="nothing was taken off"):
        bench.put_back()


def test_what_was_taken_off_stays_off_at_the_next_start(bench_of, tmp_path: Path) -> None:
    good, *bad = (tmp_path / f"{name}.ply" for name in ("good", "one", "two"))
    GOOD.export(good)
    for path in bad:
        path.write_bytes(b"ply\nformat ascii 1.0\n")
    bench = bench_of(good, *bad)
    ids = [r.id for r in bench.records()]
    for number in ids[:0:-1]:
        obj = bench.object(number)
        wait(lambda obj=obj: obj.problem, "the problem")
        bench.take_off(number)
    later = bench_of(good, *bad)
    assert [r.id for r in later.records()] == ids[:1]
    assert later.taken_off == tuple(ids[:0:-1])
    assert later.put_back() == ids[1]
    again = bench_of(good, *bad)
    assert [r.id for r in again.records()] == ids[:2] and again.taken_off == (ids[2],)
    assert [r.id for r in bench_of(bad[1]).records()] == [ids[2]]  # it is all there is
    GOOD.export(bad[1])  # mended
    assert [r.id for r in bench_of(good, *bad).records()] == ids


def test_it_is_tried_again_where_its_worker_died_or_a_person_asks(
    bench_of, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "box.ply"
    GOOD.export(path)
    bench = bench_of(path)
    number = bench.records()[0].id
    with monkeypatch.context() as patch:
        patch.setattr(display_tasks, "open_asset", killed_while_opening)
        obj = bench.object(number)
        wait(lambda: obj.problem, "the worker died")
        obj.try_again()
        wait(lambda: obj.problem, "it died again")
    assert "killed" in obj.problem
    bench.object(number)
    wait(lambda: obj.asset, "it opens")


def test_objects_that_nobody_looks_at_are_let_go_and_come_back(
    bench_of, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workbench, "OPEN_KEPT", 1)
    paths = [tmp_path / f"box_{i}.ply" for i in range(3)]
    for path in paths:
        GOOD.export(path)
    bench = bench_of(*paths)
    first, shown, other = [r.id for r in bench.records()]
    before = weakref.ref(settled(bench, first))
    before().do(cmd.AddPart(1, "door"), "tester")
    before().do(cmd.SetCategory("Oven"), "tester")
    looked_at = settled(bench, shown)
    stop = looked_at.watch(lambda: None, lambda *_: None)
    settled(bench, other)
    gc.collect()
    assert before() is None
    assert bench.object(shown) is looked_at
    back = settled(bench, first)
    assert back.document.part_names == {1: "door"} and back.document.category == "Oven"
    back.do(cmd.Undo(), "tester")
    assert back.document.category is None
    stop()
    bench.object(other)
    assert bench.object(shown) is not looked_at


def test_what_was_undone_before_it_was_answered_is_not_shown(bench_of, tmp_path: Path) -> None:
    path = tmp_path / "box.ply"
    GOOD.export(path)
    bench = bench_of(path)
    obj = settled(bench, bench.records()[0].id)

    def undone(command: Any) -> None:
        busy = bench.segmentation.submit(time.sleep, 0.3, priority=99)
        wait(lambda: busy.state == "running", "the segmenter is held up")
        obj.do(cmd.AddClick(Click((0.5, 0.0, 0.0), 1)), "tester")
        obj.do(command, "tester")
        wait(lambda: busy.done and not obj.jobs, "nothing is under way")

    undone(cmd.Undo())
    assert obj.labels is None and not obj.document.prompts
    obj.do(cmd.AddClick(Click((0.0, 0.0, 0.35), 2)), "tester")
    wait(lambda: obj.document.segmentation_current and not obj.jobs, "it is answered")
    assert obj.labels is not None and set(obj.labels.tolist()) == {0, 2}
    undone(cmd.Undo())
    assert set(obj.labels.tolist()) == {0, 2}
    # The answer is about elements that are none any more.
    undone(cmd.SetFrame("x", 1.0))
    assert obj.labels is None and obj.asset is not None


def test_what_another_server_did_is_seen(bench_of, tmp_path: Path) -> None:
    for name in ("first", "second"):
        GOOD.export(tmp_path / f"{name}.ply")
    bench = bench_of(tmp_path / "first.ply", tmp_path / "second.ply")
    first, second = (r.id for r in bench.records())
    obj = settled(bench, first)
    notes: list[tuple[str, str, str]] = []
    obj.watch(lambda: None, lambda *note: notes.append(note))
    obj.do(cmd.SetCategory("Box"), "ann")
    bench.follow()
    assert not notes
    store = Store(tmp_path / "workspace")
    for number in (first, second):
        LiveSession(store, number).do(cmd.AddPart(1, "lid"), "rob")
    store.close()
    bench.follow()
    assert obj.document.part_names == {1: "lid"} and obj.document.category == "Box"
    assert [n[0] for n in notes] == ["Changed elsewhere"]
    assert [r.parts for r in bench.records()] == [2, 2]


def test_who_waits_for_a_draft_hears_how_far_it_is(
    bench_of, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is written since the joints were judged; the bar stood at nothing until it was there."""
    bench = bench_of()
    source: Any = "the parts"
    tree: Any = "the joints"
    heard: list[Any] = []

    def submit(*_: Any, **__: Any) -> Any:
        return SimpleNamespace(listen=heard.append, cancel=lambda: heard.append("cancelled"))

    monkeypatch.setattr(bench.saving, "submit", submit)
    bench.prepare_asset(source, tree)
    bench.draft_asset(source, tree, print)
    assert heard == [print]
    bench.prepare_asset("other parts", tree)  # type: ignore[arg-type]
    assert heard == [print]  # what is looked at next doesn't stop it
    bench.draft_asset(source, "other joints", print)  # type: ignore[arg-type]
    assert heard == [print, "cancelled"]
