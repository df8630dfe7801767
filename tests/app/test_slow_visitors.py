"""Visitors who are slow or many: they keep nobody else out, nor waiting."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
import trimesh

from app.server import network, workers
from app.server.api import guard
from app.server.job import OutOfTimeError
from app.server.login import GUESSES
from app.server.network import Places
from app.server.server import Server
from app.server.workers import Workers
from model.core.errors import ConfigurationError
from sessions import accounts
from tests.app import job_functions as functions
from tests.app.api_server import Browser, team_server
from tests.builders import wait_until

LOGIN = (
    b"POST /api/v1/login HTTP/1.1\r\nHost: localhost\r\n"
    b"X-ArtiWorld: 1\r\nContent-Length: 90\r\n\r\n"
)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("visited")
    trimesh.creation.box((1, 1, 1)).export(folder / "box.ply")
    with team_server(folder / "w", folder / "box.ply") as made:
        yield made


def test_a_stranger_has_little_time_however_steadily_it_sends(server, monkeypatch) -> None:
    monkeypatch.setattr(guard, "STRANGER_SECONDS", 1.0)
    begun = time.monotonic()
    with socket.create_connection(("127.0.0.1", server.viser.get_port()), 30) as stranger:
        stranger.sendall(LOGIN)
        stranger.settimeout(0.2)
        answer = b""
        while not answer and time.monotonic() - begun < 20:
            stranger.sendall(b"{")
            with suppress(TimeoutError):
                answer = stranger.recv(1000)
    assert answer.startswith(b"HTTP/1.1 408")


def test_a_person_who_sends_too_slowly_is_cut_off(server, monkeypatch) -> None:
    monkeypatch.setattr(guard, "BODY_SECONDS", 1.0)
    browser = Browser(server)
    browser.log_in("ann")
    head = LOGIN.replace(b"login", b"objects?name=a.ply").replace(b"90", b"9000000")
    head = head[:-2] + f"Cookie: {browser.cookie}\r\n\r\n".encode()
    with socket.create_connection(("127.0.0.1", browser.port), 30) as slow:
        slow.sendall(head + b"x" * 10)
        assert slow.recv(1000).startswith(b"HTTP/1.1 408")


class Transport:
    """Stands in for a connection."""

    def __init__(self, address: str) -> None:
        self.address, self.closed = address, False

    def get_extra_info(self, _: str) -> tuple[str, int]:
        return self.address, 1

    def is_closing(self) -> bool:
        return self.closed

    def abort(self) -> None:
        self.closed = True


def test_an_address_has_half_of_the_places_and_people_keep_theirs(monkeypatch) -> None:
    monkeypatch.setattr(network, "MAX_SOCKETS", 8)
    places = Places(("10.1.0.0/16",))
    mine = [Transport("192.0.2.1") for _ in range(6)]
    assert all(places.take(t, lambda: False) for t in mine)
    assert [t.closed for t in mine] == [True] * 2 + [False] * 4
    people = [Transport("10.1.0.9") for _ in range(4)]
    assert all(places.take(t, lambda: True) for t in people)
    late = Transport("192.0.2.2")
    assert places.take(late, lambda: False) and mine[2].closed, "the oldest stranger's"
    for stranger in mine[3:]:
        assert places.take(Transport("10.1.0.9"), lambda: True) and stranger.closed
    assert places.take(Transport("10.1.0.9"), lambda: True) and late.closed
    assert not places.take(Transport("192.0.2.3"), lambda: False), "only people are left"
    people[0].abort()
    assert places.take(Transport("192.0.2.3"), lambda: False)


def test_people_come_in_while_strangers_hold_the_port(server, monkeypatch) -> None:
    monkeypatch.setattr(network, "MAX_SOCKETS", 40)
    browser = Browser(server)
    browser.log_in("ann")
    with ExitStack() as stack:
        for _ in range(60):
            one = stack.enter_context(socket.create_connection(("127.0.0.1", browser.port), 30))
            one.sendall(LOGIN)
        for _ in range(5):
            status, who = browser.api("GET", "/me")
            assert (status, who["name"]) == (200, "ann")


def test_wrong_passwords_at_once_wait_for_each_other_alone(server, monkeypatch) -> None:
    held, hashing = threading.Event(), threading.Semaphore(0)

    class Slow:
        def verify(self, *_: object) -> bool:
            hashing.release()
            held.wait(30)
            return False

        def hash(self, _: object) -> str:
            return "x"

    monkeypatch.setattr(accounts, "hasher", Slow())
    browser = Browser(server)
    with ThreadPoolExecutor(40) as pool:
        tries = [pool.submit(Browser(server).log_in, f"n{k}", "wrong") for k in range(40)]
        wait_until(lambda: sum(t.done() for t in tries) >= 32, "the refused ones", 30)
        assert {t.result() for t in tries if t.done()} == {429}
        assert browser.api("GET", "/me")[0] == 401, "others are answered meanwhile"
        held.set()
        assert sorted(t.result() for t in tries)[:8] == [401] * 8


def test_what_waits_counts_as_a_guess(server, monkeypatch) -> None:
    checked: list[str] = []

    def log_in() -> None:
        with pytest.raises(ConfigurationError, match=r"Name or password|Too many"):
            server.entrance.log_in(f"n{len(checked)}", "wrong", "192.0.2.9")

    def check(name: str, _: str) -> None:
        checked.append(name)
        log_in()  # while this one waits

    monkeypatch.setattr(server.app_state.store.people.accounts, "check", check)
    log_in()
    assert len(checked) == GUESSES


@pytest.fixture(scope="module")
def readers() -> Iterator[Workers]:
    made = Workers()
    yield made
    made.close()


def test_a_small_file_comes_before_anothers_slow_ones(
    readers: Workers, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(workers, "QUICK_SECONDS", 2.0)
    slow = [readers.read(time.sleep, 3600, who="ann") for _ in range(6)]
    assert readers.read(os.fspath, tmp_path / "small", who="bob").result(120)
    assert not any(job.done for job in slow)
    for job in slow:
        job.cancel()


def test_who_works_long_begins_again_behind_those_that_wait(
    readers: Workers, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(workers, "SMALL_BYTES", 100)
    monkeypatch.setattr(workers, "FIRST_WORK", (0.3, 0.01))
    wait_until(lambda: not any(r.busy for r in readers.readers), "nobody reads", 60)
    worst = readers.read(functions.held_at_first, tmp_path / "worst", 5, who="ann")
    wait_until((tmp_path / "worst").exists, "it has begun", 60)
    (tmp_path / "large").write_bytes(b"x" * 101)
    large = [readers.read(os.fspath, tmp_path / "large", who="bob") for _ in range(3)]
    assert all(job.result(30) for job in large)
    assert worst.result(60) == 5, "it began again"


def test_reading_without_others_goes_on_until_its_last_budget(
    readers: Workers, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(workers, "FIRST_WORK", (0.1, 0.0))
    monkeypatch.setattr(workers, "MOST_WORK", (0.8, 100.0))
    (tmp_path / "large").write_bytes(b"x" * 60_000)
    readers.read(time.sleep, 1.0).result(60)
    with pytest.raises(OutOfTimeError, match=r"sleep took more than 0\.8 s"):
        readers.read(time.sleep, 3600).result(60)
    assert readers.read(functions.append, tmp_path / "large", "read", 3.0).result(60)


def test_a_large_file_leaves_the_second_reader_free(
    readers: Workers, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(workers, "SMALL_BYTES", 100)
    large = tmp_path / "large"
    large.write_bytes(b"x" * 101)
    held = readers.reading.submit(time.sleep, 3600)
    wait_until(lambda: held.state == "running", "it is held", 60)
    job = readers.read(os.fspath, large)
    assert readers.read(os.fspath, tmp_path / "small").result(120)
    assert job.state == "queued"
    held.cancel()
    assert job.result(120) == str(large)
