"""What a click or a drag means, as tools follow one another."""

from __future__ import annotations

import queue
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from app.server.job import Job
from app.server.object_context import ObjectContext
from app.server.workers import Lane
from app.viewer.input import queries
from app.viewer.input.pointing import Pointing
from app.viewer.input.queries import PointerQueries
from app.viewer.tab import Selection
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.segmentation.prompts import Click
from sessions.store import Store


def make_tab(**selected: Any) -> Any:
    """A tab without a browser."""
    tab: Any = SimpleNamespace(asked=[], invalidate=lambda: None, say=lambda text: None)
    tab.notify = lambda *said: tab.asked.append(said)
    selection = Selection(tab.invalidate, "the queue")
    vars(selection).update(selected)
    tab.selection = selection
    return tab


RAY = (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)


class Hits:
    """Stands in for the workers: a ray meets these elements, one after the other, at the origin."""

    def __init__(self, *elements: int) -> None:
        self.elements = iter(elements)

    def pick(self, *asked: Any) -> None:
        asked[-1](SimpleNamespace(position=np.zeros(3), element=next(self.elements)))


class HeldWorker:
    """Stands in for a worker that is busy: its jobs end when the test says so."""

    def __init__(self) -> None:
        self.jobs: list[Job[Any]] = []

    def submit(self, function: Any, *_: Any, **__: Any) -> Job[Any]:
        self.jobs.append(Job(lambda job: None, len(self.jobs), "pick", (function, (), {}), None, 0))
        return self.jobs[-1]


class Person:
    """A tab on one of two objects whose worker is held, and what was done."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        monkeypatch.setattr(queries, "PATIENCE", 0.05)
        self.done: list[tuple[str, Any]] = []
        self.first, self.second = (self._object(name) for name in ("first", "second"))
        self.tab = make_tab(object=self.first, step="Annotate")
        self.actions: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.tab.act, self.tab.user = self.actions.put, "ann"
        self.worker: Any = HeldWorker()
        for obj in (self.first, self.second):
            obj.lane = Lane(self.worker, self.worker)
        asked = PointerQueries(self.tab, tmp_path, "default")
        self.pointing = Pointing(self.tab, cast(Any, SimpleNamespace()), cast(Any, None), asked)

    def _object(self, name: str) -> Any:
        asset = SimpleNamespace(element_kind="point", folder=Path(name))
        document = SimpleNamespace(
            segmentation=None, prompts=(), tree=None, next_part=4, part={1: 1}.get
        )
        obj = SimpleNamespace(asset=asset, need_asset=lambda: asset, document=document)
        obj.segmenting = SimpleNamespace(click=lambda *asked: self._clicked(name, *asked))
        return obj

    def _clicked(self, name: str, *asked: Any) -> Job[Any]:
        self.done.append((name, *asked))
        return self.worker.submit(None)

    def answer(self, number: int, value: Any) -> None:
        self.worker.jobs[number].end("done", value)
        self.actions.get(timeout=5)()


def test_a_click_that_waits_for_the_workers_counts_for_what_was_selected(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    person = Person(monkeypatch, tmp_path)
    person.tab.selection.choose_part = lambda part: setattr(person.tab.selection, "part", part)
    for part in (1, 2):
        person.tab.selection.part = part
        person.pointing.click(*RAY, True)
        person.pointing.tools.pick_label("door")
        # A part of its own, unless an empty one is selected; another one's digit ends it.
        assert person.tab.selection.part == (4 if part == 1 else 2)
        assert person.pointing.tools.label == "door"
    person.tab.selection.part = 3
    assert not person.pointing.tools.label
    person.tab.selection.object = person.second
    for number in (0, 1):
        person.answer(number, Click((0.0, 0.0, 0.0), number + 1, True, 7))
    aim = (*RAY, None)
    assert person.done == [("first", aim, part, True, "ann", None) for part in (1, 2)]
    assert not person.tab.asked  # the clicks count, wherever the person is by now
    person.tab.selection.object = person.first
    person.pointing.click(*RAY, True)
    person.tab.selection.object = person.second
    person.answer(2, None)
    assert person.tab.asked[-1][0] == "Not counted"


def test_a_late_answer_to_a_tool_that_is_gone_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    person = Person(monkeypatch, tmp_path)
    person.pointing.armed = "cut"
    person.pointing.click(*RAY, True)
    person.pointing.armed = ""
    person.answer(0, SimpleNamespace(position=np.zeros(3), element=7))
    assert person.tab.asked[-1][0] == "Not counted" and not person.done


def test_a_cut_that_was_begun_leaves_no_mark_when_something_is_drawn_instead() -> None:
    marks: list[tuple[Any, ...]] = []
    picture: Any = SimpleNamespace(overlays=SimpleNamespace(show_places=marks.append))
    tab = make_tab(object=SimpleNamespace(asset=SimpleNamespace()))
    pointing = Pointing(tab, picture, cast(Any, None), cast(Any, Hits(7)))
    pointing.arm("cut")
    pointing.click(*RAY, True)
    assert marks[-1] == ((0.0, 0.0, 0.0),)
    pointing.set_tool("lasso")
    assert (pointing.tool, pointing.armed, marks[-1]) == ("lasso", "", ())


def test_a_part_is_found_by_points_that_are_not_displayed(tmp_path: Path) -> None:
    """Of a large scan only some points are drawn, but each can be clicked on."""
    store = Store(tmp_path)
    ref = store.put_array(np.array([0, 0, 2, 2, -1], np.int16))
    read: list[str] = []
    whole = store.get_array
    store.get_array = lambda ref: (read.append(ref), whole(ref))[1]  # type: ignore[method-assign]
    slide = Joint("slide", "prismatic", "link_0", "link_2", (0, -1, 0), (0, 0, 0), 0.0, 0.3)
    document = SimpleNamespace(
        segmentation=SimpleNamespace(labels=ref), tree=KinematicTree(("link_0", "link_2"), (slide,))
    )
    session = SimpleNamespace(state=SimpleNamespace(present=document))
    services: Any = SimpleNamespace(store=store, hub=SimpleNamespace(session=lambda id: session))
    services.workers = SimpleNamespace(lanes=SimpleNamespace(first=None))
    obj: Any = ObjectContext(SimpleNamespace(id=1), services)  # type: ignore[arg-type]
    obj.asset = SimpleNamespace(element=np.array([0, 2]))
    tab = make_tab(object=obj)
    asked = tab.asked
    picture: Any = SimpleNamespace(overlays=SimpleNamespace(show_places=lambda places: None))
    still: Any = SimpleNamespace(q={})
    pointing = Pointing(tab, picture, still, cast(Any, Hits(3, 2, 4, 3, 3, 3)))
    pointing.tools.use = lambda request, label: asked.append(request.other)  # type: ignore[method-assign]

    def merge_at_click() -> Any:
        pointing.arm("merge")
        pointing.click(*RAY, True)
        return asked[-1]

    assert [merge_at_click() for _ in range(3)] == [2, 2, 0]
    tab.selection.set_step("Joints")
    pointing.click(*RAY, True)
    assert tab.selection.child == "link_2"
    assert read == [ref]  # the labels of all points are read once, not for each click
    document.segmentation.labels = store.put_array(np.array([0, 0, 2, 3, -1], np.int16))
    assert merge_at_click() == 3
    document.segmentation = None
    assert merge_at_click()[:2] == ("Merge", "No parts yet: click on one first")
    store.close()
