"""Backends and language models' servers that answer with whatever does harm."""

from __future__ import annotations

import http.server
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest

from model.core.articulated_object import Part, SegmentedObject
from model.core.errors import ArtiworldError, ConfigurationError
from model.core.geometry import Mesh
from model.prediction import remote_backend
from model.prediction.remote_backend import BackendError, HttpPredictor
from model.scenes import engines
from model.scenes.articulable_finders import FinderOptions, load_finder
from model.scenes.language_finder import FinderUnavailableError
from model.scenes.scene import ObjectDescription
from tests.model.scenes.chat_server import chat_server, decisions, said

TRIANGLE = Mesh(np.eye(3), np.array([[0, 1, 2]]))
OBJECT = SegmentedObject("box", (Part("link_0", TRIANGLE), Part("link_1", TRIANGLE)))
HEALTH = b'{"service": "artiworld backend"}'
Write = Callable[[bytes], object]


@contextmanager
def backend(answer: Callable[[Write], object], health: bytes = HEALTH) -> Iterator[HttpPredictor]:
    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(health)

        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["content-length"]))
            self.send_response(200)
            self.end_headers()
            with suppress(OSError):
                answer(self.wfile.write)

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield HttpPredictor(f"http://127.0.0.1:{server.server_port}", silence_seconds=1.0)
        server.shutdown()


def joint(**changed: Any) -> dict[str, Any]:
    bare = {"name": "j", "type": "revolute", "parent": "link_0", "child": "link_1", "lower": 0.0}
    return {**bare, "axis": [0, 0, 1], "origin": [0, 0, 0], "upper": 1.0, **changed}


def done(*joints: dict[str, Any], links: Any = ("link_0", "link_1"), **more: Any) -> bytes:
    tree = {"links": list(links), "joints": list(joints)}
    answer = {"tree": tree, "problems": [], "confidence": {}, "backend": "x", "seed": 0}
    answer |= {"seconds": 0.1, "raw": "", **more}
    return json.dumps({"done": answer}).encode() + b"\n"


def endless(write: Write) -> None:
    while True:
        write(b'{"progress": [0.5, "soon"]}\n' * 1000)


WRONG = [{"axis": [0, 0, 0]}, {"axis": [float("nan"), 0, 1]}, {"axis": [[0, 0, 1]]}]
WRONG += [{"upper": float("inf")}, {"origin": [1e308, 1e308, 1e308, 1]}, {"child": "link_0"}]
WRONG += [{"parent": "nobody"}, {"lower": 2.0, "upper": -2.0}]
TEXTS = [b"", b"null", b"[" * 100_000, b'{"done": ' * 50_000, b'{"done": {}}', b'{"done": [1, 2]}']
TEXTS += [b'{"error": {"a": [1]}, "kind": 7}', b'{"progress": {"a": 1}}', b'{"done": {"tree":']
TEXTS += [b'{"progress": [1e999, null]}']
ANSWERS = [done(joint(**wrong)) for wrong in WRONG] + [text + b"\n" for text in TEXTS]
ANSWERS += [done(joint(), joint()), done(links=["link_0"]), done(joint(), confidence={"j": 7e9})]
ANSWERS += [done(joint(), links=["link_0", "link_1", 7])]


@pytest.mark.parametrize("answer", ANSWERS)
def test_a_backends_answer_is_refused_clearly(answer: bytes) -> None:
    with backend(lambda write: write(answer)) as predictor, pytest.raises(ArtiworldError):
        predictor.predict(OBJECT)


def test_an_answer_without_end_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_backend, "MOST_LINES", 5000)
    monkeypatch.setattr(remote_backend, "MAX_LINE", 1 << 20)
    with backend(endless) as predictor, pytest.raises(BackendError, match="come to an end"):
        predictor.predict(OBJECT)
    line = b"x" * (1 << 16)

    def one_line(write: Write) -> None:
        while True:
            write(line)

    with backend(one_line) as predictor, pytest.raises(BackendError, match="broke off"):
        predictor.predict(OBJECT)


@pytest.mark.parametrize("health", [b"[" * 100_000, b"7", b'{"service": ["x"]}', b"\xff\xfe"])
def test_a_health_report_of_anything_is_no_backend(health: bytes) -> None:
    with (
        backend(lambda write: None, health) as predictor,
        pytest.raises(BackendError, match="is no ArtiWorld backend"),
    ):
        predictor.check()


CABINET = ObjectDescription("a white cabinet", None, (0.6, 0.5, 0.8))


@contextmanager
def finder(script: Callable[..., Any], **options: Any) -> Iterator[Any]:
    pytest.importorskip("openai")
    with chat_server() as server:
        server.script = script
        yield load_finder(
            "openai:tiny", FinderOptions(server.url, 4, options.get("timeout", 5.0), 0, None)
        )


def test_a_redirect_of_a_finder_is_named_and_not_followed() -> None:
    with chat_server() as other:
        target = f"{other.url}/chat/completions"
        for status in (301, 302, 307, 308):
            with finder(lambda *_, s=status: (s, {"location": target}, b"")) as asked:
                with pytest.raises(ConfigurationError, match="isn't followed") as caught:
                    asked.find([CABINET])
                assert target in str(caught.value)
        assert not other.requests


@pytest.mark.parametrize("text", ["[" * 50_000, '{"objects": ' * 5000, "\0" * 1000, "NaN", "{}"])
def test_what_a_model_says_is_never_more_than_words(text: str) -> None:
    with finder(lambda *_: said(text)) as asked:
        (decision,) = asked.find([CABINET])
    assert "no usable answer" in decision.reason


@pytest.mark.parametrize(
    "body", [b"[" * 100_000, b"null", b'{"choices": [{"message": 7}]}', b'{"choices": {}}', b"\xff"]
)
def test_an_envelope_of_anything_is_no_answer(body: bytes) -> None:
    json_type = {"content-type": "application/json"}
    with finder(lambda *_: (200, json_type, body)) as asked:
        (decision,) = asked.find([CABINET])
    assert "no usable answer" in decision.reason


def test_answers_beyond_limits_are_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "MOST_BYTES", 100_000)
    for headers, body in (({}, b"x" * 200_000), ({"content-encoding": "gzip"}, b"\x1f\x8b")):
        with (
            finder(lambda *_, h=headers, b=body: (200, h, b)) as asked,
            pytest.raises(FinderUnavailableError, match="can't be asked"),
        ):
            asked.find([CABINET])


def test_an_answer_that_drips_is_not_waited_for() -> None:
    """The server sends a byte every 0.1 s, so that no single read ever times out."""
    pytest.importorskip("openai")
    stop = threading.Event()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.send_response(200)
            self.send_header("content-type", "application/json")
            self.end_headers()
            with suppress(OSError):
                while not stop.wait(0.1):
                    self.wfile.write(b" ")
                    self.wfile.flush()

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        asked = load_finder(
            "openai:tiny",
            FinderOptions(f"http://127.0.0.1:{server.server_port}/v1", 4, 0.5, 0, None),
        )
        began = time.monotonic()
        with pytest.raises(FinderUnavailableError, match="timed out"):
            asked.find([CABINET])
        assert time.monotonic() - began < 5
        stop.set()
        server.shutdown()


def test_an_honest_server_is_still_heard() -> None:
    with finder(lambda body, objects: said(decisions(objects))) as asked:
        (decision,) = asked.find([CABINET])
    assert decision.articulable
