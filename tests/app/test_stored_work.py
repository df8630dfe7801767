"""Loops over stored work: one item that raises is set aside, and the others go on."""

from __future__ import annotations

import shutil
import socket
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import trimesh

from app.server import app_state, object_queue
from app.server.api import project
from app.server.api.project import WebhookSender
from app.server.app_state import AppState
from app.server.server import Server
from model.core import progress
from model.core.errors import InputFileError
from model.core.progress import Cancelled, StoredWork, each
from sessions import database
from sessions.commands import Reject, SetCategory
from sessions.live import LiveSession
from sessions.releases import accepted_assets
from sessions.store import PendingAcceptance, Store
from tests.accepted import accept, cupboard
from tests.app.api_server import team_server, token_client
from tests.app.test_attacks import Receiver
from tests.builders import wait_until
from tests.sessions.people import add_people


def poison(*_: Any, **__: Any) -> Any:
    raise ZeroDivisionError("poison")


def poisoned(real: Any, wrong: Any) -> Any:
    """``real``, which raises where its first argument is ``wrong``."""
    return lambda first, *rest: poison() if first == wrong else real(first, *rest)


def test_an_item_that_fails_is_set_aside_and_tried_again_later() -> None:
    work, seen = StoredWork(), list[int]()

    def step(item: int) -> None:
        seen.append(item)
        if item == 1 and len(seen) < 12:
            poison()

    for _ in range(5):
        work.each("loop", range(3), step)
    assert seen == [0, 1, 2] * 3 + [0, 2] * 2
    assert work.aside["loop", 1][1] == "ZeroDivisionError: poison"
    work.aside.expire(time.monotonic() + progress.ASIDE_SECONDS)
    work.each("loop", range(3), step)
    assert seen[-3:] == [0, 1, 2] and not work.aside
    with pytest.raises(Cancelled):
        each([1], lambda _: (_ for _ in ()).throw(Cancelled), poison)


@pytest.fixture
def hooked(tmp_path: Path, monkeypatch) -> Iterator[tuple[Store, Receiver]]:
    """A webhook that can't be sent to, one that answers too slowly, and a sound one."""
    monkeypatch.setattr(project, "SECONDS", 1.0)
    monkeypatch.setattr(project, "PERIOD", 0.05)
    store, receiver = Store(tmp_path), Receiver()
    add_people(store)
    with socket.create_server(("127.0.0.1", 0)) as slow:
        threading.Thread(target=drip, args=(slow,), daemon=True).start()
        for address in (
            f"http://localhost:{receiver.http.server_port}/h\u00f6\u0442\u2028 ok\ud83d\ude00",
            f"http://localhost:{slow.getsockname()[1]}/",
            f"http://localhost:{receiver.http.server_port}/sound",
        ):
            text = address.encode("utf-16", "surrogatepass").decode("utf-16")
            mia = store.people.accounts.find("mia")
            store.people.webhooks.add(mia, text, ["object.rejected"], "mia")
        live = LiveSession(store, store.open_object(Path("/scans/oven.ply"), None, "oven").id)
        live.do(Reject("axis"), "rob")
        yield store, receiver
    receiver.http.shutdown()
    receiver.http.server_close()
    store.close()


def drip(slow: socket.socket) -> None:
    """Answer a byte every 0.2 s: each wait is short, all together never end."""
    while True:
        try:
            connection = slow.accept()[0]
        except OSError:
            return
        pause = threading.Event()
        with connection:
            try:
                while not pause.wait(0.2):
                    connection.sendall(b"H")
            except OSError:
                pass


def test_a_poisoned_and_a_slow_webhook_hold_no_other_up(hooked, monkeypatch) -> None:
    store, receiver = hooked
    hooks = store.people.webhooks
    real = project.check_url
    monkeypatch.setattr(
        project, "check_url", lambda url, allowed: poison() if "ok" in url else real(url, allowed)
    )
    sender = WebhookSender(hooks, allowed=lambda _: True)
    try:
        wait_until(lambda: hooks.all()[2].waiting == 0, "the sound one", 10)
        wait_until(lambda: all(h.problem for h in hooks.all()[:2]), "the others", 10)
    finally:
        sender.close()
    assert len(receiver.heard) == 1
    assert hooks.all()[0].problem == "poison" and "more than 1 s" in hooks.all()[1].problem
    delivery = hooks.claim()
    assert delivery is None, "its tries are counted, and it waits"


def test_letters_outside_ascii_are_sent(hooked) -> None:
    store, receiver = hooked
    delivery = store.people.webhooks.claim()
    project.send(store.people.webhooks, delivery, lambda _: True)
    assert len(receiver.heard) == 1 and store.people.webhooks.all()[0].waiting == 0


def test_after_its_last_try_a_message_is_set_aside_in_sight(hooked) -> None:
    store, _ = hooked
    hooks = store.people.webhooks
    while (delivery := hooks.claim()) is not None:
        hooks.failed(type(delivery)(**(vars(delivery) | {"attempts": 1})), "no answer")
    with closing(sqlite3.connect(store.workspace / "artiworld.db")) as database, database:
        database.execute("UPDATE deliveries SET due = '', attempts = 7")
    delivery = hooks.claim()
    hooks.failed(delivery, "gone")
    seen = next(h for h in hooks.all() if h.id == delivery.webhook)
    assert (seen.waiting, seen.failed, seen.problem) == (0, 1, "gone")
    assert hooks.claim().webhook != delivery.webhook


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("stored")
    for name in "abc":
        trimesh.creation.box((1, 1, 1 + ord(name))).export(folder / f"{name}.ply")
    with team_server(folder / "w", *(folder / f"{n}.ply" for n in "abc")) as server:
        yield server


@pytest.fixture
def state(server: Server) -> AppState:
    return server.app_state


def test_bulk_work_goes_on(state: AppState, monkeypatch) -> None:
    said: list[tuple[str, ...]] = []
    monkeypatch.setattr(state.hub, "session", poisoned(state.hub.session, 1))
    state.bulk.set_category([1, 2, 3], "Box", "ann", lambda *note: said.append(note))
    wait_until(lambda: said, "the end", 20)
    assert said[0][1] == "2 of 3 done. 1: failed; see the server's log"


def test_presence_and_sync_go_on_and_managers_see_what_fails(
    server: Server, state: AppState, monkeypatch
) -> None:
    account = state.store.people.accounts.find("ann")
    state.presence.enter("one tab", 2, account)
    state.presence.enter("other tab", 3, account)
    entered: list[int] = []
    enter = poisoned(lambda i, _: entered.append(i), 2)
    monkeypatch.setattr(state.store.people.work, "enter", enter)
    monkeypatch.setattr(app_state, "HEARTBEAT_SECONDS", -1.0)
    other = Store(state.workspace)
    sessions = [state.session(i) for i in (1, 2, 3)]
    LiveSession(other, 3).do(SetCategory("Crate"), "ann")
    monkeypatch.setattr(LiveSession, "refresh", poisoned(LiveSession.refresh, sessions[0]))
    monkeypatch.setattr(state.store, "object", poisoned(state.store.object, 1))
    behind = {i: 99 if i == 1 else state.store.load(i).seq for i in (1, 2, 3)}
    monkeypatch.setattr(state.store, "last_commands", lambda: behind)
    for _ in range(progress.MOST_TRIES):
        state.sync_remote()
    assert sessions[2].document.category == "Crate" and 3 in entered
    monkeypatch.undo()
    other.close()
    seen = token_client(server, "mia", "manage").call("GET", "/set-aside")
    assert {(row["work"], row["error"]) for row in seen} == {
        (work, "ZeroDivisionError: poison") for work in ("presence", "commands of others", "queue")
    }


def test_lists_and_pictures_go_on(server: Server, state: AppState, monkeypatch) -> None:
    state.store.append(2, SetCategory("Box"), "ann", state.store.object(2).seq)
    state.queue.refresh(2)
    monkeypatch.setattr(state.store, "load", poisoned(state.store.load, 2))
    records = state.queue.records()
    assert state.review_order.confidence(records[1]) == 0.5
    assert len(state.gallery.rows({})["rows"]) == 3
    assert state.gallery.thumbnail(2) is None
    wait_until(lambda: state.gallery.thumbnail(3), "another's picture")
    assert state.gallery.thumbnail(2) is None


def test_a_file_that_raises_is_unreadable_and_the_others_are_queued(
    state: AppState, tmp_path: Path, monkeypatch
) -> None:
    files = [tmp_path / f"{n}.ply" for n in "xyz"]
    for path in files:
        trimesh.creation.box().export(path)
    monkeypatch.setattr(object_queue, "refusal", poisoned(object_queue.refusal, files[1]))
    ids = state.queue.add(files)
    assert len(ids) == 3 and state.queue.unreadable & {*ids} == {ids[1]}


def test_a_server_starts_beside_an_acceptance_that_cannot_be_resumed(
    tmp_path: Path, monkeypatch
) -> None:
    store = Store(tmp_path / "w")
    trimesh.creation.box().export(tmp_path / "a.ply")
    id = store.open_object(tmp_path / "a.ply", None, "a").id
    store.begin_acceptance(id, PendingAcceptance(0))
    store.close()
    monkeypatch.setattr(LiveSession, "settle", poison)
    with team_server(tmp_path / "w", tmp_path / "a.ply") as server:
        assert id in server.app_state.acceptances


def test_learning_goes_on_without_what_is_gone(tmp_path: Path) -> None:
    store = Store(tmp_path / "w")
    for name in ("one", "two", "three"):
        accept(store, tmp_path / f"{name}.ply", cupboard(name))
    found = accepted_assets(store)
    shutil.rmtree(found[0].folder)
    with pytest.raises(InputFileError, match="isn't there"):
        accepted_assets(store)
    broken: list[str] = []
    assert len(accepted_assets(store, broken=broken)) == 2 and broken == [found[0].name]
    store.close()


def test_a_clock_that_goes_back_changes_no_order(tmp_path: Path, monkeypatch) -> None:
    store = Store(tmp_path)
    add_people(store)
    live = LiveSession(store, store.open_object(Path("/scans/oven.ply"), None, "oven").id)
    live.do(SetCategory("Box"), "ann")
    monkeypatch.setattr(database, "now", lambda seconds=0.0: "2001-02-03T04:05:06.000000Z")
    monkeypatch.setattr("sessions.live.now", database.now)
    live.do(SetCategory("Crate"), "ann")
    live.do(Reject("axis"), "rob")
    assert live.document.review.at.startswith("2001")
    assert store.load(live.object_id) == live.state
    store.close()
