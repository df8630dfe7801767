"""What the worker runs in tests: jobs must be importable by name in the child."""

from __future__ import annotations

import ctypes
import errno
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.server import scene_tasks, segmenting_tasks
from app.server.jobs import WorkerProcess
from model.core.errors import InputFileError, KinematicsError
from model.core.geometry import PointCloud
from model.core.progress import Progress

_state: dict[str, int] = {}


def echo(value):
    return value


def crash_on(word: str) -> str:
    if word == "crash":
        os.kill(os.getpid(), signal.SIGKILL)
    return word


def imported(module: str) -> bool:
    return module in sys.modules


def pid() -> int:
    return os.getpid()


def wait_for(path: Path) -> None:
    """Keep the worker until a file is there."""
    while not path.exists():
        time.sleep(0.05)


def no_room() -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def count_calls() -> int:
    _state["calls"] = _state.get("calls", 0) + 1
    return _state["calls"]


_kept: list[bytes] = []


def keep(size: int) -> None:
    _kept.append(b"x" * size)


def set_start(value: int) -> None:
    _state["calls"] = value


def broken_start() -> None:
    raise OSError("no weights here")


def fail(message: str) -> None:
    raise ValueError(message)


def bad_file() -> None:
    raise InputFileError("scan.ply", "is empty", "export it again")


def bad_tree() -> None:
    raise KinematicsError(["no root", "a cycle"])


def unpicklable():
    return lambda: 1


def leave(code: int) -> None:
    sys.exit(code)


def steps(count: int, seconds: float, *, progress: Progress) -> int:
    for i in range(count):
        progress(i / count, f"step {i}")
        time.sleep(seconds)
    return count


def span(count: int, seconds: float, *, progress: Progress) -> tuple[float, float]:
    began = time.monotonic()
    steps(count, seconds, progress=progress)
    return began, time.monotonic()


def deaf(seconds: float, began: Path | None = None) -> None:
    if began is not None:
        began.touch()
    time.sleep(seconds)


def kill_myself(number: int = signal.SIGKILL) -> None:
    os.kill(os.getpid(), number)
    time.sleep(5)


def killed_while_opening(*_: object) -> None:
    kill_myself()


def held_at_first(mark: Path, value: int = 0) -> int:
    """Wait to be killed in the first call; the mark says that it began."""
    if not mark.exists():
        mark.touch()
        time.sleep(60)
    return value


def segment_and_die_of_two(
    folder: Path,
    workspace: Path,
    segmenter: str,
    prompts: tuple[Any, ...],
    *more: Any,
    progress: Progress,
) -> Any:
    """Wait to be killed in the first call, and die of two prompts; answer all others."""
    held_at_first(workspace / "began")
    if len(prompts) == 2:
        kill_myself()
    return segmenting_tasks.segment(folder, workspace, segmenter, prompts, *more, progress=progress)


def append(path: str, text: str, seconds: float = 0.0) -> str:
    time.sleep(seconds)
    with Path(path).open("a") as file:
        file.write(text)
    return text


def threads() -> str | None:
    return os.environ.get("OMP_NUM_THREADS")


def cloud(count: int) -> PointCloud:
    return PointCloud(np.arange(3.0 * count, dtype=np.float32).reshape(-1, 3))


def mean(value: PointCloud) -> float:
    return float(value.points.mean())


def priority_and_limit() -> tuple[int, bool]:
    """The process's niceness, and whether its memory has a limit."""
    soft, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return os.getpriority(os.PRIO_PROCESS, 0), soft != resource.RLIM_INFINITY


def start_grandchild_then_die() -> None:
    subprocess.Popen(["sleep", "6"], close_fds=False)
    os.kill(os.getpid(), signal.SIGKILL)


def hold_a_worker(seconds: float) -> None:
    """A server with a busy worker, in a process of its own: prints the worker's pid."""
    worker = WorkerProcess("held")
    print(worker.submit(pid).result(30), flush=True)
    worker.submit(deaf, seconds)
    time.sleep(seconds)


def hold_the_interpreter(started: str) -> None:
    """Ignore cancels and messages, as a library's long call does."""
    Path(started).touch()
    ctypes.PyDLL(None).sleep(1000)  # with the interpreter's lock


def reads_for_ever(*_: object, **__: object) -> None:
    time.sleep(1000)


def shapes_without_end_of_rocks(paths: Sequence[Path], *more: Any, progress: Progress) -> Any:
    """Hang in a rock, as a reader does that finds no end."""

    def hang(fraction: float, message: str) -> None:
        progress(fraction, message)
        if message.startswith("rock"):
            time.sleep(1000)

    return scene_tasks.shapes(paths, *more, progress=hang)


def click_slowly(*asked: Any, found: Any, progress: Progress) -> Any:
    """Answer a click; the labels take half a second longer than the prompt."""

    def tell(prompt: Any) -> None:
        found(prompt)
        time.sleep(0.5)

    return segmenting_tasks.click(*asked, found=tell, progress=progress)


def read_badly(path: Path, is_scene: bool) -> int:
    """What a broken reader does, by the file's content."""
    match path.read_bytes():
        case b"crash":
            os.abort()
        case b"hang":
            time.sleep(1000)
        case b"blow-up":
            return len(bytearray(64 << 30))
    raise KeyError("chapter")


ROOT = Path(__file__).parents[2]


class PathTrace:
    """A profile function: the files on the stack whenever a function of some files is called.

    What other threads do beside it, such as the gallery's and those that run every second, doesn't
    count.

    Args:
        threads: pattern of the names of the threads that count.

    Attributes:
        counting: whether calls count now.
        files: those of ours, from the top of the repository.
    """

    def __init__(
        self, stations: Sequence[str], counting: bool = False, threads: str = ".*"
    ) -> None:
        self._threads = re.compile(threads)
        self._stations = {str(ROOT / station) for station in stations}
        self.counting, self.files = counting, set[str]()

    def __call__(self, frame: Any, event: str, _: Any) -> None:
        if event != "call" or not self.counting or frame.f_code.co_filename not in self._stations:
            return
        if not self._threads.fullmatch(threading.current_thread().name):
            return
        while frame is not None:
            path = frame.f_code.co_filename.removeprefix(f"{ROOT}/")
            if path.startswith(("app/", "model/", "sessions/")):
                self.files.add(path)
            frame = frame.f_back


_traces: list[PathTrace] = []


def begin_trace(stations: Sequence[str]) -> None:
    """Trace what this worker calls from now on."""
    _traces.append(PathTrace(stations, counting=True))
    sys.setprofile(_traces[-1])


def end_trace() -> set[str]:
    """The files of the trace, which ends."""
    sys.setprofile(None)
    return _traces.pop().files
