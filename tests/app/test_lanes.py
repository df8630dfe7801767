"""Lanes: who clicks on an object waits for nobody else's object."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trimesh
from PIL import Image

from app.server import workers as module
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.open_object import OpenObject
from app.server.tasks import PIXELS_KEPT, asset_of, pixels_of
from app.server.workers import Lane, Lanes
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.store import Store
from tests.app import job_functions as functions
from tests.builders import wait_until


class IdleWorker:
    """Stands in for a worker process."""

    def __init__(self, name: str, **_: Any) -> None:
        self.name, self.busy, self.closed, self.rests = name, False, False, False

    def rest(self, rests: bool) -> None:
        self.rests = rests

    def begin_to_close(self) -> None:
        self.closed = True


class Person:
    """Stands in for an object that a tab shows, or doesn't any more."""

    clicked = True


@pytest.fixture
def lanes(monkeypatch: pytest.MonkeyPatch) -> Lanes:
    monkeypatch.setattr(module, "WorkerProcess", IdleWorker)
    monkeypatch.setattr(module, "machine_memory", lambda: 8 << 30)  # for three lanes
    return Lanes()


def names(lane: Lane) -> tuple[str, str]:
    return lane.geometry.name, lane.segmentation.name


def test_one_annotator_has_one_lane_for_all_objects(lanes: Lanes) -> None:
    for _ in range(5):
        shown = Person()
        assert lanes.take(shown, heavy=False) is lanes.first
        shown.clicked = False
    assert len(list(lanes)) == 1


def test_lanes_that_nobody_uses_keep_no_processes(lanes: Lanes) -> None:
    taken = []
    for _ in range(3):  # one person leaves objects that are still worked on
        shown = Person()
        taken.append(lanes.take(shown, heavy=False))
        taken[-1].segmentation.busy, shown.clicked = True, False  # type: ignore[misc]
    assert [lane.geometry.rests for lane in taken] == [True, False, False]
    assert lanes.take(Person(), heavy=False) is taken[0], "the longest unused of all"
    assert [lane.geometry.rests for lane in taken] == [False, True, False]


def test_an_object_that_is_opened_ahead_waits_in_the_lane_of_the_one_before(lanes: Lanes) -> None:
    shown, following = Person(), Person()
    lane, following.clicked = lanes.take(shown, heavy=False), False
    lanes.share(following, lane)
    assert lanes.take(following, heavy=False) is lane, "it is read and encoded there"
    shown.clicked, following.clicked = False, True
    assert lanes.take(following, heavy=False) is lane, "the same person goes on"
    shown.clicked = True
    assert lanes.take(following, heavy=False) is not lane, "two people"


def test_what_is_heavy_until_it_is_cleaned_has_its_next_lane_reserved(lanes: Lanes) -> None:
    shown, following = Person(), Person()
    lane, following.clicked = lanes.take(shown, heavy=False), False
    lanes.share(following, lane)
    heavy = lanes.take(following, heavy=True)
    assert heavy is not lane and lanes.reserve(following, heavy=False) is lane
    assert lanes.take(following, heavy=True) is heavy, "it is shown"
    lanes.leave(shown)
    assert lanes.take(following, heavy=False) is lane, "it is cleaned"


def test_nobody_shares_a_lane_until_memory_ends(lanes: Lanes) -> None:
    people = [Person() for _ in range(9)]
    taken = [lanes.take(person, heavy=False) for person in people]
    assert len(set(taken[:3])) == 3 and set(Counter(taken).values()) == {3}
    assert [lanes.take(person, heavy=False) for person in people] == taken
    for person, lane in zip(people, taken, strict=True):
        person.clicked = lane is not taken[1]
    assert lanes.take(Person(), heavy=False) is taken[1]


def test_an_object_keeps_its_lane_unless_it_was_taken_meanwhile(lanes: Lanes) -> None:
    one, other = Person(), Person()
    mine = lanes.take(one, heavy=False)
    one.clicked = False
    mine.segmentation.busy = True  # type: ignore[misc]  # with the job that one left behind
    another = lanes.take(other, heavy=False)
    assert another is not mine and lanes.take(one, heavy=False) is mine
    mine.segmentation.busy = False  # type: ignore[misc]
    third = Person()
    assert lanes.take(third, heavy=False) is mine
    one.clicked = True
    assert lanes.take(one, heavy=False) not in (mine, another)


def test_heavy_objects_have_lanes_of_their_own(lanes: Lanes) -> None:
    loads, kept = [[Person() for _ in range(3)] for _ in range(2)]
    heavy = [lanes.take(person, heavy=True) for person in loads]
    assert len(set(heavy)) == module.HEAVY_LANES
    assert names(heavy[0]) == ("heavy geometry", "heavy segmentation")
    assert {lanes.take(person, heavy=False) for person in kept}.isdisjoint(heavy)


def test_an_object_that_became_light_leaves_the_heavy_lane(lanes: Lanes) -> None:
    person, other = Person(), Person()
    heavy = lanes.take(person, heavy=True)
    assert lanes.take(person, heavy=False) is lanes.first
    assert lanes.take(other, heavy=True) is heavy


def test_a_lane_without_objects_ends_except_the_first(lanes: Lanes) -> None:
    people = [Person(), Person()]
    first, second = (lanes.take(person, heavy=False) for person in people)
    for person in people:
        lanes.leave(person)
    assert list(lanes) == [first] and not first.geometry.closed  # type: ignore[attr-defined]
    assert second.geometry.closed and second.segmentation.closed  # type: ignore[attr-defined]


@pytest.fixture
def app_state(tmp_path: Path) -> Iterator[AppState]:
    """Two boxes, and a triangle with a texture that takes long to decode."""
    for name in ("first", "second"):
        trimesh.creation.box((1, 0.5, 0.7)).export(tmp_path / f"{name}.ply")
    Image.new("L", (4100, 4100)).save(tmp_path / "map.png")
    (tmp_path / "map.mtl").write_text("newmtl a\nmap_Kd map.png\n")
    (tmp_path / "worst.obj").write_text(
        "mtllib map.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"
    )
    paths = [tmp_path / name for name in ("first.ply", "second.ply", "worst.obj")]
    workspace = tmp_path / "workspace"
    app_state = AppState(ServeConfig(workspace=workspace), Store(workspace), paths)
    yield app_state
    app_state.close()


def shown(app_state: AppState, number: int) -> OpenObject:
    """An object that a tab shows and that is ready for clicks."""
    obj = app_state.object(app_state.queue.records()[number].id)
    obj.watch(lambda: None, lambda *_: None)
    wait_until(lambda: obj.asset and not obj.jobs, "it is open and nothing is under way")
    return obj


def test_clicks_are_answered_while_other_objects_hold_their_workers(
    app_state: AppState, tmp_path: Path
) -> None:
    first, second, worst = (shown(app_state, number) for number in range(3))
    assert [obj.asset and obj.asset.heavy for obj in (first, second, worst)] == [False, False, True]
    end = tmp_path / "end"
    held = [
        worker.submit(functions.wait_for, end, priority=99)
        for lane in (first.lane, worst.lane)
        for worker in (lane.geometry, lane.segmentation)
    ]
    wait_until(lambda: all(job.state == "running" for job in held), "all are held")
    pick = second.lane.geometry.submit(functions.echo, "picked")
    second.do(cmd.AddClick(Click((0.5, 0.0, 0.0), 1)), "ann")
    wait_until(lambda: second.document.segmentation_current, "the click is answered")
    assert pick.result(60) == "picked"
    assert second.labels is not None and set(second.labels.tolist()) == {0, 1}
    assert all(job.state == "running" for job in held)
    end.touch()


def test_work_on_heavy_objects_gives_way_and_has_a_limit(app_state: AppState) -> None:
    """Others go first; memory has a limit, and picking decodes no textures."""
    worst = shown(app_state, 2)
    for worker in (worst.lane.geometry, worst.lane.segmentation):
        niceness, limited = worker.submit(functions.priority_and_limit).result(60)
        assert niceness >= module.HEAVY and limited
    assert not app_state.workers.segmentation.submit(functions.priority_and_limit).result(60)[1]
    assert worst.asset is not None
    folder = worst.asset.folder
    assert pixels_of(asset_of(folder)) == 4100**2 < PIXELS_KEPT
    bare = asset_of(folder, textures=False)
    assert pixels_of(bare) == 0 and bare.element_count == 1
