"""SIGTERM, SIGINT and a closed terminal end the server and its workers, at any moment."""

from __future__ import annotations

import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.server.ending import EndSignals
from tests.app.test_interrupt import in_group

MOST_SECONDS = 5.0
SERVE = [sys.executable, "-m", "app.cli.main", "serve", "--workspace"]


@pytest.fixture
def started() -> Iterator[list[subprocess.Popen[str]]]:
    """Processes, each the leader of a group; what is left of them is killed."""
    out: list[subprocess.Popen[str]] = []
    yield out
    for run in out:
        if in_group(run.pid):
            os.killpg(run.pid, signal.SIGKILL)
        run.wait()
        assert run.stdout is not None
        run.stdout.close()


def hear_signals() -> None:
    """Listen to signals that the tests themselves may ignore, as under nohup."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def start(words: list[str], started: list[subprocess.Popen[str]]) -> subprocess.Popen[str]:
    how = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    how |= {"preexec_fn": hear_signals, "start_new_session": True}
    run = subprocess.Popen(words, **how)
    started.append(run)
    return run


def ends(run: subprocess.Popen[str], number: int) -> str:
    """Send the signal as supervisors do, to the process and to its group; returns the output."""
    begun = time.monotonic()
    for _ in range(3):
        os.kill(run.pid, number)
        if in_group(run.pid):
            os.killpg(run.pid, number)
        time.sleep(random.Random(number).uniform(0, 0.002))
    while left := in_group(run.pid):
        assert time.monotonic() - begun < MOST_SECONDS, left
        time.sleep(0.01)
    printed = run.communicate()[0]
    assert "Traceback" not in printed and "Timeout" not in printed, printed
    return printed


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_workers_that_are_busy_do_not_delay_the_end(
    number: int, tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    code = f"from tests.app.busy_server import serve; serve({str(tmp_path)!r})"
    run = start([sys.executable, "-c", code], started)
    assert run.stdout is not None and "is ready" in run.stdout.readline()
    assert len(in_group(run.pid)) == 9  # itself, seven workers, and what they were forked from
    ends(run, number)
    assert run.returncode == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_the_start_ends_it(
    number: int, tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    """Also while trimesh is imported, which swallows a KeyboardInterrupt."""
    for wait in (0.05, 0.5, 1.0):
        run = start([*SERVE, str(tmp_path), "--port", "0"], started)
        caught = Path(f"/proc/{run.pid}/status")
        while not int(caught.read_text().partition("SigCgt:")[2].split()[0], 16) & 1 << 14:
            time.sleep(0.01)  # SIGTERM is number 15
        time.sleep(wait)
        ends(run, number)
        assert run.returncode in (0, 128 + number)


def test_the_end_is_forced_where_closing_hangs(
    tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    code = (
        "from app.server import ending; ending.END_SECONDS = 0.3; end = ending.EndSignals(); "
        "print('is ready', flush=True); end.wait(); "
        "import ctypes; ctypes.PyDLL(None).sleep(99)"
    )
    run = start([sys.executable, "-c", code], started)
    assert run.stdout is not None and "is ready" in run.stdout.readline()
    time.sleep(0.2)
    os.kill(run.pid, signal.SIGTERM)
    assert "Timeout" in run.communicate(timeout=MOST_SECONDS)[0] and run.returncode == 1


def test_the_end_of_a_forked_child_is_not_that_of_its_parent() -> None:
    """Process pools end their children by SIGTERM when one of them dies."""
    before = signal.getsignal(signal.SIGTERM)
    with EndSignals():
        child = multiprocessing.get_context("fork").Process(target=time.sleep, args=(60.0,))
        child.start()
        child.terminate()
        child.join(MOST_SECONDS)
        assert child.exitcode == -signal.SIGTERM
        time.sleep(0.2)  # the thread that reads the signals would end this process
    assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.parametrize("attempt", range(6))
def test_each_signal_ends_it_whenever_it_comes(
    attempt: int, tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    run = start([*SERVE, str(tmp_path), "--port", "0"], started)
    assert run.stdout is not None and "is ready" in run.stdout.readline()
    time.sleep(random.Random(attempt).uniform(0, 2))
    ends(run, (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)[attempt % 3])
