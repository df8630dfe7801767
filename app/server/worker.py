"""The child's side of :mod:`app.server.jobs`: reads jobs from a pipe, runs them, sends results; and
the template, a process that has imported what workers need and forks them: each starts in
milliseconds, and all share the memory of the libraries.

A job that arrives while another one runs preempts it between two of its steps; the parent sends
only jobs that may. Imports nothing heavy itself.

The template is only for Linux: elsewhere some of the libraries don't survive a fork. It imports and
forks, in one thread, and computes nothing, so no library has threads or locks of its own at that
moment (OpenBLAS ends its threads before a fork).
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import gc
import importlib
import inspect
import os
import pickle
import queue
import selectors
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Container
from functools import partial
from multiprocessing.connection import Connection, wait
from typing import Any

from app.server.ending import ignore_end_signals, signals_blocked
from model.core.errors import ArtiworldError, no_space
from model.core.progress import Cancelled, die_with_parent, with_threads

PROGRESS_PERIOD = 0.03
"""Least seconds between two progress messages."""

TRIM_SECONDS = 1.0
"""Duration of a job after which free memory goes back to the system: glibc keeps fragments, which
grow to gigabytes over the objects of a scene."""


def pack(value: object) -> list[Any]:
    """Pickle ``value`` with its arrays beside it, not copied: [pickle, buffer, buffer, …]."""
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    return [data, *(b.raw() for b in buffers)]


def unpack(chunks: list[Any]) -> Any:
    """Return the value that :func:`pack` pickled. Read-only arrays stay read-only."""
    return pickle.loads(chunks[0], buffers=chunks[1:])


def send(connection: Connection, kind: str, number: int, chunks: list[Any] | None = None) -> None:
    """Send one message; ``chunks`` come from :func:`pack`."""
    sizes = [(memoryview(c).nbytes, memoryview(c).readonly) for c in chunks or []]
    connection.send_bytes(pickle.dumps((kind, number, sizes, time.monotonic()), protocol=5))
    for chunk, (size, _) in zip(chunks or [], sizes, strict=True):
        if size:
            connection.send_bytes(chunk)


def receive(connection: Connection) -> tuple[str, int, list[Any], float]:
    """Receive one message: kind, job number, chunks for :func:`unpack`, monotonic time of sending.

    Raises:
        EOFError, OSError: where the other side is gone.
    """
    kind, number, sizes, sent = pickle.loads(connection.recv_bytes())
    chunks: list[Any] = []
    for size, readonly in sizes:
        buffer = bytearray(size)
        if size:
            connection.recv_bytes_into(buffer)
        chunks.append(memoryview(buffer).toreadonly() if readonly else buffer)
    return kind, number, chunks, sent


def describe_error(error: BaseException) -> dict[str, Any]:
    """Describe ``error`` so that the parent can raise it; users' errors keep type and message.

    An exception with its own ``__init__`` can't be pickled itself.
    """
    text = "".join(traceback.format_exception(error))
    if isinstance(error, OSError):
        error = no_space(error.filename or "the workspace", error) or error
    out: dict[str, Any] = {
        "kind": "failed",
        "message": f"{type(error).__name__}: {error}",
        "text": text,
    }
    if isinstance(error, Cancelled):
        out["kind"] = "cancelled"
    elif isinstance(error, MemoryError):
        text = "it doesn't fit into memory: thin it, or cut it into pieces"
        out.update(kind="user", type=ArtiworldError, message=text, state={})
    elif isinstance(error, ArtiworldError):
        state = {k: v for k, v in vars(error).items() if _picklable(v)}
        out.update(kind="user", type=type(error), message=str(error), state=state)
        if not _picklable(type(error)):
            out["type"] = ArtiworldError
    return out


def _picklable(value: object) -> bool:
    try:
        pickle.dumps(value)
    except (pickle.PicklingError, TypeError, AttributeError):
        return False
    return True


class _Worker:
    """The child process: one thread reads the pipe, the main thread runs the jobs."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._send_lock = threading.Lock()
        self._jobs: queue.SimpleQueue[tuple[str, int, list[Any]]] = queue.SimpleQueue()
        self._cancelled: set[int] = set()

    def run(self) -> None:
        threading.Thread(target=self._read, name="pipe reader", daemon=True).start()
        while True:
            self._run(*self._jobs.get())

    def _run(self, kind: str, number: int, chunks: list[Any]) -> None:
        start = time.monotonic()
        if kind != "setup":
            self._send("begun", number, None)
        answer = self._answer(number, chunks)
        del chunks
        self._send("ready" if kind == "setup" and answer[0] == "done" else "answer", number, answer)
        del answer
        if time.monotonic() - start > TRIM_SECONDS:
            _trim_memory()

    def _read(self) -> None:
        while True:
            try:
                kind, number, chunks, _ = receive(self._connection)
            except (EOFError, OSError):
                os._exit(0)  # the parent is gone
            if kind == "cancel":
                self._cancelled.add(number)
            else:
                self._jobs.put((kind, number, chunks))

    def _send(self, kind: str, number: int, value: object) -> None:
        try:
            chunks = pack(value)
        except Exception as error:
            chunks = pack(("error", describe_error(error)))
        with self._send_lock:
            try:
                send(self._connection, kind, number, chunks)
            except OSError:
                os._exit(0)

    def _answer(self, number: int, chunks: list[Any]) -> tuple[str, Any]:
        try:
            function, args, kwargs = unpack(chunks)
            takes = _parameters(function)
            if "progress" in takes and "progress" not in kwargs:
                kwargs["progress"] = self._progress(number)
            if "found" in takes:
                kwargs["found"] = partial(self._send, "found", number)
            return "done", function(*args, **kwargs)
        except BaseException as error:  # the boundary of a job; Rust's panics are no Exception
            return "error", describe_error(error)
        finally:
            self._cancelled.discard(number)

    def _progress(self, number: int) -> Callable[[float, str], None]:
        last_time, last_message = 0.0, ""

        def progress(fraction: float, message: str) -> None:
            nonlocal last_time, last_message
            if number in self._cancelled:
                raise Cancelled(message)
            now = time.monotonic()
            if now - last_time >= PROGRESS_PERIOD or message != last_message:
                last_time, last_message = now, message
                self._send("progress", number, (float(fraction), str(message)))
            # Only the main thread runs jobs; a job may report from threads of its own.
            if threading.current_thread() is threading.main_thread():
                while not self._jobs.empty():
                    self._run(*self._jobs.get())
            if number in self._cancelled:
                raise Cancelled(message)

        return progress


def _parameters(function: Callable[..., object]) -> Container[str]:
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return ()


def _trim_memory() -> None:
    """Return free memory to the system, where the C library can."""
    if sys.platform.startswith("linux"):
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def work(descriptor: int, parent: int, name: str) -> None:
    """Run the child until the pipe closes."""
    die_with_parent(parent)
    faulthandler.enable()
    ignore_end_signals()
    threading.current_thread().name = name
    _Worker(Connection(descriptor)).run()


MODULES = [f"app.server.{name}_tasks" for name in ("display", "part", "prepare", "segmenting")]
"""Imports of the workers' first jobs: two seconds of a processor, mostly trimesh and scipy."""
_NUMBER = struct.Struct("<i")
_NAME_BYTES = 200


def start_python(code: str, descriptor: int, threads: int) -> subprocess.Popen[bytes]:
    """Start an interpreter that runs ``code``, with these paths and one open descriptor."""
    paths = [os.path.abspath(p) for p in sys.path]
    with signals_blocked():
        return subprocess.Popen(
            [sys.executable, "-P", "-c", f"import sys; sys.path[:] = {paths!r}; {code}"],
            pass_fds=[descriptor],
            stdin=subprocess.DEVNULL,
            env=with_threads(os.environ, threads),
        )


class WorkerTemplate:
    """Starts the template, and forks workers from it; for any thread.

    Args:
        threads: numeric threads in each worker.
    """

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._lock = threading.Lock()
        self._socket = self._begin()

    @staticmethod
    def possible() -> bool:
        """True if this system forks safely."""
        return sys.platform.startswith("linux")

    def _begin(self) -> socket.socket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        started = threading.Event()
        # Linux ties "die with the parent" to the thread that forked: this one lives as long.
        threading.Thread(
            target=self._keep, args=(theirs, started), name="worker template", daemon=True
        ).start()
        started.wait()
        return ours

    def _keep(self, theirs: socket.socket, started: threading.Event) -> None:
        number = theirs.fileno()
        code = f"from app.server.worker import main; main({number}, {os.getpid()})"
        try:
            process = start_python(code, number, self._threads)
        finally:
            theirs.close()
            started.set()
        process.wait()

    def fork(self, name: str, descriptor: int) -> Forked | None:
        """Begin a worker that talks over ``descriptor``; returns before it runs.

        None where the template is closed, or can't be started.
        """
        reader, writer = os.pipe()
        request = [name.encode()[:_NAME_BYTES]], [descriptor, writer]
        try:
            with self._lock:
                try:
                    socket.send_fds(self._socket, *request)
                except ConnectionError:  # it was killed, and its workers with it
                    self._socket.close()
                    self._socket = self._begin()
                    socket.send_fds(self._socket, *request)
        except OSError:
            os.close(reader)
            return None
        finally:
            os.close(writer)
        return Forked(reader)

    def close(self) -> None:
        """End the template and all its workers."""
        with self._lock:
            self._socket.close()


class Forked:
    """The server's side of a forked worker, with what it needs of :class:`subprocess.Popen`.

    Args:
        reader: pipe on which the template writes the worker's number, and later its exit code.

    Attributes:
        returncode: its exit code, minus the signal that ended it; None while it runs.
    """

    def __init__(self, reader: int) -> None:
        self._reader = reader
        self._lock = threading.Lock()
        self._pid: int | None = None
        self.returncode: int | None = None

    def __del__(self) -> None:
        if self._reader >= 0:
            os.close(self._reader)

    @property
    def pid(self) -> int | None:
        """Its number; None where it hasn't been forked yet."""
        self.poll()
        return self._pid

    def poll(self) -> int | None:
        """Return the exit code if it has ended."""
        with self._lock:
            while self._reader >= 0 and wait([self._reader], 0):
                self._read()
            return self.returncode

    def _read(self) -> None:
        data = os.read(self._reader, _NUMBER.size)
        if data and self._pid is None:
            self._pid = _NUMBER.unpack(data)[0]
            return
        # Without a word from it the template was killed, and its workers with it.
        self.returncode = _NUMBER.unpack(data)[0] if data else -signal.SIGKILL
        os.close(self._reader)
        self._reader = -1

    def kill(self) -> None:
        """Kill it, if it hasn't ended."""
        if self.poll() is None and self._pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)

    def wait(self) -> int | None:
        """Wait for its exit code; one that isn't forked yet ends itself: nobody holds its pipe."""
        with self._lock:
            while self._pid and self._reader >= 0:
                self._read()
        return self.returncode


# The template's own side.


def main(descriptor: int, parent: int) -> None:
    """Import, then fork a worker for each request until the server closes its end."""
    die_with_parent(parent)
    ignore_end_signals()
    for module in MODULES:
        with contextlib.suppress(ImportError):  # the worker's job will say so
            importlib.import_module(module)
    gc.collect()
    gc.freeze()  # else collections in the workers would copy all pages
    woken, waker = os.pipe()
    os.set_blocking(waker, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(waker, warn_on_full_buffer=False)
    requests = socket.socket(fileno=descriptor)
    reports: dict[int, int] = {}  # worker → pipe to the server
    with selectors.PollSelector() as selector:
        selector.register(requests, selectors.EVENT_READ)
        selector.register(woken, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.fileobj is requests:
                    data, received, _, _ = socket.recv_fds(requests, _NAME_BYTES, 2)
                    if not data:
                        os._exit(0)
                    name = data.decode(errors="replace")
                    ours = (descriptor, woken, waker, *reports.values())
                    pipe, report = received
                    pid = _fork(name, pipe, report, ours)
                    reports[pid] = report
                    os.close(pipe)
                    _report(reports[pid], pid)
                else:
                    os.read(woken, 4096)
            _reap(reports)


def _fork(name: str, pipe: int, report: int, ours: tuple[int, ...]) -> int:
    me = os.getpid()
    pid = os.fork()
    if pid:
        return pid
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for descriptor in (report, *ours):
            os.close(descriptor)
        work(pipe, me, name)
    finally:
        os._exit(1)


def _reap(reports: dict[int, int]) -> None:
    """Tell the server how the workers ended that ended."""
    while reports:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if not pid:
            return
        report = reports.pop(pid)
        _report(report, os.waitstatus_to_exitcode(status))
        os.close(report)


def _report(pipe: int, number: int) -> None:
    with contextlib.suppress(BrokenPipeError):  # the server no longer asks
        os.write(pipe, _NUMBER.pack(number))
