"""The child's side of :mod:`app.server.jobs`: reads jobs from a pipe, runs them, sends results.

A job that arrives while another one runs preempts it between two of its steps; the parent sends
only jobs that may. Imports nothing heavy itself.
"""

from __future__ import annotations

import ctypes
import faulthandler
import inspect
import os
import pickle
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from app.server.ending import ignore_end_signals
from model.core.errors import ArtiworldError
from model.core.progress import Cancelled, die_with_parent

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
    connection.send_bytes(pickle.dumps((kind, number, sizes), protocol=5))
    for chunk, (size, _) in zip(chunks or [], sizes, strict=True):
        if size:
            connection.send_bytes(chunk)


def receive(connection: Connection) -> tuple[str, int, list[Any]]:
    """Receive one message: kind, job number, chunks for :func:`unpack`.

    Raises:
        EOFError, OSError: where the other side is gone.
    """
    kind, number, sizes = pickle.loads(connection.recv_bytes())
    chunks: list[Any] = []
    for size, readonly in sizes:
        buffer = bytearray(size)
        if size:
            connection.recv_bytes_into(buffer)
        chunks.append(memoryview(buffer).toreadonly() if readonly else buffer)
    return kind, number, chunks


def describe_error(error: BaseException) -> dict[str, Any]:
    """Describe ``error`` so that the parent can raise it; users' errors keep type and message.

    An exception with its own ``__init__`` can't be pickled itself.
    """
    text = "".join(traceback.format_exception(error))
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
                kind, number, chunks = receive(self._connection)
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
            if "progress" not in kwargs and _takes_progress(function):
                kwargs["progress"] = self._progress(number)
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


def _takes_progress(function: Callable[..., object]) -> bool:
    try:
        return "progress" in inspect.signature(function).parameters
    except (TypeError, ValueError):
        return False


def _trim_memory() -> None:
    """Return free memory to the system, where the C library can."""
    if sys.platform.startswith("linux"):
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def main(descriptor: int, parent: int, name: str) -> None:
    """Run the child until the pipe closes."""
    die_with_parent(parent)
    faulthandler.enable()
    ignore_end_signals()
    threading.current_thread().name = name
    _Worker(Connection(descriptor)).run()
