"""The same store on a database server. Needs PostgreSQL's programs and the driver pg8000."""

import subprocess
import sys
from pathlib import Path

import pytest

from model.core.errors import CommandError, StoreError
from model.segmentation.prompts import Click
from sessions.commands import AddClick, SetCategory, Undo
from sessions.live import LiveSession
from sessions.store import ConflictError, Store
from tests.sessions.people import add_people
from tests.sessions.postgresql import free_port, postgresql

ROOT = Path(__file__).resolve().parents[2]

WRITER = """
import sys
from pathlib import Path
from model.segmentation.prompts import Click
from sessions.commands import AddClick
from sessions.live import LiveSession
from sessions.store import Store

store = Store(Path(sys.argv[1]), sys.argv[2])
live = LiveSession(store, store.open_object(Path("/scans/oven.ply"), None, "oven").id)
for i in range(15):
    live.do(AddClick(Click((float(i), 0.0, 0.0), 1)), sys.argv[3])
"""


@pytest.fixture(scope="module")
def server():
    """URL of an empty server."""
    with postgresql() as url:
        yield url


@pytest.fixture
def url(server, request):
    """URL of an empty database."""
    from sqlalchemy import create_engine, text

    name = request.node.name.replace("test_", "")[:60]
    engine = create_engine(server + "/postgres", isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(text(f'CREATE DATABASE "{name}"'))
    engine.dispose()
    return f"{server}/{name}"


def click(i: int) -> AddClick:
    return AddClick(Click((0.01 * i, 0.0, 0.0), i % 5))


def test_the_session_is_kept(url, tmp_path, monkeypatch):
    monkeypatch.setattr("sessions.store.SNAPSHOT_EVERY", 10)
    store = Store(tmp_path, url)
    object_id = store.open_object(Path("/scans/oven.ply"), None, "oven").id
    for seq in range(35):
        assert store.append(object_id, click(seq), "ann", seq) == seq + 1
    seq = store.append(object_id, SetCategory("Ofen 門"), "ann", 35)
    seq = store.append(object_id, Undo(), "ann", seq)
    with pytest.raises(CommandError):
        store.append(object_id, SetCategory("x" * 100), "ann", seq)
    with pytest.raises(ConflictError):
        store.append(object_id, click(0), "rob", 3)
    store.close()
    again = Store(tmp_path, url)
    state = again.load(object_id)
    assert len(state.present.prompts) == 35
    assert state.redo_label == "Redo: category 'Ofen 門'"
    assert [e.seq for e in again.history(object_id)] == list(range(1, 38))
    assert again.objects()[0].prompts == 35
    again.close()
    assert not (tmp_path / "artiworld.db").exists()


def test_processes_that_write_at_the_same_time_lose_nothing(url, tmp_path):
    writers = [
        subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path), url, who], cwd=ROOT)
        for who in ("ann", "rob", "eve")
    ]
    assert [w.wait(timeout=120) for w in writers] == [0, 0, 0]
    store = Store(tmp_path, url)
    (record,) = store.objects()
    history = store.history(record.id)
    assert [e.seq for e in history] == list(range(1, 46))
    assert len(store.load(record.id).present.prompts) == 45
    store.close()


def test_a_server_that_is_not_there_is_named_without_its_password(tmp_path):
    pytest.importorskip("pg8000", reason="the driver pg8000 is not installed")
    url = f"postgresql+pg8000://artiworld:secret@127.0.0.1:{free_port()}/none"
    with pytest.raises(StoreError, match=r"127\.0\.0\.1") as error:
        Store(tmp_path, url)
    assert "secret" not in str(error.value)


def test_accounts_work_and_audit(url, tmp_path):
    from sqlalchemy import create_engine, exc, text

    store = Store(tmp_path, url)
    add_people(store)
    people = store.people
    ann, bob = people.accounts.find("ann"), people.accounts.find("bob")
    paths = [Path(f"/scans/{name}.ply") for name in ("oven", "safe")]
    first, second = [r.id for r in store.open_objects((p, None, p.stem) for p in paths)]
    assert people.work.next(ann, store.objects()) == first
    assert people.work.next(bob, store.objects()) == second
    with pytest.raises(CommandError, match="ann works"):
        LiveSession(store, first).do(click(1), "bob")
    assert LiveSession(store, first).do(click(1), "ann").seq == 1
    secret = people.credentials.begin_session(ann)
    assert people.credentials.session(secret) is not None
    people.accounts.disable("ann", "mia")
    assert people.credentials.session(secret) is None
    assert people.audit.events(count=1)[0].kind == "disabled"
    store.close()
    engine = create_engine(url)
    denied = "UPDATE audit SET who='eve';DELETE FROM audit;TRUNCATE audit;DELETE FROM commands"
    for statement in denied.split(";"):
        with pytest.raises(exc.DBAPIError, match="append"), engine.begin() as connection:
            connection.execute(text(statement))
    engine.dispose()
