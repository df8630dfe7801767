"""Commands and jobs of a workspace as rows, for figures about work.

The command log holds what people decided; ``jobs.jsonl`` of the workspace holds what they waited
for, such as the reading of a file, which is no decision: one line of JSON a job, only ever
appended, by several servers too.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from sqlalchemy import Text, case, null, select
from sqlalchemy import cast as sql_cast

from model.core.errors import StoreError
from sessions.database import Database, commands, objects, sqlite_file

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
                int(fields["object"]),
                str(fields["kind"]),
                float(fields["at"]),
                float(fields["seconds"]),
            )
        except (ValueError, KeyError, TypeError):
            continue
        if math.isfinite(job.at) and 0 <= job.seconds < math.inf:
            yield job


def seconds_of(at: str) -> float:
    """Seconds since 1970 of a stored time (ISO 8601, UTC)."""
    return datetime.fromisoformat(at).replace(tzinfo=UTC).timestamp()


_PREDICTION = "record_prediction"


@dataclass(frozen=True)
class LoggedCommand:
    """A command without its content.

    Attributes:
        object: id of its object.
        seq: number among the commands of the object.
        at: seconds since 1970.
        who: the person, or the software that read the source.
        kind: stored name, see :data:`sessions.commands.KINDS`.
        predictor: of a recorded prediction with joints: who predicted, with its version.
        seconds: of a recorded prediction: the predictor's own time.
    """

    object: int
    seq: int
    at: float
    who: str
    kind: str
    predictor: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class LoggedObject:
    """Present name, category ("" for none) and review state of an object."""

    name: str
    category: str
    state: str


@dataclass(frozen=True)
class WorkLog:
    """Everything that figures about work are made of.

    Attributes:
        commands: of all objects, each object's in order.
        objects: by their id.
        jobs: what people waited for.
    """

    commands: tuple[LoggedCommand, ...]
    objects: Mapping[int, LoggedObject]
    jobs: tuple[TimedJob, ...] = ()


def check_workspace(workspace: Path, database_url: str | None = None) -> None:
    """Refuse a folder that is no workspace yet, where opening the store would make one.

    Raises:
        StoreError: where there is none.
    """
    if not workspace.is_dir() or not (database_url or (workspace / "artiworld.db").is_file()):
        raise StoreError(f"{workspace}: is no workspace; give the one of serve --workspace")


def open_database(workspace: Path, database_url: str | None = None) -> Database:
    """The database of a workspace that is there.

    Raises:
        StoreError: where there is none.
    """
    check_workspace(workspace, database_url)
    return Database(database_url or sqlite_file(workspace / "artiworld.db"))


def read_work(workspace: Path, database_url: str | None = None) -> WorkLog:
    """Read the log of a workspace.

    Raises:
        StoreError: where there is none, or it can't be read.
    """
    database = open_database(workspace, database_url)
    try:
        return read_work_from(database, workspace)
    finally:
        database.close()


def read_work_from(database: Database, workspace: Path) -> WorkLog:
    """The same from a database that is open."""
    predicted = case(
        (commands.c.kind == _PREDICTION, commands.c.payload), else_=sql_cast(null(), Text)
    )
    wanted = select(
        commands.c.object_id,
        commands.c.seq,
        commands.c.at,
        commands.c.who,
        commands.c.kind,
        predicted.label("payload"),
    ).order_by(commands.c.object_id, commands.c.seq)
    known = select(objects.c.id, objects.c.name, objects.c.category, objects.c.state)
    with database.reading() as connection:
        rows = connection.execute(wanted).all()
        named = connection.execute(known).all()
    return WorkLog(
        tuple(
            LoggedCommand(r.object_id, r.seq, seconds_of(r.at), r.who, r.kind, *_about(r.payload))
            for r in rows
        ),
        {r.id: LoggedObject(r.name, r.category or "", r.state) for r in named},
        tuple(read_jobs(workspace)),
    )


def _about(payload: str | None) -> tuple[str, float]:
    """Predictor and its seconds of a recorded prediction."""
    if payload is None:
        return "", 0.0
    prediction = json.loads(payload).get("prediction") or {}
    if prediction.get("tree") is None:
        return "", 0.0
    return str(prediction.get("backend") or ""), float(prediction.get("seconds") or 0.0)
