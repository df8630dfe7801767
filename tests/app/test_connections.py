"""Attacks with connections: half a header each, a thousand of them, and no token."""

from __future__ import annotations

import logging
import socket
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from app.server import guard, network
from app.server.network import OncePerMinute, free_port
from tests.builders import wait_until

HALF = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Slow: "


def attack(port: int, count: int, stack: ExitStack) -> list[socket.socket]:
    out = []
    for _ in range(count):
        one = stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=20))
        one.sendall(HALF)
        out.append(one)
    return out


def is_closed(one: socket.socket) -> bool:
    try:
        return one.recv(1) == b""
    except ConnectionError:
        return True


def answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=10) as answer:
            return answer.status == 200
    except OSError:
        return False


@pytest.fixture
def backend(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    pytest.importorskip("uvicorn", reason="needs the extra backend")
    pytest.importorskip("fastapi", reason="needs the extra backend")
    from app.server import backend_server
    from app.server.backend_server import Backend, BackendSettings

    monkeypatch.setattr(network, "FIRST_SECONDS", 0.5)
    monkeypatch.setattr(backend_server.LimitedProtocol, "max_sockets", 30)
    server = backend_server.limited_server(Backend(BackendSettings("geometric"), []).application())
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        yield listener.getsockname()[1]
        server.should_exit = True
        thread.join()


def test_half_headers_do_not_silence_a_backend(
    backend: int, caplog: pytest.LogCaptureFixture
) -> None:
    url = f"http://127.0.0.1:{backend}/health"
    with ExitStack() as stack:
        held = attack(backend, 100, stack)
        assert all(is_closed(one) for one in held[40:])  # beyond the limit, at once
        begun = time.monotonic()
        assert all(is_closed(one) for one in held)
        assert time.monotonic() - begun < 10
        wait_until(lambda: answers(url))
    told = [r for r in caplog.records if "connections" in r.getMessage()]
    assert len(told) == 1


def test_half_headers_do_not_silence_a_server(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "MAX_SOCKETS", 30)
    port = free_port("127.0.0.1")
    server = guard.guarded_server("127.0.0.1", port)
    try:
        with ExitStack() as stack:
            held = attack(port, 100, stack)
            assert all(is_closed(one) for one in held[40:])
        wait_until(lambda: answers(f"http://127.0.0.1:{port}/healthz"))
    finally:
        server.stop()


def test_a_message_is_logged_once_a_minute(caplog: pytest.LogCaptureFixture) -> None:
    log = logging.getLogger("artiworld.test")
    log.addFilter(OncePerMinute(0.2))
    for number in range(1000):
        log.warning("refused %d", number)
    log.warning("other")
    assert [r.getMessage() for r in caplog.records] == ["refused 0", "other"]
    time.sleep(0.25)
    log.warning("refused %d", 7)
    assert caplog.records[-1].getMessage() == "refused 7"
