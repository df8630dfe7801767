"""The workspace: a database of commands, and a folder of arrays.

Commands are only ever appended; all else in the database is derived from them: snapshots make
replays faster, and the columns of an object spare the queue from loading it.
"""

from __future__ import annotations

import dataclasses
import json
import os
import zlib
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy.typing as npt
from sqlalchemy import Connection, Row, delete, exc, insert, select, update

from model.core import codec
from model.core.errors import CommandError, StoreError
from sessions.checks import clean_text
from sessions.commands import NAME_LIMIT, Command, from_json, to_json
from sessions.database import (
    Database,
    Entry,
    ObjectRecord,
    PendingAcceptance,
    commands,
    meta,
    now,
    objects,
    snapshots,
    sqlite_file,
)
from sessions.people import People
from sessions.project_settings import Project
from sessions.review import Role
from sessions.serialise import VERSION, state_from_json, state_to_json
from sessions.state import Context, SessionState, apply, replay
from sessions.storage import STORAGE_VARIABLE, ArrayFiles, AssetStorage

SNAPSHOT_EVERY = 50
"""Commands between two snapshots."""
SNAPSHOTS_KEPT = 2
"""Snapshots kept of each object."""
_REMOVED, _ACCEPTING = "taken off ", "accepting "
"""Stored key prefixes, before an object's id, of marks that aren't decisions."""


class ConflictError(StoreError):
    """Another process appended first: read its commands and try again."""


# In the order of the record's fields.
_COLUMNS = tuple(objects.c[f.name] for f in dataclasses.fields(ObjectRecord) if f.name != "changed")


class Store:
    """A workspace folder with its database. Threads may share one; processes open their own.

    Args:
        workspace: folder for the arrays and, by default, the database; made where it is missing.
        database_url: any SQLAlchemy URL; None is SQLite at ``workspace/artiworld.db``.
        busy_timeout: seconds to wait for another process that is writing.
        storage: address of the storage of assets and releases; None is that of the environment
            variable :data:`~sessions.storage.STORAGE_VARIABLE`, else the workspace.

    Attributes:
        assets: accepted assets and releases.
        people: accounts, what they may do, and who works on what.
        project: settings of the project.

    Raises:
        StoreError: naming the file, where the workspace can't be used.
    """

    def __init__(
        self,
        workspace: Path,
        database_url: str | None = None,
        busy_timeout: float = 10.0,
        storage: str | None = None,
    ) -> None:
        self.workspace = Path(os.path.abspath(workspace))
        try:
            (self.workspace / "arrays").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(
                f"{workspace}: can't be the workspace ({error.strerror or error}); "
                "choose a folder that you may write to"
            ) from error
        self.assets = AssetStorage(
            self.workspace, storage or os.environ.get(STORAGE_VARIABLE) or None
        )
        url = database_url or sqlite_file(self.workspace / "artiworld.db")
        self._database = Database(url, busy_timeout)
        self._arrays = ArrayFiles(self.workspace / "arrays")
        self.people = People(self._database)
        self.project = Project(self._database)

    def close(self) -> None:
        """Close the database's connections."""
        self._database.close()

    def open_object(self, path: Path, sha256: str | None, name: str) -> ObjectRecord:
        """Return the object of the source ``path``, adding it if needed.

        Args:
            path: file or folder; relative to the current folder.
            sha256: digest of its content; None where it wasn't read yet.
            name: short display name.
        """
        return self.open_objects([(path, sha256, name)])[0]

    def open_objects(self, sources: Iterable[tuple[Path, str | None, str]]) -> list[ObjectRecord]:
        """Like :meth:`open_object`, for many in one transaction."""
        wanted = [(_key(path), sha256, name) for path, sha256, name in sources]
        try:
            return self._open_objects(wanted)
        except StoreError as error:
            if not isinstance(error.__cause__, exc.IntegrityError):
                raise
            return self._open_objects(wanted)  # another process has just added them

    def objects(self) -> list[ObjectRecord]:
        """Return all objects in the order of their first opening."""
        with self._database.reading() as connection:
            rows = connection.execute(select(*_COLUMNS).order_by(objects.c.id)).all()
        return [_record(row) for row in rows]

    def object(self, object_id: int) -> ObjectRecord:
        """Return one object.

        Raises:
            StoreError: where there is none with that id.
        """
        with self._database.reading() as connection:
            return _record(self._row(connection, object_id))

    def last_commands(self) -> dict[int, int]:
        """Return object id → number of its last command."""
        with self._database.reading() as connection:
            rows = connection.execute(select(objects.c.id, objects.c.seq)).all()
        return {row.id: row.seq for row in rows}

    def load(self, object_id: int) -> SessionState:
        """Return the session's state: the last intact snapshot with the commands after it."""
        with self._database.reading() as connection:
            row = self._row(connection, object_id)
            state = self._snapshot(connection, object_id, row.seq)
            tail = self._entries(connection, object_id, state.seq)
        try:
            return replay(((e.seq, e.command, Context(e.who, e.at)) for e in tail), state)
        except CommandError as error:
            raise StoreError(
                f"{self._database.name}: object {object_id} can't be replayed ({error}); "
                "its commands were changed by hand or by another version"
            ) from error

    def append(
        self,
        object_id: int,
        command: Command,
        who: str,
        expected_seq: int,
        *,
        at: str | None = None,
        role: Role = "reviewer",
        after: SessionState | None = None,
    ) -> int:
        """Store ``command``; it is durable when this returns.

        Args:
            object_id: the object.
            command: the decision.
            who: the person.
            expected_seq: number of the last command that the caller knows.
            at: time, ISO 8601, UTC; None is now.
            role: the person's role.
            after: the state with the command applied, where the caller has it.

        Returns:
            The command's number; ``expected_seq`` where it changes nothing and isn't stored.

        Raises:
            ConflictError: where ``expected_seq`` isn't the last number any more.
            CommandError: where the state doesn't allow the command.
        """
        who, at, written = clean_who(who), at or now(), to_json(command)
        if after is None:
            before = self.load(object_id)
            if before.seq != expected_seq:
                raise self._conflict(object_id, expected_seq, before.seq)
            after = apply(before, from_json(written), Context(who, at, role))
        if after.seq == expected_seq:
            return expected_seq
        assert after.seq == expected_seq + 1, "the state belongs to another command"
        line = {
            "object_id": object_id,
            "seq": after.seq,
            "at": at,
            "who": who,
            "kind": command.kind,
            "payload": _dumps(written),
        }
        blob = _compressed(after) if after.seq % SNAPSHOT_EVERY == 0 else None
        try:
            with self._database.writing() as connection:
                self._append(connection, line, summary(after, who, at), blob)
        except StoreError as error:
            if isinstance(error.__cause__, exc.IntegrityError):
                # Without a lock on writers both processes inserted; the second one is refused.
                raise self._conflict(object_id, expected_seq, expected_seq + 1) from error
            raise
        return after.seq

    def history(self, object_id: int, after: int = 0) -> list[Entry]:
        """Return the commands of an object in order, from number ``after`` + 1."""
        with self._database.reading() as connection:
            self._row(connection, object_id)
            return self._entries(connection, object_id, after)

    def removed_objects(self) -> dict[int, str]:
        """Return removed object → its stamp of :meth:`mark_removed`, the last one last."""
        return self._marks(_REMOVED)

    def mark_removed(self, object_id: int, stamp: str) -> None:
        """Leave an object out of the queue from now on; its decisions stay.

        Args:
            stamp: changes with its source.
        """
        self._mark(_REMOVED, object_id, stamp)

    def mark_restored(self, object_ids: Iterable[int]) -> None:
        """Have removed objects in the queue again."""
        self._unmark(_REMOVED, object_ids)

    def pending_acceptances(self) -> dict[int, PendingAcceptance]:
        """Return object id → its acceptance that began and has not ended."""
        found = {}
        for object_id, value in self._marks(_ACCEPTING).items():
            seq, _, text = value.partition(" ")  # early versions stored the number alone
            fields = json.loads(text) if text else {}
            fields["hold_reason"] = fields.pop("held", "")
            found[object_id] = PendingAcceptance(int(seq), **fields)
        return found

    def begin_acceptance(self, object_id: int, pending: PendingAcceptance) -> None:
        """Store that an acceptance begins, so that it outlives this server."""
        fields = {"comment": pending.comment, "override": pending.override}
        if pending.hold_reason:
            fields["held"] = pending.hold_reason
        self._mark(_ACCEPTING, object_id, f"{pending.seq} {json.dumps(fields)}")

    def end_acceptance(self, object_id: int) -> None:
        """Store that an acceptance ended, decided or refused."""
        self._unmark(_ACCEPTING, [object_id])

    def put_array(self, array: npt.NDArray[Any]) -> str:
        """Store an array, durably; returns its reference, the same for the same content."""
        return self._arrays.put(array)

    def get_array(self, ref: str) -> npt.NDArray[Any]:
        """Return the array behind ``ref``, read-only.

        Raises:
            StoreError: naming the file, where it is missing or damaged.
        """
        return self._arrays.get(ref)

    def _open_objects(self, wanted: list[tuple[str, str | None, str]]) -> list[ObjectRecord]:
        with self._database.writing() as connection:
            known = _by_path(connection, [key for key, _, _ in wanted])
            fresh = {key: (sha256, name) for key, sha256, name in wanted if key not in known}
            if fresh:
                connection.execute(
                    insert(objects), [_new(k, sha, name) for k, (sha, name) in fresh.items()]
                )
                known |= _by_path(connection, list(fresh))
            out = []
            for key, sha256, _ in wanted:
                row = known[key]
                if sha256 not in (None, row.sha256) and (row.sha256 is None or row.seq == 0):
                    # There are no decisions about the former content.
                    mine = objects.c.id == row.id
                    connection.execute(update(objects).where(mine).values(sha256=sha256))
                    row = connection.execute(select(*_COLUMNS).where(mine)).one()
                out.append(_record(row, changed=sha256 not in (None, row.sha256)))
        return out

    def _append(
        self,
        connection: Connection,
        line: dict[str, Any],
        columns: dict[str, Any],
        blob: bytes | None,
    ) -> None:
        object_id, seq = line["object_id"], line["seq"]
        current = self._row(connection, object_id).seq
        if current != seq - 1:
            raise self._conflict(object_id, seq - 1, current)
        connection.execute(insert(commands).values(line))
        self.people.decided(connection, line)
        connection.execute(update(objects).where(objects.c.id == object_id).values(columns))
        if blob is None:
            return
        connection.execute(
            insert(snapshots).values(object_id=object_id, seq=seq, format=VERSION, blob=blob)
        )
        old = (snapshots.c.object_id == object_id) & (
            snapshots.c.seq <= seq - SNAPSHOTS_KEPT * SNAPSHOT_EVERY
        )
        connection.execute(delete(snapshots).where(old))

    def _marks(self, kind: str) -> dict[int, str]:
        wanted = select(meta).where(meta.c.key.startswith(kind, autoescape=True))
        with self._database.reading() as connection:
            rows = connection.execute(wanted.order_by(meta.c.value)).all()
        # The value begins with the time, which sorts as text.
        return {int(r.key.removeprefix(kind)): r.value.partition(" ")[2] for r in rows}

    def _mark(self, kind: str, object_id: int, value: str) -> None:
        key = f"{kind}{object_id}"
        with self._database.writing() as connection:
            connection.execute(delete(meta).where(meta.c.key == key))
            connection.execute(insert(meta).values(key=key, value=f"{now()} {value}"))

    def _unmark(self, kind: str, object_ids: Iterable[int]) -> None:
        keys = [f"{kind}{i}" for i in object_ids]
        with self._database.writing() as connection:
            connection.execute(delete(meta).where(meta.c.key.in_(keys)))

    def _row(self, connection: Connection, object_id: int) -> Row[Any]:
        row = connection.execute(select(*_COLUMNS).where(objects.c.id == object_id)).one_or_none()
        if row is None:
            raise StoreError(f"{self._database.name}: there is no object {object_id}")
        return row

    def _snapshot(self, connection: Connection, object_id: int, last: int) -> SessionState:
        query = (
            select(snapshots)
            .where(snapshots.c.object_id == object_id, snapshots.c.seq <= last)
            .order_by(snapshots.c.seq.desc())
        )
        for row in connection.execute(query):
            try:
                return state_from_json(json.loads(zlib.decompress(row.blob)))
            except (StoreError, ValueError, zlib.error):
                continue  # an older snapshot, or the commands alone, give the same state
        return SessionState()

    def _entries(self, connection: Connection, object_id: int, after: int) -> list[Entry]:
        query = (
            select(commands)
            .where(commands.c.object_id == object_id, commands.c.seq > after)
            .order_by(commands.c.seq)
        )
        out: list[Entry] = []
        for row in connection.execute(query):
            where = f"{self._database.name}: object {object_id}, command {row.seq}"
            if row.seq != after + len(out) + 1:
                raise StoreError(f"{where}: a command before it is missing; restore a copy")
            try:
                command = from_json(json.loads(row.payload))
            except (ValueError, CommandError) as error:
                raise StoreError(f"{where}: can't be read ({error})") from error
            out.append(Entry(row.seq, row.at, row.who, command))
        return out

    def _conflict(self, object_id: int, expected: int, current: int) -> ConflictError:
        return ConflictError(
            f"object {object_id} was changed by another process: it is at command {current}, "
            f"not {expected}; load it again"
        )


def clean_who(who: str) -> str:
    """A person's name as it is kept."""
    return clean_text(who, NAME_LIMIT, "the person's name") or "anonymous"


def _key(path: Path) -> str:
    key = os.path.abspath(path)
    try:
        key.encode()
    except UnicodeEncodeError:
        raise StoreError(f"{key!r}: the path has characters that aren't UTF-8; rename it") from None
    return key


def _by_path(connection: Connection, keys: list[str]) -> dict[str, Row[Any]]:
    out: dict[str, Row[Any]] = {}
    for start in range(0, len(keys), 500):  # databases limit the values of one statement
        chosen = objects.c.path.in_(keys[start : start + 500])
        out |= {row.path: row for row in connection.execute(select(*_COLUMNS).where(chosen))}
    return out


def _new(key: str, sha256: str | None, name: str) -> dict[str, Any]:
    at = now()
    plain = clean_text(name[:NAME_LIMIT], NAME_LIMIT, "the object's name") or Path(key).name
    line = {"path": key, "name": plain, "sha256": sha256, "created": at}
    return line | summary(SessionState(), "", at)


def summary(state: SessionState, who: str, at: str) -> dict[str, Any]:
    """Return the fields of an object's record after a command of ``who``."""
    document = state.present
    rejected = document.review.state == "rejected"
    return {
        "seq": state.seq,
        "state": document.review.state,
        "prompts": len(document.prompts),
        "parts": len(document.parts),
        "category": document.category,
        "who": who,
        "updated": at,
        "assigned_to": (document.annotator or None) if rejected else None,
    }


def _record(row: Row[Any], changed: bool = False) -> ObjectRecord:
    values: tuple[Any, ...] = tuple(row)
    return ObjectRecord(values[0], _path(values[1]), *values[2:], changed=changed)


@lru_cache(maxsize=100_000)
def _path(key: str) -> Path:
    # Parsing ten thousand paths takes longer than reading them from the database.
    return Path(key)


def _dumps(data: Any) -> str:
    return json.dumps(data, allow_nan=False, separators=(",", ":"))


def _compressed(state: SessionState) -> bytes:
    try:
        return zlib.compress(_dumps(state_to_json(state)).encode(), 1)
    except codec.CodecError as error:
        raise CommandError(str(error)) from error
