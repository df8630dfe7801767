"""The workspace keeps what was decided, and says in plain words what is wrong with it."""

from __future__ import annotations

import contextlib
import os
import sqlite3
import time
from pathlib import Path

import numpy as np
import pytest

from model.core.errors import CommandError, StoreError
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.database import Database, sqlite_file
from sessions.document import prompts_key
from sessions.state import SessionState
from sessions.store import ConflictError, PendingAcceptance, Store, now


def click(i: int) -> cmd.AddClick:
    return cmd.AddClick(Click((0.01 * i, 0.0, 0.0), i % 5))


def opened(store: Store, name: str = "oven") -> int:
    return store.open_object(Path(f"{name}.ply"), None, name).id


def database(store: Store) -> Path:
    return store.workspace / "artiworld.db"


def changed(store: Store, *statements: str) -> Store:
    """The store closed, changed behind its back, and opened again."""
    store.close()
    with sqlite3.connect(database(store)) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()
    return Store(store.workspace)


def test_an_object_is_opened_once(store, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = store.open_object(Path("scans/oven.ply"), None, "oven")
    assert first.path == tmp_path / "scans" / "oven.ply"
    assert (first.state, first.prompts, first.who, first.seq) == ("todo", 0, "", 0)
    again = store.open_object(tmp_path / "scans" / ".." / "scans" / "oven.ply", "a" * 64, "x")
    assert (again.id, again.name, again.sha256) == (first.id, "oven", "a" * 64)
    assert not again.changed
    assert [r.id for r in store.objects()] == [first.id]


def test_a_source_that_changed_after_annotation_is_reported(store):
    record = store.open_object(Path("oven.ply"), "a" * 64, "oven")
    untouched = store.open_object(Path("oven.ply"), "b" * 64, "oven")
    assert (untouched.sha256, untouched.changed) == ("b" * 64, False)
    store.append(record.id, click(1), "ann", 0)
    other = store.open_object(Path("oven.ply"), "c" * 64, "oven")
    assert (other.id, other.sha256, other.changed) == (record.id, "b" * 64, True)
    assert not store.open_object(Path("oven.ply"), None, "oven").changed


def test_many_objects_are_opened_and_listed_fast(store):
    sources = [(Path(f"/scans/{i}.ply"), None, f"scan {i}") for i in range(10_000)]
    start = time.perf_counter()
    records = store.open_objects(sources)
    assert store.open_objects(sources[:100]) == records[:100]
    opening = time.perf_counter() - start
    assert [r.name for r in records[:2]] == ["scan 0", "scan 1"]
    start = time.perf_counter()
    listed = store.objects()
    listing = time.perf_counter() - start
    assert listed == records
    assert listing < 2, f"{listing:.2f} s"
    assert opening < 20, f"{opening:.2f} s"


def test_appended_commands_are_the_state_and_the_history(store):
    object_id = opened(store)
    given = [click(1), click(2), cmd.NamePart(2, "door"), cmd.Undo(), cmd.SetCategory("oven")]
    for seq, command in enumerate(given):
        assert store.append(object_id, command, "ann", seq) == seq + 1
    state = store.load(object_id)
    assert len(state.present.prompts) == 2
    assert state.present.part_names == {}
    history = store.history(object_id)
    assert [e.command for e in history] == given
    assert [e.seq for e in history] == [1, 2, 3, 4, 5]
    assert {e.who for e in history} == {"ann"}
    assert [e.at for e in history] == sorted(e.at for e in history)
    assert [e.kind for e in store.history(object_id, after=3)] == ["undo", "set_category"]
    record = store.object(object_id)
    assert (record.prompts, record.parts, record.category) == (2, 3, "oven")
    assert (record.state, record.who, record.seq) == ("in_progress", "ann", 5)


def test_a_refused_command_leaves_nothing(store):
    object_id = opened(store)
    with pytest.raises(CommandError, match="no part 9"):
        store.append(object_id, cmd.NamePart(9, "x"), "ann", 0)
    assert store.append(object_id, cmd.NamePart(0, None), "ann", 0) == 0, "it changes nothing"
    assert store.history(object_id) == []
    assert store.append(object_id, click(1), "ann", 0) == 1


def test_a_conflict_is_refused_without_a_trace(store):
    object_id = opened(store)
    store.append(object_id, click(1), "ann", 0)
    with pytest.raises(ConflictError, match="at command 1, not 0"):
        store.append(object_id, click(2), "rob", 0)
    with pytest.raises(ConflictError):
        store.append(object_id, click(2), "rob", 0, after=SessionState(seq=1))
    with pytest.raises(ConflictError, match="at command 1, not 7"):
        store.append(object_id, click(2), "rob", 7, after=SessionState(seq=8))
    assert len(store.history(object_id)) == 1


def test_an_unknown_object_is_named(store):
    for use in (store.load, store.object, store.history):
        with pytest.raises(StoreError, match="no object 77"):
            use(77)


def test_a_rejected_object_waits_for_its_annotator(store, prediction):
    object_id = opened(store)
    seq = store.append(object_id, click(1), "ann", 0)
    seq = store.append(object_id, cmd.Reject("parts", "the lid is missing"), "rob", seq)
    record = store.object(object_id)
    assert (record.state, record.assigned_to, record.who) == ("rejected", "ann", "rob")
    store.append(object_id, click(2), "ann", seq)
    assert store.object(object_id).assigned_to is None


def test_snapshots_shorten_the_replay_and_only_two_are_kept(store, monkeypatch):
    every = 10
    monkeypatch.setattr("sessions.store.SNAPSHOT_EVERY", every)
    object_id = opened(store)
    for seq in range(4 * every + 7):
        store.append(object_id, click(seq), "ann", seq)
    expected = store.load(object_id)
    store = changed(store, "SELECT 1")
    with sqlite3.connect(database(store)) as connection:
        kept = [row[0] for row in connection.execute("SELECT seq FROM snapshots ORDER BY seq")]
    connection.close()
    assert kept == [3 * every, 4 * every]
    assert store.load(object_id) == expected
    # Damaged and foreign snapshots are passed over, down to none.
    store = changed(store, f"UPDATE snapshots SET blob = x'00' WHERE seq = {kept[1]}")
    assert store.load(object_id) == expected
    store = changed(store, "UPDATE snapshots SET blob = x'00'")
    assert store.load(object_id) == expected
    store = changed(store, "DELETE FROM snapshots")
    assert store.load(object_id) == expected
    store.close()


def test_labels_and_predictions_come_back(store, prediction, labels_ref):
    object_id = opened(store)
    for seq, part in enumerate((1, 2, 3, 4)):
        store.append(object_id, cmd.AddClick(Click((0, 0, 0), part)), "ann", seq)
    key = prompts_key(store.load(object_id).present)
    answer = cmd.RecordSegmentation(key, labels_ref, "walk", 0.1, dict.fromkeys(range(5), 10))
    store.append(object_id, answer, "ann", 4)
    store.append(object_id, cmd.RecordPrediction(prediction, labels_ref), "ann", 5)
    document = store.load(object_id).present
    assert document.tree == prediction.tree
    assert document.prediction == prediction
    assert document.segmentation is not None
    labels = store.get_array(document.segmentation.labels)
    np.testing.assert_array_equal(np.bincount(labels), [10] * 5)
    assert store.object(object_id).state == "predicted"


def test_commands_can_not_be_changed_or_deleted(store):
    object_id = opened(store)
    store.append(object_id, click(1), "ann", 0)
    for statement in ("UPDATE commands SET who = 'x'", "DELETE FROM commands"):
        with pytest.raises(sqlite3.IntegrityError, match="only ever appended"):
            changed(store, statement)
    assert len(store.history(object_id)) == 1


def test_commits_are_synced_in_wal_mode(store):
    path = sqlite_file(database(store))
    with contextlib.closing(Database(path)) as other, other.reading() as connection:
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar() == 2


NO_TRIGGER = "DROP TRIGGER commands_no_update"


@pytest.mark.parametrize(
    ("statements", "words"),
    [
        (["UPDATE commands SET payload = '{oops' WHERE seq = 2"], "command 2: can't be read"),
        (
            ["""UPDATE commands SET payload = '{"kind": "teleport"}' WHERE seq = 2"""],
            "command 2.*'teleport'.*newer version",
        ),
        (["UPDATE commands SET seq = 9 WHERE seq = 2"], "command 3: a command before it is miss"),
        (
            ["""UPDATE commands SET payload = '{"kind": "redo"}' WHERE seq = 2"""],
            "can't be replayed.*nothing to redo",
        ),
    ],
)
def test_damaged_commands_are_named(store, statements, words):
    object_id = opened(store)
    for seq in range(3):
        store.append(object_id, click(seq), "ann", seq)
    store = changed(store, NO_TRIGGER, *statements)
    with pytest.raises(StoreError, match=words) as error:
        store.load(object_id)
    assert str(database(store)) in str(error.value)
    store.close()


def test_a_newer_format_is_refused_untouched(store):
    with pytest.raises(StoreError, match=r"has format 9999, .* up to 0004; use the newer version"):
        changed(store, "UPDATE alembic_version SET version_num = '9999'")


@pytest.mark.parametrize(
    "content", [b"no database at all" * 100, b"SQLite format 3\0" + b"x" * 5000]
)
def test_a_file_that_is_no_database_is_named_and_left_alone(tmp_path, content):
    path = tmp_path / "artiworld.db"
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"artiworld\.db: .*(no database|damaged)"):
        Store(tmp_path)
    assert path.read_bytes() == content


def test_a_damaged_database_is_named(store):
    object_id = opened(store)
    for seq in range(60):
        store.append(object_id, click(seq), "ann", seq)
    store.close()
    path = database(store)
    data = bytearray(path.read_bytes())
    data[4096 * 2 :] = b"\xa5" * (len(data) - 4096 * 2)
    path.write_bytes(bytes(data))
    with pytest.raises(StoreError, match=r"artiworld\.db: is damaged"):
        Store(store.workspace).load(object_id)


def test_the_database_of_another_program_is_left_alone(tmp_path):
    with sqlite3.connect(tmp_path / "artiworld.db") as connection:
        connection.execute("CREATE TABLE recipes (title TEXT)")
    connection.close()
    with pytest.raises(StoreError, match=r"database of another program.*recipes"):
        Store(tmp_path)


def test_a_workspace_that_can_not_be_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="file: can't be the workspace"):
        Store(tmp_path / "file")
    with pytest.raises(StoreError, match="can't be the workspace"):
        Store(Path("/proc/artiworld"))


def test_a_read_only_workspace_is_named(store):
    object_id = opened(store)
    store.close()
    for path in [*store.workspace.glob("*"), store.workspace]:
        path.chmod(0o555)
    try:
        if os.access(store.workspace, os.W_OK):
            pytest.skip("the superuser may write everywhere")
        with pytest.raises(StoreError, match="can't be"):
            Store(store.workspace).append(object_id, click(1), "ann", 0)
    finally:
        store.workspace.chmod(0o755)


def test_a_database_that_refuses_writing_is_named(store):
    object_id = opened(store)
    reader = Store(store.workspace, f"sqlite:///file:{database(store)}?mode=ro&uri=true")
    with pytest.raises(StoreError, match="can't be written; you need the right"):
        reader.append(object_id, click(1), "ann", 0)
    assert reader.history(object_id) == []
    reader.close()


def test_a_locked_workspace_is_named(store):
    object_id = opened(store)
    impatient = Store(store.workspace, busy_timeout=0.1)
    blocker = sqlite3.connect(database(store), isolation_level=None)
    blocker.execute("BEGIN IMMEDIATE")
    try:
        with pytest.raises(StoreError, match="another program is writing"):
            impatient.append(object_id, click(1), "ann", 0)
        assert impatient.load(object_id) == SessionState(), "reading goes on"
    finally:
        blocker.execute("ROLLBACK")
        blocker.close()
    assert impatient.append(object_id, click(1), "ann", 0) == 1
    impatient.close()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("nonsense", "SQLAlchemy URL"),
        ("nosuchdb://host/name", "no driver for nosuchdb"),
        ("sqlite://", "in memory keeps nothing"),
        ("sqlite:////nowhere/at/all.db", "can't be opened; its folder must exist"),
    ],
)
def test_a_database_url_that_can_not_work_is_named(tmp_path, url, words):
    with pytest.raises(StoreError, match=words):
        Store(tmp_path, url)


def test_a_password_is_never_shown(tmp_path):
    with pytest.raises(StoreError) as error:
        Store(tmp_path, "nosuchdb://me:secret@host/name")
    assert "secret" not in str(error.value)


def test_another_file_can_be_the_database(tmp_path):
    url = f"sqlite:///{tmp_path / 'elsewhere.db'}"
    store = Store(tmp_path / "workspace", url)
    store.append(opened(store), click(1), "ann", 0)
    store.close()
    assert not (tmp_path / "workspace" / "artiworld.db").exists()
    again = Store(tmp_path / "workspace", url)
    assert again.objects()[0].prompts == 1
    again.close()


def test_awkward_names_and_paths_are_kept_or_refused(store, tmp_path):
    record = store.open_object(tmp_path / "Öfen 門%20'; DROP TABLE objects.ply", None, "a\x00b\n")
    assert store.object(record.id).path.name == "Öfen 門%20'; DROP TABLE objects.ply"
    assert record.name == "ab"
    assert store.open_object(tmp_path / "x.ply", None, "  ").name == "x.ply"
    assert len(store.open_object(tmp_path / "y.ply", None, "n" * 500).name) == 80
    with pytest.raises(StoreError, match="UTF-8"):
        store.open_object(Path(os.fsdecode(b"/scans/\xff.ply")), None, "x")
    assert store.append(record.id, click(1), " \x07 ", 0) == 1
    assert store.history(record.id)[0].who == "anonymous"


def test_a_workspace_in_an_awkward_folder(tmp_path):
    folder = tmp_path / "100% @ home? #1: ünï"
    store = Store(folder)
    store.append(opened(store), click(1), "ann", 0)
    store.close()
    assert (folder / "artiworld.db").is_file()
    again = Store(folder)
    assert again.objects()[0].prompts == 1
    again.close()


def test_what_was_said_for_an_acceptance_that_was_begun_is_kept(store):
    known = opened(store)
    said = PendingAcceptance(0, "two\nlines, 門", "it gives way")
    store.begin_acceptance(known, said)
    assert store.pending_acceptances() == {known: said}
    # Older versions kept the number of the command alone.
    old = f"UPDATE meta SET value = '{now()} 7' WHERE key LIKE 'accepting %'"
    again = changed(store, old)
    assert again.pending_acceptances() == {known: PendingAcceptance(7)}
    again.end_acceptance(known)
    assert not again.pending_acceptances()
    again.close()
