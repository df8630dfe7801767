"""The way of a click: its files, trips to workers and commits, until its labels are drawn."""

from __future__ import annotations

import sys
import threading
import tomllib
from typing import Any

import pytest

from app.server.jobs import PREVIEWS
from sessions.store import Store
from tests.app.job_functions import PathTrace, begin_trace, end_trace
from tests.budget import FILE, ROOT
from tests.builders import wait_until

pytestmark = pytest.mark.browser

STATIONS = (
    "app/viewer/picture/object_nodes.py", "app/server/jobs.py", "sessions/store.py",
    "model/geometry/picking.py", "model/segmentation/default.py",
)  # fmt: skip
"""Where a click arrives: the worker, the store, the surface, the segmenter, the picture."""
CARRIERS = r"tab-\d+|job callbacks|.* worker"
"""Threads of the server that a click passes: its tab's, and those that talk to workers."""


def test_the_way_of_a_click_stays_within_the_budget(
    start: Any, open_tab: Any, cabinet: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, points = cabinet
    trace, jobs, commits = PathTrace(STATIONS, threads=CARRIERS), list[str](), list[str]()
    append = Store.append

    def counted(store: Store, *args: Any, **more: Any) -> Any:
        commits.append(type(args[1]).__name__)
        return append(store, *args, **more)

    monkeypatch.setattr(Store, "append", counted)
    threading.setprofile(trace)  # in all threads that begin from now on
    try:
        tab = open_tab(start(path))
        tab.prompt(points["door"])  # the first one has more to do
        wait_until(lambda: not tab.object.jobs, "the object is ready for the next one")
        workers = tab.object.lane.geometry, tab.object.lane.segmentation
        for worker in workers:
            traced = threading.Event()
            began = worker.submit(begin_trace, STATIONS)
            # An earlier test may have begun the thread of the callbacks.
            began.add_done_callback(lambda _, traced=traced: (sys.setprofile(trace), traced.set()))
            began.result(timeout=60)
            assert traced.wait(60)
            submit = worker.submit

            def noted(function: Any, *args: Any, submit: Any = submit, **more: Any) -> Any:
                if more.get("priority") != PREVIEWS:  # which the resting pointer asks for
                    jobs.append(function.__name__)
                return submit(function, *args, **more)

            monkeypatch.setattr(worker, "submit", noted)
        commits.clear()
        trace.counting = True
        tab.prompt(points["drawer"])
        wait_until(lambda: tab.app.drawing.shows_labels, "its labels are drawn")
        trace.counting = False
    finally:
        threading.setprofile(None)
    trips = len(jobs)
    ended = [worker.submit(end_trace) for worker in workers]
    ended[0].add_done_callback(lambda _: sys.setprofile(None))
    files = trace.files.union(*(job.result(timeout=60) for job in ended))
    told = tomllib.loads((ROOT / FILE).read_text())["click"]
    assert set(STATIONS) <= files, "a station was renamed"
    assert len(files) <= told["files"], sorted(files)
    assert trips <= told["trips"], jobs
    assert len(commits) <= told["commits"], commits
