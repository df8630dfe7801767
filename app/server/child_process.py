"""The parent's side of a worker's child process: start, end, results."""

from __future__ import annotations

import multiprocessing
import os
import signal
from multiprocessing.connection import Connection
from typing import Any

from app.server.job import Job, JobFailed
from app.server.worker import pack, send, unpack
from app.server.worker_template import Process, WorkerTemplate, start_python
from model.core.errors import ArtiworldError


class Child:
    """A started child process with our end of its pipe.

    Args:
        name: name of its worker.
        threads: numeric threads in it.
        setup: its first call.
        template: what it is forked from; None starts an interpreter.

    Attributes:
        ready: whether that call has returned.
        cancelled: numbers of the jobs that it was asked to stop.
    """

    def __init__(
        self,
        name: str,
        threads: int,
        setup: tuple[Any, ...],
        template: WorkerTemplate | None = None,
    ) -> None:
        self.ready = False
        self.cancelled: set[int] = set()
        self.connection: Connection
        self.connection, theirs = multiprocessing.Pipe(duplex=True)
        descriptor = theirs.fileno()
        forked = None if template is None else template.fork(name, descriptor)
        self.process: Process
        if forked is not None:
            self.process = forked
        else:
            code = (
                f"from app.server.worker import main; main({descriptor}, {os.getpid()}, {name!r})"
            )
            self.process = start_python(code, descriptor, threads)
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
    """Return a human-readable description of how a process ended."""
    if code is None or code >= 0:
        return f"exited (code {code})"
    name = signal.Signals(-code).name
    if -code == signal.SIGKILL:
        return f"was killed ({name}; often because memory ran out)"
    return f"crashed ({name})"
