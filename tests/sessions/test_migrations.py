"""What older versions wrote opens with this one, whole."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection

from model.core.errors import StoreError
from model.segmentation.prompts import Click
from sessions import database
from sessions.commands import AddClick, Reopen, Undo
from sessions.document import PartInfo, RegionRef
from sessions.state import Context, replay
from sessions.store import Store

DATA = Path(__file__).parent / "data"
REF = "ab" * 32


@contextmanager
def reading(workspace: Path) -> Iterator[Connection]:
    """The database of a workspace, beside the store."""
    opened = database.Database(database.sqlite_file(workspace / "artiworld.db"))
    with opened.reading() as connection:
        yield connection
    opened.close()


def written_by(version: int, workspace: Path) -> Path:
    """A workspace whose database that version wrote."""
    workspace.mkdir(exist_ok=True)
    with sqlite3.connect(workspace / "artiworld.db") as connection:
        connection.executescript((DATA / f"format_{version}.sql").read_text())
    connection.close()
    return workspace


def test_every_format_has_a_database_to_open():
    dumps = {int(p.stem.removeprefix("format_")) for p in DATA.glob("format_*.sql")}
    assert dumps == {int(f) for f in database.known_formats()}


@pytest.mark.parametrize("snapshots", [True, False], ids=["snapshots", "commands alone"])
def test_format_1_opens_whole(tmp_path, snapshots):
    workspace = written_by(1, tmp_path)
    if not snapshots:
        with sqlite3.connect(workspace / "artiworld.db") as connection:
            connection.execute("DELETE FROM snapshots")
        connection.close()
    store = Store(workspace)
    oven, laptop = store.objects()
    assert (str(oven.path), oven.sha256, oven.state) == ("/scans/oven.ply", "e" * 64, "accepted")
    assert (laptop.name, laptop.state) == ("laptop", "todo")
    state = store.load(oven.id)
    document = state.present
    assert document.prompts == (
        Click((0.1, 0.2, 0.3), 1, True, 7),
        RegionRef(2, REF, True, 12, "lasso"),
    )
    assert document.parts == (PartInfo(0), PartInfo(1, "door"), PartInfo(2))
    assert (document.category, document.up_axis, document.unit_scale) == ("oven", "y", 0.001)
    assert document.segmentation_current, "the key of the prompts is part of the format"
    assert document.segmentation is not None
    assert document.segmentation.counts == {-1: 1, 0: 5, 1: 6, 2: 7}
    assert document.tree is not None
    assert document.tree.joint_of["link_1"].upper == 1.0
    assert document.prediction is not None
    assert document.prediction.tree is not None
    assert document.prediction.tree.joint_of["link_1"].upper == 1.5
    assert document.locked == {"link_1"}
    assert document.review.problems == ("touches at 0.2 rad",)
    assert document.saved is not None
    assert document.saved.folder == "out/oven"
    assert (state.seq, len(state.past), document.edits) == (21, 17, 17)
    history = store.history(oven.id)
    assert replay((e.seq, e.command, Context(e.who, e.at)) for e in history) == state
    # It can be worked on.
    seq = store.append(oven.id, Reopen(), "eve", state.seq)
    seq = store.append(oven.id, AddClick(Click((0.0, 0.0, 0.0), 1)), "eve", seq)
    store.append(oven.id, Undo(), "eve", seq)
    assert store.object(oven.id).state == "in_progress"
    store.close()


def test_names_of_format_1_become_accounts_that_can_be_claimed(tmp_path):
    store = Store(written_by(1, tmp_path))
    accounts = store.people.accounts
    assert [(a.name, a.role, a.status) for a in accounts.all()] == [
        ("ann", "annotator", "unclaimed"),
        ("rob", "annotator", "unclaimed"),
    ], "the segmenter is no person"
    assert not accounts.in_use(), "nobody has to log in before somebody is invited"
    store.append(1, Reopen(), "anybody", 21)
    assert accounts.check("ann", "") is None, "an unclaimed account has no password"
    ann = accounts.claim(accounts.invite("ANN", "reviewer"), "correct horse battery")
    assert (ann.name, ann.role, ann.status) == ("ann", "reviewer", "active")
    assert accounts.check("ann", "correct horse battery") == ann
    assert {e.who for e in store.history(1)} >= {"ann", "rob"}, "decisions keep their names"
    store.close()


def test_format_2_opens_whole(tmp_path):
    store = Store(written_by(2, tmp_path))
    people = store.people
    assert [(a.name, a.role, a.status) for a in people.accounts.all()] == [
        ("ann", "annotator", "active"),
        ("boss", "manager", "active"),
        ("rob", "annotator", "unclaimed"),
    ]
    assert people.accounts.check("boss", "a long password") == people.accounts.find("boss")
    assert [(t.account, t.label, t.scopes) for t in people.credentials.tokens()] == [
        ("boss", "nightly", ("read",))
    ]
    assert people.work.assigned() == {2: "ann"}
    kinds = [e.kind for e in people.audit.events()][::-1]
    assert kinds == ["account_added", "account_added", "token_made", "assigned"]
    assert (store.object(1).state, len(store.history(1))) == ("accepted", 21)
    store.close()


def test_the_migrations_end_where_the_tables_are(tmp_path):
    Store(tmp_path).close()
    with reading(tmp_path) as connection:
        context = MigrationContext.configure(connection)
        assert compare_metadata(context, database.metadata) == []
        assert context.get_current_revision() == database.FORMAT


def test_the_newest_migration_is_the_format():
    config = Config()
    config.set_main_option("script_location", str(Path(database.__file__).parent / "migrations"))
    scripts = ScriptDirectory.from_config(config)
    assert scripts.get_heads() == [database.FORMAT]
    assert tuple(sorted(s.revision for s in scripts.walk_revisions())) == database.known_formats()


def test_opening_again_changes_no_byte(tmp_path):
    workspace = written_by(1, tmp_path)
    Store(workspace).close()
    before = (workspace / "artiworld.db").read_bytes()
    store = Store(workspace)
    store.load(1)
    store.close()
    assert (workspace / "artiworld.db").read_bytes() == before


def test_a_migration_that_fails_leaves_the_database_as_it_was(tmp_path, monkeypatch):
    def fail(config, _):
        connection = config.attributes["connection"]
        connection.exec_driver_sql("CREATE TABLE half_done (x INTEGER)")
        raise sqlite3.OperationalError("disk I/O error")

    monkeypatch.setattr("alembic.command.upgrade", fail)
    with pytest.raises(StoreError, match="the disk reports an error"):
        Store(tmp_path)
    monkeypatch.undo()
    Store(tmp_path).close()
    with reading(tmp_path) as connection:
        tables = connection.exec_driver_sql("SELECT name FROM sqlite_master").scalars().all()
    assert "half_done" not in tables
    assert "commands" in tables
