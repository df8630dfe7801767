"""The parent's side of a worker's child process: start, end, results."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from multiprocessing.connection import Connection
from typing import Any

from app.server.ending import signals_blocked
from app.server.job import Job, JobFailed
from app.server.worker import pack, send, unpack
from model.core.errors import ArtiworldError
from model.core.threads import with_threads


class Child:
    """A started child process with our end of its pipe.

    Args:
        name: name of its worker.
        threads: numeric threads in it.
        setup: its first call.

    Attributes:
        ready: whether that call has returned.
        cancelled: numbers of the jobs that it was asked to stop.
    """

    def __init__(self, name: str, threads: int, setup: tuple[Any, ...]) -> None:
        self.ready = False
        self.cancelled: set[int] = set()
        self.connection: Connection
        self.connection, theirs = multiprocessing.Pipe(duplex=True)
        descriptor = theirs.fileno()
        paths = [os.path.abspath(p) for p in sys.path]
        code = (
            f"import sys; sys.path[:] = {paths!r}; from app.server.worker import main; "
            f"main({descriptor}, {os.getpid()}, {name!r})"
        )
        with signals_blocked():
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", code],
                pass_fds=[descriptor],
                stdin=subprocess.DEVNULL,
                env=with_threads(os.environ, threads),
            )
        theirs.close()
        send(self.connection, "setup", 0, pack(setup))

    def kill(self) -> None:
        """Kill the process and wait for its end."""
        self.connection.close()
        self.process.kill()
        self.process.wait()


def finish(job: Job[Any], chunks: list[Any]) -> None:
    """End a job with the result of its child."""
    try:
        kind, value = unpack(chunks)
    except Exception as error:  # an unreadable result fails its job, nothing else
        job.end("failed", error=JobFailed(f"{job.name}: unreadable result: {error}"))
        return
    if kind == "done":
        job.end("done", value)
    elif value["kind"] == "cancelled":
        job.end("cancelled")
    else:
        job.end("failed", error=error_of(job.name, value))


def error_of(name: str, described: dict[str, Any]) -> Exception:
    """Return the exception that :func:`app.server.worker.describe_error` described."""
    if described["kind"] != "user":
        return JobFailed(f"{name}: {described['message']}", described["text"])
    error: ArtiworldError = described["type"].__new__(described["type"], described["message"])
    error.__dict__.update(described["state"])
    return error


def death(code: int | None) -> str:
    """Return how a process ended, for people."""
    if code is None or code >= 0:
        return f"exited (code {code})"
    name = signal.Signals(-code).name
    if -code == signal.SIGKILL:
        return f"was killed ({name}; often because memory ran out)"
    return f"crashed ({name})"
