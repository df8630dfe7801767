"""``artiworld backend``: a real backend process, real clients, and what goes wrong between them."""

from __future__ import annotations

import asyncio
import http.client
import http.server
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("fastapi", reason="needs the extra backend")
pytest.importorskip("uvicorn", reason="needs the extra backend")

from starlette.requests import Request

from app.cli.main import parse
from app.cli.serve import make_config
from app.server.backend_server import Backend, BackendSettings
from model.core.articulated_object import Part, SegmentedObject
from model.core.errors import ArtiworldError, ConfigurationError
from model.core.geometry import Mesh
from model.core.progress import Cancelled
from model.prediction import TOKEN_VARIABLE
from model.prediction.geometric.predictor import GeometricPredictor
from model.prediction.registry import load_predictor
from model.prediction.remote_backend import (
    CONTENT_TYPE,
    BackendError,
    BackendRefused,
    HttpPredictor,
    encode_request,
)
from tests.app import backend_plugin
from tests.app.run_cli import PROGRAM, artiworld, assert_users_mistake, cupboard
from tests.builders import wait_until

TOKEN = "correct horse battery"


def cupboard_object(name: str = "cupboard") -> SegmentedObject:
    parts = [
        Part(f"link_{i}", Mesh(np.asarray(m.vertices), np.asarray(m.faces)))
        for i, m in enumerate(cupboard())
    ]
    return SegmentedObject(name, tuple(parts))


@contextmanager
def running(folder: Path, *words: object) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A backend with the plug-in predictor: its process and address."""
    plugin = backend_plugin.install(folder / "plugin")
    variables = {"PYTHONPATH": os.pathsep.join([str(plugin), *sys.path])}
    variables |= {"MOODY_LOG": str(folder / "log"), TOKEN_VARIABLE: TOKEN, "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [str(PROGRAM), "backend", "--predictor", "moody", "--port", "0", *map(str, words)],
        env={**os.environ, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        found = re.search(r"is ready: (http://localhost:\d+) \(predictor moody\)", line)
        assert found, line + process.stdout.read()
        # What it prints later must not fill the pipe.
        threading.Thread(target=process.stdout.read, daemon=True).start()
        yield process, found.group(1)
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("backend")


@pytest.fixture(scope="module")
def url(folder) -> Iterator[str]:
    with running(folder, "--waiting", 3, "--max-request-mb", 1) as (_, address):
        yield address


@pytest.fixture
def log(folder, url) -> Path:
    (folder / "log").write_text("")
    return folder / "log"


def raw(url: str, method: str, path: str, body: bytes = b"", **headers: str):
    """Status and JSON of a request made by hand."""
    connection = http.client.HTTPConnection(url.removeprefix("http://"), timeout=30)
    headers = {"Authorization": f"Bearer {TOKEN}", **headers}
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    said = json.loads(answer.read())
    connection.close()
    return answer.status, said


def test_the_backend_answers_as_the_predictor_here_would(url, monkeypatch):
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    seen: list[tuple[float, str]] = []
    local = GeometricPredictor().predict(cupboard_object(), seed=3)
    there = load_predictor(url)
    assert there.name == url
    answer = there.predict(cupboard_object(), seed=3, progress=lambda *now: seen.append(now))
    assert answer.tree == local.tree and answer.confidence == local.confidence
    assert answer.backend == f"{local.backend} at {url}"
    assert [f for f, _ in seen] == sorted(f for f, _ in seen) and seen[-1][0] == 1.0
    assert local.tree is not None
    locked = replace(local.tree.joints[0], upper=0.25)
    again = there.predict(cupboard_object(), locked=(locked,))
    assert again.tree is not None and again.joint(locked.child) == locked


def test_predict_asks_the_backend_and_keeps_the_token_to_itself(url, tmp_path):
    parts = tmp_path / "parts"
    parts.mkdir()
    for i, mesh in enumerate(cupboard()):
        mesh.export(parts / f"link_{i}.obj")
    out = tmp_path / "out"
    done = artiworld("predict", parts, "--out", out, "--backend", url, "--token", TOKEN)
    assert done.returncode == 0, done.stderr
    said = json.loads((out / "prediction.json").read_text())
    assert said["backend"].endswith(f" at {url}")
    files = (p for p in out.rglob("*") if p.is_file())
    everything = done.stdout + done.stderr
    everything += "".join(p.read_text(errors="replace") for p in files)
    assert TOKEN not in everything
    wrong = ("predict", parts, "--out", tmp_path / "none", "--backend", url)
    assert_users_mistake(artiworld(*wrong, "--token", "not the token"), "refuses the token")


def test_who_may_come_in(url, monkeypatch):
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
    with pytest.raises(BackendRefused, match="needs a token"):
        HttpPredictor(url).predict(cupboard_object())
    with pytest.raises(BackendRefused, match="refuses the token"):
        HttpPredictor(url, "not the token").check()
    assert HttpPredictor(url, TOKEN).check()["predictor"] == "moody"
    status, said = raw(url, "POST", "/v1/predict", b"x", Authorization="Basic abc")
    assert (status, said["error"]) == (401, "the token is missing or wrong")
    assert HttpPredictor(url, TOKEN).check()["under_way"] == 0


def test_wrong_tokens_are_refused_for_a_while_and_the_right_one_is_heard():
    backend = Backend(BackendSettings("x", TOKEN), [])

    def ask(token: str, address: str) -> int:
        header = (b"authorization", b"Bearer " + token.encode("latin-1"))
        scope = {"type": "http", "headers": [header], "client": (address, 1)}
        # Playwright keeps a loop running in the main thread once a browser was used.
        with ThreadPoolExecutor(1) as thread:
            answer = thread.submit(asyncio.run, backend.health(Request(scope)))
            return getattr(answer.exception() or answer.result(), "status_code")  # noqa: B009

    assert [ask("wröng", "192.0.2.1") for _ in range(6)] == [401] * 5 + [429]
    assert ask(TOKEN, "192.0.2.1") == ask(TOKEN, "192.0.2.2") == 200


@pytest.mark.parametrize(
    ("method", "path", "body", "headers", "status", "words"),
    [
        ("POST", "/v1/predict", b"garbage", {}, 400, "no NPZ archive"),
        ("POST", "/v1/predict", b"", {}, 400, "no NPZ archive"),
        ("POST", "/v1/predict", b"x", {"Content-Type": "text/plain"}, 415, CONTENT_TYPE),
        ("POST", "/v1/predict", b"x" * 1_000_001, {}, 413, "larger than 1 MB"),
        ("GET", "/v1/predict", b"", {}, 405, "method not allowed"),
        ("GET", "/docs", b"", {}, 404, "not found"),
    ],
)
def test_what_is_no_request_gets_a_plain_refusal(url, method, path, body, headers, status, words):
    headers = {"Content-Type": CONTENT_TYPE, **headers}
    found, said = raw(url, method, path, body, **headers)
    assert found == status and words in said["error"]
    assert HttpPredictor(url, TOKEN).check()["under_way"] == 0


def test_an_object_too_large_is_told_before_it_is_sent(url):
    points = np.random.default_rng(0).random((60_000, 3))
    big = Mesh(points, np.arange(60_000).reshape(-1, 3))
    with pytest.raises(BackendError, match=r"has 2 MB, the backend .* at most 1 MB"):
        HttpPredictor(url, TOKEN).predict(SegmentedObject("big", (Part("link_0", big),)))


def test_errors_of_the_predictor(url):
    client = HttpPredictor(url, TOKEN)
    with pytest.raises(ArtiworldError, match="not to my taste") as told:
        client.predict(cupboard_object("picky"))
    assert not isinstance(told.value, BackendError)
    with pytest.raises(BackendError, match=r"failed: .*a bug"):
        client.predict(cupboard_object("broken"))
    with pytest.raises(BackendError, match=r"failed: .*code 3"):
        client.predict(cupboard_object("crash"))
    assert client.predict(cupboard_object()).tree is not None


def test_one_after_the_other_and_too_many_are_refused(url, log):
    client = HttpPredictor(url, TOKEN)
    messages: list[str] = []

    def ask(_: int) -> str:
        try:
            client.predict(
                cupboard_object("held 60"), progress=lambda _, text: messages.append(text)
            )
        except BackendError as error:
            return str(error)
        return "answered"

    with ThreadPoolExecutor(5) as pool:
        asked = [pool.submit(ask, i) for i in range(5)]
        wait_until(lambda: sum(a.done() for a in asked) == 2 and "Dawdling" in messages)
        wait_until(lambda: "Waiting for 2 others" in messages)
        log.with_name("go").touch()
        answers = [a.result(60) for a in asked]
    log.with_name("go").unlink()
    assert answers.count("answered") == 3
    assert all("3 requests are under way" in a for a in answers if a != "answered")
    assert log.read_text().split() == ["begin", "end"] * 3
    assert {"Waiting for 1 other", "Waiting for 2 others", "Dawdling"} <= set(messages)
    wait_until(lambda: client.check()["under_way"] == 0)


def test_cancelling_stops_the_backend(url, log):
    client = HttpPredictor(url, TOKEN)

    def stop_soon(_: float, text: str) -> None:
        if text == "Dawdling":
            raise Cancelled(text)

    with pytest.raises(Cancelled):
        client.predict(cupboard_object("slow 60"), progress=stop_soon)
    wait_until(lambda: "cancelled" in log.read_text())
    # A connection that simply ends, while the request still waits, is noticed as well.
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(client.predict, cupboard_object("slow 2"))
        wait_until(lambda: log.read_text().count("begin") == 2)
        host = url.removeprefix("http://")
        connection = http.client.HTTPConnection(host, timeout=30)
        body = encode_request(cupboard_object("slow 60"), (), 0)
        headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": CONTENT_TYPE}
        connection.request("POST", "/v1/predict", body, headers)
        answer = connection.getresponse()
        assert b"progress" in answer.readline()
        answer.close()
        connection.close()
        assert first.result(60).tree is not None
    wait_until(lambda: client.check()["under_way"] == 0)
    assert log.read_text().split() == ["begin", "cancelled", "begin", "end"]


def test_a_backend_that_is_killed(tmp_path):
    with running(tmp_path) as (process, url):
        client = HttpPredictor(url, TOKEN)

        def kill(_: float, text: str) -> None:
            if text == "Dawdling":
                process.kill()

        with pytest.raises(BackendError, match=r"can't be reached .* this machine"):
            client.predict(cupboard_object("slow 60"), progress=kill)
        process.wait()
        with pytest.raises(BackendError, match=r"can't be reached \(Connection refused\)"):
            client.predict(cupboard_object())


class _SomethingElse(http.server.BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        if self.path == "/silent/health":
            time.sleep(2)
        with suppress(BrokenPipeError):
            self.send_response(302 if self.path.startswith("/moved") else 200)
            self.end_headers()
            self.wfile.write(b'{"service": "a printer"}')

    def log_message(self, *_: object) -> None:
        pass


def test_what_is_no_backend():
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), _SomethingElse) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        with pytest.raises(BackendError, match="is no ArtiWorld backend"):
            HttpPredictor(address).predict(cupboard_object())
        with pytest.raises(BackendError, match="answered 302"):
            HttpPredictor(f"{address}/moved").check()
        with pytest.raises(BackendError, match="no answer"):
            HttpPredictor(f"{address}/silent", silence_seconds=0.2).check()
        server.shutdown()


@pytest.mark.parametrize(
    "address",
    [
        *"ftp://x http:// http://x:port http://me:secret@x http://x/?a=1".split(),
        *"http://x:99999".split(),
    ],
)
def test_addresses_that_cant_be_one(address):
    with pytest.raises(ConfigurationError) as told:
        HttpPredictor(address)
    assert "secret" not in str(told.value)


def test_serve_takes_a_backend_and_says_where_it_is_away(capsys, url, monkeypatch):
    monkeypatch.setenv(TOKEN_VARIABLE, "to be restored")
    monkeypatch.delenv(TOKEN_VARIABLE)

    def config(*words: str):
        return make_config(parse(["serve", "--port", "0", *words])[0])

    away = "http://127.0.0.1:9"
    assert config("--backend", away).predictor == away
    assert "can't be reached" in capsys.readouterr().err
    with pytest.raises(BackendRefused, match="needs a token"):
        config("--backend", url)
    assert config("--backend", url, "--backend-token", TOKEN).predictor == url
    assert os.environ[TOKEN_VARIABLE] == TOKEN
    assert "can't be reached" not in capsys.readouterr().err
    with pytest.raises(ConfigurationError, match="exclude each other"):
        config("--backend", url, "--predictor", "qwen3:weights")
    with pytest.raises(ConfigurationError, match="no --backend"):
        config("--backend-token", TOKEN)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--host", "0.0.0.0"], "give --token"),
        (["--token", "short"], "at least 8"),
        (["--token", "schlüsselwort"], "ASCII"),
        (["--predictor", "magic"], "geometric"),
        (["--workers", "0"], "--workers 0"),
        (["--port", "70000"], "70000"),
    ],
)
def test_options_that_cant_work_are_named(words, told, monkeypatch):
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
    assert_users_mistake(artiworld("backend", *words), told)
