"""The worker process: what comes back, in which order, and what survives."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.server import jobs
from app.server.job import OutOfTimeError, WorkerDied
from app.server.jobs import CANCEL_SECONDS, Job, JobFailed, WorkerProcess
from app.server.worker import WorkerTemplate
from model.core.errors import InputFileError, KinematicsError
from model.core.progress import Cancelled
from tests.app import job_functions as functions
from tests.builders import wait_until

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def template():
    """What the workers of a server are forked from, where the system can."""
    template = WorkerTemplate(1) if WorkerTemplate.possible() else None
    yield template
    if template is not None:
        template.close()


@pytest.fixture
def worker(template):
    with WorkerProcess("test", template=template) as out:
        out.submit(functions.pid).result(60)
        yield out


@pytest.fixture
def interpreter():
    """A worker with an interpreter of its own, as the backend's are."""
    with WorkerProcess("test") as out:
        out.submit(functions.pid).result(60)
        yield out


needs_fork = pytest.mark.skipif(not WorkerTemplate.possible(), reason="it doesn't fork here")


def parent_of(pid: int | None) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def alive(pid: int | None) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def test_runs_elsewhere_and_returns_the_value(worker):
    job = worker.submit(functions.pid)
    assert job.result(60) == worker.pid != os.getpid()
    assert job.done and job.state == "done" and job.fraction == 1.0


def test_an_interpreter_of_its_own_does_as_well(interpreter):
    child = interpreter.submit(functions.pid).result(60)
    assert child == interpreter.pid != os.getpid()
    os.kill(child, signal.SIGKILL)
    wait_until(lambda: interpreter.pid not in (None, child))
    assert interpreter.submit(functions.echo, 5).result(60) == 5


@needs_fork
def test_forked_workers_are_processes_of_their_own(template):
    """They share what the template imported, and one's end is not that of another."""
    with (
        WorkerProcess("one", template=template) as one,
        WorkerProcess("two", template=template) as two,
    ):
        for worker in (one, two):
            assert worker.submit(functions.imported, "trimesh").result(60)
        assert [one.submit(functions.count_calls).result(60) for _ in range(2)] == [1, 2]
        assert two.submit(functions.count_calls).result(60) == 1
        kept, killed = two.pid, one.pid
        assert killed is not None
        os.kill(killed, signal.SIGKILL)
        wait_until(lambda: one.pid not in (None, killed))
        assert one.submit(functions.echo, 5).result(60) == 5
        assert two.submit(functions.pid).result(60) == kept


@needs_fork
def test_a_worker_that_keeps_much_begins_anew_between_two_jobs(template):
    """What waits goes on."""
    with WorkerProcess("keeps", template=template, most_kept=400_000_000) as worker:
        child = worker.submit(functions.pid).result(60)
        worker.submit(functions.keep, 50_000_000).result(60)
        assert worker.submit(functions.pid).result(60) == child
        jobs = [worker.submit(functions.keep, size) for size in (400_000_000, 10)]
        assert worker.submit(functions.pid).result(60) not in (child, None)
        assert [job.state for job in jobs] == ["done", "done"]


@needs_fork
def test_a_killed_template_begins_anew():
    """Its workers die with it and are forked from the next one; a click is repeated."""
    template = WorkerTemplate(1)
    with WorkerProcess("one", template=template) as one:
        job = one.submit(functions.deaf, 1.5, repeated=True)
        wait_until(lambda: job.state == "running")
        worker = one.pid
        os.kill(parent_of(worker), signal.SIGKILL)
        job.result(60)
        wait_until(lambda: not alive(worker))
        assert one.submit(functions.echo, 5).result(60) == 5
    template.close()


@needs_fork
def test_nothing_is_left_of_a_closed_template():
    """Nor of workers that it hadn't forked yet."""
    template = WorkerTemplate(1)
    begun = [WorkerProcess("one", template=template) for _ in range(2)]
    begun[0].submit(functions.pid).result(60)
    late = WorkerProcess("late", template=template)
    pids = [worker.pid for worker in begun]
    origin = parent_of(pids[0])
    for worker in (*begun, late):
        worker.close()
    template.close()
    wait_until(lambda: not any(map(alive, [*filter(None, pids), origin])))


def test_same_child_keeps_its_module_state(worker):
    assert [worker.submit(functions.count_calls).result(60) for _ in range(3)] == [1, 2, 3]


def test_initializer_runs_before_the_first_job():
    with WorkerProcess("test", initializer=functions.set_start, arguments=(41,)) as worker:
        assert worker.submit(functions.count_calls).result(60) == 42


def test_broken_initializer_fails_each_job_with_its_reason():
    with WorkerProcess("test", initializer=functions.broken_start) as worker:
        for _ in range(2):
            with pytest.raises(JobFailed, match="no weights here"):
                worker.submit(functions.pid).result(60)


def test_round_trip_of_small_things_is_quick(worker):
    times = []
    for i in range(200):
        start = time.perf_counter()
        assert worker.submit(functions.echo, i).result(60) == i
        times.append(time.perf_counter() - start)
    assert min(times) < 3e-3


def test_arrays_travel_both_ways_and_stay_read_only(worker):
    there = np.arange(6.0).reshape(2, 3)
    back = worker.submit(functions.echo, there).result(60)
    np.testing.assert_array_equal(back, there)
    assert back.flags.writeable
    cloud = worker.submit(functions.cloud, 1_000_000).result(20)
    assert len(cloud) == 1_000_000
    assert not cloud.points.flags.writeable
    assert worker.submit(functions.mean, cloud).result(20) == pytest.approx(1.5e6, rel=1e-3)
    assert worker.submit(functions.echo, np.zeros((0, 3))).result(60).shape == (0, 3)


def test_a_users_error_keeps_type_message_and_attributes(worker):
    job = worker.submit(functions.bad_file)
    with pytest.raises(InputFileError, match=r"scan\.ply: is empty; export it again") as caught:
        job.result(60)
    assert caught.value.remedy == "export it again"
    assert job.state == "failed" and job.error is caught.value
    with pytest.raises(KinematicsError) as caught:
        worker.submit(functions.bad_tree).result(60)
    assert caught.value.problems == ("no root", "a cycle")


def test_other_errors_bring_the_childs_traceback(worker):
    with pytest.raises(JobFailed, match="ValueError: odd") as caught:
        worker.submit(functions.fail, "odd").result(60)
    assert "in fail" in caught.value.details
    with pytest.raises(JobFailed, match="SystemExit"):
        worker.submit(functions.leave, 3).result(60)
    with pytest.raises(JobFailed, match=r"lambda|pickle"):
        worker.submit(functions.unpicklable).result(60)
    with pytest.raises(JobFailed, match="can't be sent"):
        worker.submit(lambda: 1).result(60)
    assert worker.submit(functions.echo, 1).result(60) == 1


def test_who_comes_to_wait_for_a_job_hears_how_far_it_is(worker):
    seen = []
    job = worker.submit(functions.steps, 10_000, 0.02)
    wait_until(lambda: job.fraction > 0)
    job.listen(lambda f, m: seen.append((f, m)))
    wait_until(lambda: seen)
    assert not job.done and seen[0][0] > 0 and seen[0][1].startswith("step")
    job.cancel()


def test_progress_reaches_the_callback_in_order(worker):
    seen: list[tuple[float, str]] = []
    job = worker.submit(functions.steps, 20, 0.01, on_progress=lambda f, m: seen.append((f, m)))
    assert job.result(20) == 20
    wait_until(lambda: seen)
    fractions = [f for f, _ in seen]
    assert fractions == sorted(fractions) and all(0 <= f <= 1 for f in fractions)
    assert all(message.startswith("step") for _, message in seen)


def test_cancel_while_running_stops_at_the_next_step_and_keeps_the_child(worker):
    before = worker.pid
    job = worker.submit(functions.steps, 1000, 0.01)
    wait_until(lambda: job.state == "running" and job.message)
    job.cancel()
    with pytest.raises(Cancelled):
        job.result(60)
    assert job.state == "cancelled" and worker.pid == before


def test_cancel_of_a_deaf_job_kills_the_child_and_the_queue_goes_on(worker):
    before = worker.pid
    job = worker.submit(functions.deaf, 60)
    after = worker.submit(functions.pid)
    wait_until(lambda: job.state == "running")
    start = time.monotonic()
    job.cancel()
    with pytest.raises(Cancelled):
        job.result(60)
    assert time.monotonic() - start >= CANCEL_SECONDS - 0.1
    assert after.result(60) != before


def test_cancel_of_a_queued_job_ends_it_at_once(worker, tmp_path):
    first = worker.submit(functions.deaf, 0.5)
    second = worker.submit(functions.append, str(tmp_path / "log"), "second")
    second.cancel()
    second.cancel()
    assert second.state == "cancelled"
    first.result(60)
    worker.submit(functions.pid).result(60)
    assert not (tmp_path / "log").exists()
    first.cancel()
    assert first.state == "done"


def test_priority_then_order_of_submission(worker, tmp_path):
    log = tmp_path / "log"
    blocker = worker.submit(functions.deaf, 0.3)
    wait_until(lambda: blocker.state == "running")
    jobs = [
        worker.submit(functions.append, str(log), name, priority=p)
        for name, p in (("a", 0), ("b", 0), ("C", 5), ("d", -1))
    ]
    for job in jobs:
        job.result(60)
    assert log.read_text() == "Cabd"


def test_newest_of_a_key_replaces_the_queued_one_in_its_place(worker, tmp_path):
    log = str(tmp_path / "log")
    running = worker.submit(functions.append, log, "1", 0.3, key="clicks")
    wait_until(lambda: running.state == "running")
    stale = [worker.submit(functions.append, log, str(i), key="clicks") for i in (2, 3)]
    other = worker.submit(functions.append, log, "x")
    newest = worker.submit(functions.append, log, "4", key="clicks")
    assert [job.state for job in stale] == ["cancelled", "cancelled"]
    other.result(60)
    assert running.state == newest.state == "done"
    assert Path(log).read_text() == "14x"


def test_callbacks_share_one_thread_and_a_bad_one_harms_nobody(worker, caplog):
    threads: list[int] = []
    done = threading.Event()

    def good(job: Job[int]) -> None:
        threads.append(threading.get_ident())
        assert job.done
        if job.result() == 2:
            done.set()

    def bad(job: Job[int]) -> None:
        raise RuntimeError("bad callback")

    first = worker.submit(functions.echo, 1)
    first.add_done_callback(bad)
    first.add_done_callback(good)
    first.result(60)
    late = worker.submit(functions.echo, 2)
    late.result(60)
    late.add_done_callback(good)  # after its end
    assert done.wait(10)
    assert len(set(threads)) == 1 and threads[0] != threading.get_ident()
    assert "bad callback" in caplog.text


@pytest.mark.parametrize(
    ("number", "words"), [(signal.SIGKILL, "memory"), (signal.SIGSEGV, "SIGSEGV")]
)
def test_a_dead_child_fails_its_job_and_the_queue_goes_on(worker, number, words):
    before = worker.pid
    victim = worker.submit(functions.kill_myself, number)
    after = worker.submit(functions.pid)
    with pytest.raises(JobFailed, match=words):
        victim.result(20)
    assert after.result(60) != before


def test_a_child_killed_while_idle_comes_back(worker):
    before = worker.pid
    os.kill(before, signal.SIGKILL)
    wait_until(lambda: worker.pid not in (None, before))
    assert worker.submit(functions.pid).result(60) == worker.pid


def test_death_is_noticed_though_a_grandchild_holds_the_pipe(worker):
    with pytest.raises(JobFailed, match="SIGKILL"):
        worker.submit(functions.start_grandchild_then_die).result(5)


def test_close_cancels_everything_and_leaves_no_process():
    worker = WorkerProcess("test")
    pid = worker.submit(functions.pid).result(60)
    jobs = [worker.submit(functions.deaf, 60), worker.submit(functions.deaf, 60)]
    wait_until(lambda: jobs[0].state == "running")
    worker.close()
    worker.close()
    assert [job.state for job in jobs] == ["cancelled", "cancelled"]
    assert not alive(pid)
    with pytest.raises(RuntimeError, match="closed"):
        worker.submit(functions.pid)


def test_no_orphan_when_the_server_is_killed():
    code = "from tests.app.job_functions import hold_a_worker; hold_a_worker(60)"
    server = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert server.stdout is not None
    child = int(server.stdout.readline())
    assert alive(child)
    time.sleep(0.2)
    server.kill()
    server.wait()
    wait_until(lambda: not alive(child))
    server.stdout.close()


def test_numeric_threads_are_limited_unless_the_environment_says_so(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    with WorkerProcess("test", threads=3) as worker:
        assert worker.submit(functions.threads).result(60) == "3"


def test_what_is_urgent_is_answered_between_the_steps_of_what_gives_way(worker):
    long = worker.submit(functions.steps, 60, 0.05, preempted_by=9)
    wait_until(lambda: long.state == "running")
    later = worker.submit(functions.echo, "later", priority=8)
    assert worker.submit(functions.echo, "click", priority=9).result(1.5) == "click"
    inner = worker.submit(functions.steps, 6, 0.05, priority=9, preempted_by=12)
    wait_until(lambda: inner.fraction > 0)
    assert worker.submit(functions.echo, "edit", priority=12).result(1) == "edit"
    assert inner.result(60) == 6
    assert not long.done and later.state == "queued"
    assert long.result(20) == 60
    assert later.result(5) == "later"


@pytest.mark.parametrize("looks_every", [0.0, 0.24])
def test_a_preempted_job_has_its_turn_however_many_clicks_come(worker, monkeypatch, looks_every):
    def wait_on_a_busy_machine(*args: Any, **kwargs: Any) -> list[Any]:
        time.sleep(looks_every)
        return wait(*args, **kwargs)

    wait = jobs.wait
    monkeypatch.setattr(jobs, "wait", wait_on_a_busy_machine)
    slow = worker.submit(functions.span, 30, 0.05, priority=10, preempted_by=9)
    wait_until(lambda: slow.fraction > 0)
    clicks = [worker.submit(functions.span, 4, 0.05, priority=10) for _ in range(14)]
    began, ended = slow.result(60)
    took = [(end - start, end) for start, end in (click.result(60) for click in clicks)]
    waited = sum(seconds for seconds, end in took if end < ended)
    assert waited <= (ended - began - waited) + jobs.PATIENCE + max(took)[0]


def test_what_gives_no_way_is_left_alone(worker):
    long = worker.submit(functions.steps, 20, 0.05)
    wait_until(lambda: long.fraction > 0)
    click = worker.submit(functions.echo, 1, priority=20)
    ended: list[str] = []
    for job in (click, long):
        job.add_done_callback(lambda job: ended.append(job.name))
    assert long.result(60) == 20 and click.result(5) == 1
    wait_until(lambda: len(ended) == 2)
    assert ended == ["steps", "echo"]


def test_jobs_that_work_on_the_same_wait_for_each_other(worker):
    long = worker.submit(functions.steps, 20, 0.05, preempted_by=0, works_on="a")
    wait_until(lambda: long.fraction > 0)
    same = worker.submit(functions.echo, "same", priority=9, works_on="a")
    assert worker.submit(functions.echo, "other", works_on="b").result(1) == "other"
    assert same.state == "queued" and not long.done
    assert same.result(5) == "same" and long.done


def test_a_cancelled_job_has_time_until_what_came_between_is_over(worker, tmp_path):
    long = worker.submit(functions.steps, 400, 0.02, preempted_by=9)
    wait_until(lambda: long.fraction > 0)
    child = worker.pid
    began = tmp_path / "began"
    deaf = worker.submit(functions.deaf, CANCEL_SECONDS + 0.5, began, priority=9)
    wait_until(began.exists)
    long.cancel()
    deaf.result(60)
    with pytest.raises(Cancelled):
        long.result(60)
    assert worker.pid == child


def test_a_job_begins_anew_where_the_child_died_of_one_that_came_between(worker):
    long = worker.submit(functions.steps, 20, 0.05, preempted_by=9)
    wait_until(lambda: long.fraction > 0)
    with pytest.raises(JobFailed, match="kill_myself"):
        worker.submit(functions.kill_myself, priority=9).result(60)
    assert long.result(30) == 20


def test_a_job_that_takes_too_long_is_ended(worker):
    before = worker.pid
    late = worker.submit(functions.deaf, 60, most_seconds=0.3)
    after = worker.submit(functions.echo, 3)
    with pytest.raises(OutOfTimeError, match=r"deaf took more than 0\.3 s"):
        late.result(120)
    assert after.result(120) == 3 and worker.pid != before
    stopped = worker.submit(functions.steps, 1000, 0.05, most_seconds=60)
    wait_until(lambda: stopped.state == "running")
    stopped.cancel()
    with pytest.raises(Cancelled):
        stopped.result(120)


def test_what_answers_a_click_is_repeated_once_where_the_child_dies(worker, tmp_path):
    order: list[str] = []
    job = worker.submit(functions.held_at_first, tmp_path / "began", 7, repeated=True)
    job.add_done_callback(lambda _: order.append("first"))
    wait_until((tmp_path / "began").exists)
    after = worker.submit(functions.echo, 8)
    after.add_done_callback(lambda _: order.append("second"))
    os.kill(worker.pid, signal.SIGKILL)
    assert (job.result(60), after.result(60)) == (7, 8)
    wait_until(lambda: len(order) == 2)
    assert order == ["first", "second"]
    deadly = worker.submit(functions.kill_myself, repeated=True)
    with pytest.raises(WorkerDied, match=r"kill_myself.*SIGKILL.*second time.*isn't tried again"):
        deadly.result(60)
    assert worker.submit(functions.echo, 9).result(60) == 9


@pytest.mark.parametrize("by", ["the newest of its key", "a cancel"])
def test_what_is_repeated_gives_way_to(by, worker, tmp_path):
    mark = tmp_path / "began"
    job = worker.submit(functions.held_at_first, mark, 1, key="click", repeated=True)
    wait_until(mark.exists)
    if by == "a cancel":
        job.cancel()
    newer = worker.submit(functions.echo, 2, key="click", repeated=True)
    os.kill(worker.pid, signal.SIGKILL)
    with pytest.raises(Cancelled):
        job.result(60)
    assert newer.result(60) == 2
