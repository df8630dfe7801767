"""Durations of jobs for objects: one line of JSON each, in ``jobs.jsonl`` of the workspace.

The command log holds what people decided; this file holds what they waited for, such as the reading
of a file, which is no decision. Lines are only ever appended; several servers may do so.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

log = logging.getLogger(__name__)

FILE: Final = "jobs.jsonl"
PICK: Final = "pick"
AWAITED: Final = frozenset({"open", PICK, "segment", "predict", "tool", "room"})
"""Jobs that a person sees nothing before the end of."""
ACCEPT: Final = "accept"
"""From the request to the acceptance, which a person needn't wait for."""
BULK: Final = "bulk"
"""Work on many objects: commands of a person who isn't at it."""
KINDS: Final = AWAITED | {ACCEPT, BULK}
LEAST: Final = 0.05
"""Seconds: nobody notices a click that is answered sooner, as most are, so it isn't kept."""


@dataclass(frozen=True)
class TimedJob:
    """A job for an object.

    Attributes:
        object: its id.
        kind: one of :data:`KINDS`.
        at: when it was asked for, seconds since 1970.
        seconds: until its end, waiting for a free worker included.
    """

    object: int
    kind: str
    at: float
    seconds: float

    @property
    def end(self) -> float:
        """When it ended, seconds since 1970."""
        return self.at + self.seconds


def counts(kind: str, seconds: float) -> bool:
    """True if a job is kept: all of :data:`KINDS` but the answers to clicks that came at once."""
    return kind in KINDS and (seconds >= LEAST or kind not in (PICK, "segment"))


def record_job(workspace: Path, job: TimedJob) -> None:
    """Append a job; a full disk is only logged, as no decision is lost."""
    line = json.dumps(asdict(job), separators=(",", ":")) + "\n"
    try:
        # A short line in one call to write(): lines of several processes don't mix.
        with (workspace / FILE).open("ab", buffering=0) as file:
            file.write(line.encode())
    except OSError as error:
        log.warning("%s: can't be written (%s)", workspace / FILE, error.strerror)


def read_jobs(workspace: Path) -> list[TimedJob]:
    """All jobs in the order of their end; lines that are cut off or damaged are left out."""
    try:
        text = (workspace / FILE).read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return []
    return list(_read(text.splitlines()))


def _read(lines: Iterable[str]) -> Iterable[TimedJob]:
    for line in lines:
        try:
            fields = json.loads(line)
            job = TimedJob(
                int(fields["object"]), str(fields["kind"]), float(fields["at"]),
                float(fields["seconds"]),
            )  # fmt: skip
        except (ValueError, KeyError, TypeError):
            continue
        if math.isfinite(job.at) and 0 <= job.seconds < math.inf:
            yield job


def seconds_of(at: str) -> float:
    """Seconds since 1970 of a stored time (ISO 8601, UTC)."""
    return datetime.fromisoformat(at).replace(tzinfo=UTC).timestamp()
