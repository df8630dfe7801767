"""All commands of a workspace as rows of few columns, for figures about work."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Text, case, null, select
from sqlalchemy import cast as sql_cast

from model.core.errors import StoreError
from sessions.database import Database, commands, objects, sqlite_file
from sessions.job_log import TimedJob, read_jobs, seconds_of

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
        commands.c.object_id, commands.c.seq, commands.c.at, commands.c.who, commands.c.kind,
        predicted.label("payload"),
    ).order_by(commands.c.object_id, commands.c.seq)  # fmt: skip
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
