"""Jobs that somebody waits for: the newest counts, and every end is told."""

from __future__ import annotations

from typing import Any

import pytest

from app.server.job import Job, WorkerDied
from app.server.observable import RunningJobs
from model.core.errors import CommandError
from model.core.progress import Cancelled


def job(cancel: Any = None) -> Job[Any]:
    return Job(cancel or (lambda job: None), 1, "job", (int, (), {}), None, None)


def ended(**end: Any) -> Job[Any]:
    out = job()
    out.end(**end)
    return out


def test_the_newest_job_counts():
    redraws: list[None] = []
    stopped: list[Job[Any]] = []
    jobs = RunningJobs("the chest", lambda: redraws.append(None))
    old, new = job(stopped.append), job(stopped.append)
    report = jobs.progress("predict")
    report(0.1, "not followed yet")
    assert not jobs.busy and not redraws
    jobs.add("predict", old, lambda _: None)
    jobs.add("predict", new, lambda _: None, (0.2, "again"))
    assert not jobs.drop("predict", old)
    assert "predict" in jobs and jobs.busy == {"predict": (0.2, "again")}
    report(0.5, "half")
    assert jobs.busy == {"predict": (0.5, "half")} and len(redraws) == 1
    jobs.cancel("predict")
    jobs.cancel("save")
    assert stopped == [new]
    assert jobs.drop("predict", new)
    assert "predict" not in jobs and not jobs.busy


def test_what_went_wrong_is_said_in_words(caplog: pytest.LogCaptureFixture):
    jobs = RunningJobs("the chest", lambda: None)
    kept: list[int] = []
    assert jobs.deliver("save", ended(state="done", value=3), kept.append) is None
    assert kept == [3]
    stopped = jobs.deliver("save", ended(state="cancelled"), kept.append)
    assert isinstance(stopped, Cancelled)
    mistake = CommandError("no part is there yet")
    assert jobs.deliver("save", ended(state="failed", error=mistake), kept.append) is mistake
    assert not caplog.records
    fault = jobs.deliver("save", ended(state="done", value=3), lambda value: value / 0)
    assert "division by zero (a bug" in str(fault)
    died = jobs.deliver("open", ended(state="failed", error=WorkerDied("it crashed")), kept.append)
    assert str(died) == "it crashed"  # often the file's fault
    assert "job save of the chest failed" in caplog.text
    assert kept == [3]
