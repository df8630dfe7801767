"""The connection to the database: tables, format, errors in plain words, and rows of objects."""

from __future__ import annotations

import re
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sqlalchemy import (
    Column,
    Connection,
    Engine,
    ForeignKey,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    create_engine,
    event,
    exc,
    inspect,
    select,
    text,
)
from sqlalchemy.engine import URL, make_url

from model.core.errors import StoreError
from sessions.commands import Command
from sessions.review import ReviewState

FORMAT = "0004"
"""Newest migration; the format that this version reads and writes."""

_MIGRATION_LOCK = 0x41525449
"""Lock number of all processes; a server can't lock tables before they exist."""

_MIGRATIONS = Path(__file__).resolve().parent / "migrations"

metadata = MetaData()

meta = Table(
    "meta",
    metadata,
    Column("key", String(64), primary_key=True),
    Column("value", Text, nullable=False),
)

objects = Table(
    "objects",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("path", Text, nullable=False, unique=True),
    Column("name", Text, nullable=False),
    Column("sha256", String(64)),
    Column("created", String(32), nullable=False),
    Column("assigned_to", Text),
    # What the queue shows, kept up to date by each append.
    Column("seq", Integer, nullable=False),
    Column("state", String(16), nullable=False),
    Column("prompts", Integer, nullable=False),
    Column("parts", Integer, nullable=False),
    Column("category", Text),
    Column("who", Text),
    Column("updated", String(32), nullable=False),
)

commands = Table(
    "commands",
    metadata,
    Column("object_id", Integer, ForeignKey("objects.id"), primary_key=True),
    Column("seq", Integer, primary_key=True, autoincrement=False),
    Column("at", String(32), nullable=False),
    Column("who", Text, nullable=False),
    Column("kind", String(32), nullable=False),
    Column("payload", Text, nullable=False),
)

snapshots = Table(
    "snapshots",
    metadata,
    Column("object_id", Integer, ForeignKey("objects.id"), primary_key=True),
    Column("seq", Integer, primary_key=True, autoincrement=False),
    Column("format", Integer, nullable=False),
    Column("blob", LargeBinary, nullable=False),
)


class Database:
    """An engine whose errors are :class:`~model.core.errors.StoreError`.

    Args:
        url: any SQLAlchemy URL; :func:`sqlite_file` makes one of a path. SQLite runs in WAL mode
            and syncs at each commit, so neither the end of the process nor a power cut loses a
            commit.
        busy_timeout: seconds to wait for another process that is writing.
    """

    def __init__(self, url: str | URL, busy_timeout: float = 10.0) -> None:
        self.url = _parse(url)
        self.name = self.url.render_as_string(hide_password=True)
        if self.url.get_backend_name() == "sqlite":
            self.name = self.url.database or self.name
        self.engine = _engine(self.url, busy_timeout)
        # SQLite's own wait for another writer sleeps ever longer, and some threads get no turn.
        sqlite = self.url.get_backend_name() == "sqlite"
        self._turn = threading.Lock() if sqlite else nullcontext()
        self._writer = self.engine.execution_options(artiworld_write=True)
        try:
            self._migrate()
        except BaseException:
            self.engine.dispose()
            raise

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Open a transaction that only reads."""
        with self.translated(), self.engine.connect() as connection:
            yield connection

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """Open a transaction that locks for writing from its start; it commits at the end."""
        with self._turn, self.translated(), self._writer.begin() as connection:
            yield connection

    def close(self) -> None:
        """Close the connections."""
        self.engine.dispose()

    @contextmanager
    def translated(self) -> Iterator[None]:
        """Turn the driver's errors into readable ones."""
        try:
            yield
        except (exc.DBAPIError, sqlite3.Error) as error:
            raise StoreError(f"{self.name}: {_plain_words(error)}") from error

    def _migrate(self) -> None:
        with self.reading() as connection:
            if self._format(connection) == FORMAT:
                return
        # Checked again under the lock: another process may have been first.
        with self.writing() as connection:
            if connection.dialect.name == "postgresql":
                connection.execute(text(f"SELECT pg_advisory_xact_lock({_MIGRATION_LOCK})"))
            found = self._format(connection)
            if found == FORMAT:
                return
            _upgrade(connection)
            if found is None:
                connection.execute(meta.insert().values(key="application", value="artiworld"))

    def _format(self, connection: Connection) -> str | None:
        """Return the format of the database; None where it is empty."""
        tables = inspect(connection).get_table_names()
        if "alembic_version" not in tables:
            if tables:
                raise StoreError(
                    f"{self.name}: is a database of another program (tables "
                    f"{', '.join(sorted(tables)[:5])}); choose an empty one"
                )
            return None
        rows = connection.execute(text("SELECT version_num FROM alembic_version")).all()
        found = rows[0][0] if rows else None
        if found is not None and found not in known_formats():
            raise StoreError(
                f"{self.name}: has format {found}, this version of ArtiWorld knows up to {FORMAT}; "
                "use the newer version that wrote it"
            )
        if found is not None and "meta" in tables:
            owner = select(meta.c.value).where(meta.c.key == "application")
            if connection.execute(owner).scalar() != "artiworld":
                raise StoreError(f"{self.name}: is a database of another program")
        return found


def known_formats() -> tuple[str, ...]:
    """Return all readable formats, oldest first."""
    return tuple(sorted(f.name[:4] for f in (_MIGRATIONS / "versions").glob("[0-9]*_*.py")))


def _upgrade(connection: Connection) -> None:
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS).replace("%", "%%"))
    config.attributes["connection"] = connection
    command.upgrade(config, "head")


def sqlite_file(path: Path) -> URL:
    """Return the URL of an SQLite file, whatever characters its path has."""
    return URL.create("sqlite", database=str(path))


def _parse(url: str | URL) -> URL:
    try:
        parsed = make_url(url)
    except exc.ArgumentError as error:
        raise StoreError(
            "the database must be an SQLAlchemy URL such as postgresql+psycopg://user@host/name"
        ) from error
    if parsed.get_backend_name() == "sqlite" and parsed.database in (None, "", ":memory:"):
        raise StoreError("an SQLite database in memory keeps nothing; name a file")
    return parsed


def _engine(url: URL, busy_timeout: float) -> Engine:
    sqlite = url.get_backend_name() == "sqlite"
    try:
        engine = create_engine(url, connect_args={"timeout": busy_timeout} if sqlite else {})
    except (ImportError, exc.NoSuchModuleError) as error:
        raise StoreError(
            f"no driver for {url.drivername} databases is installed ({error})"
        ) from error
    if sqlite:
        event.listen(engine, "connect", _set_up_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    return engine


def _set_up_sqlite(connection: sqlite3.Connection, _record: object) -> None:
    connection.isolation_level = None  # the begin event decides, not the driver
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}").close()


def _begin_sqlite(connection: Connection) -> None:
    # A reader that turns writer later can't be queued by SQLite, only refused.
    write = connection.get_execution_options().get("artiworld_write", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")


def _plain_words(error: Exception) -> str:
    cause = getattr(error, "orig", None) or error
    first = cause.args[0] if cause.args else ""
    # Some drivers hand over the server's message as fields, M being the text.
    words = str(first.get("M", first) if isinstance(first, dict) else cause).splitlines()[0]
    remedies = {
        "locked": "another program is writing to it and doesn't finish; close that program",
        "not a database": "is no database; move it away, or restore it from a copy",
        "malformed": "is damaged; restore it from a copy (the files -wal and -shm belong to it)",
        "readonly": "can't be written; you need the right to write to the file and its folder",
        "unable to open": "can't be opened; its folder must exist and you must be able to write",
        "full": "no room is left on the disk",
        "I/O": "the disk reports an error",
    }
    for sign, remedy in remedies.items():
        if sign in words:
            return f"{remedy} ({words})"
    return words


@dataclass(frozen=True)
class ObjectRecord:
    """One line of the queue.

    Attributes:
        id: in this workspace.
        path: the source, absolute.
        name: short display name.
        sha256: of the source when it was opened first, None where it wasn't read yet.
        state: see :mod:`sessions.review`.
        prompts, parts: how many.
        category: what it is, or None.
        who: author of the last command, "" before the first.
        updated, created: ISO 8601, UTC.
        assigned_to: the annotator whom a rejected object waits for, or None.
        seq: number of the last command.
        changed: whether the source changed since it was annotated (only from ``open_object``).
    """

    id: int
    path: Path
    name: str
    sha256: str | None
    state: ReviewState
    prompts: int
    parts: int
    category: str | None
    who: str
    updated: str
    created: str
    assigned_to: str | None
    seq: int
    changed: bool = False

    @property
    def asset_name(self) -> str:
        """Name of the folder of its accepted asset."""
        plain = re.sub(r"[^A-Za-z0-9._-]+", "_", self.name).strip("._") or "object"
        return f"{plain[:60]}-{self.id}"


@dataclass(frozen=True)
class Entry:
    """One command as it was given.

    Attributes:
        seq: 1 for the first command of an object.
        at: ISO 8601, UTC.
        who: the person.
        command: the decision.
    """

    seq: int
    at: str
    who: str
    command: Command

    @property
    def kind(self) -> str:
        """The command's name in JSON."""
        return self.command.kind


@dataclass(frozen=True)
class PendingAcceptance:
    """An acceptance that began and has not ended.

    Attributes:
        seq: number of the object's last command then.
        comment, override: as the person typed them.
        hold_reason: why validation put it on hold after the person had gone on; "" where it is
            under way, or was cut off.
    """

    seq: int
    comment: str = ""
    override: str = ""
    hold_reason: str = ""


def now(seconds: float = 0.0) -> str:
    """The moment in ``seconds`` as ISO 8601, UTC, microseconds; sorts as text."""
    return (datetime.now(UTC) + timedelta(seconds=seconds)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
