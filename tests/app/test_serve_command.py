"""``artiworld serve``: its options, and a real server that starts, answers and stops."""

from __future__ import annotations

import http.client
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from app.cli.main import parse
from app.cli.serve import make_config
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.network import url
from app.server.server import paths_to_open
from model.core.errors import ArtiworldError
from model.core.files import static_assets
from model.scenes.articulable_finders import LexiconFinder
from model.scenes.asset_parts import index_assets
from model.scenes.convert import descriptions
from model.scenes.registry import read_scene
from sessions.store import Store
from tests.app.run_cli import PROGRAM, artiworld, assert_users_mistake, box
from tests.builders import wait_until


def config_of(*words: str):
    return make_config(parse(["serve", *words])[0])


@pytest.fixture
def scan(tmp_path) -> Path:
    path = tmp_path / "box.stl"
    box((0, 0, 0), (1, 1, 1)).export(path)
    return path


@contextmanager
def serving(*words: object, **variables: str) -> Iterator[tuple[subprocess.Popen[str], int, str]]:
    """A server of its own: the process, its port, and what it printed until it was ready."""
    process = subprocess.Popen(
        [str(PROGRAM), "serve", *map(str, words)],
        env={**os.environ, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    try:
        printed = ""
        while "is ready" not in printed:
            line = process.stdout.readline()
            assert line, printed
            printed += line
        (port,) = re.findall(r"is ready: http://[\w.-]+:(\d+)", printed)
        yield process, int(port), printed
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def get(port: int, path: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), body


def descendants(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    own = [int(word) for task in tasks for word in task.read_text().split()]
    return [*own, *(pid for child in own for pid in descendants(child))]


def test_serve_answers_and_ends_at_ctrl_c_with_its_workers(scan, tmp_path):
    with serving(scan, "--workspace", tmp_path / "w", "--port", 0) as (process, port, _):
        assert get(port, "/healthz")[0] == 200
        assert b"<title>ArtiWorld</title>" in get(port, "/")[2]
        wait_until(lambda: len(descendants(process.pid)) > 5, "the workers are there")
        workers = descendants(process.pid)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    end = time.monotonic() + 5
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        assert time.monotonic() < end
        time.sleep(0.05)


def test_an_open_host_gets_a_token_and_prints_how_to_log_in(scan, tmp_path):
    words = (scan, "--workspace", tmp_path / "w", "--host", "0.0.0.0", "--port", 0)
    with serving(*words) as (_, port, printed):
        assert get(port, "/")[0] == 303
        assert f":{port}/login" in printed
        (path,) = re.findall(r"Log in at http://[\w.-]+:\d+(/login\?token=[\w-]{20,})", printed)
        status, headers, _ = get(port, path)
        assert status == 303 and "HttpOnly" in headers["Set-Cookie"]


@pytest.mark.parametrize(
    ("host", "shown"),
    [
        ("127.0.0.1", "localhost"),
        ("::1", "[::1]"),
        ("::", socket.gethostname()),
        ("0.0.0.0", socket.gethostname()),
        ("scans.example.org", "scans.example.org"),
        ("2001:db8::7", "[2001:db8::7]"),
        ("[2001:db8::7]", "[2001:db8::7]"),
    ],
)
def test_addresses_as_a_browser_takes_them(host, shown):
    assert url(host, 8123) == f"http://{shown}:8123"


def test_defaults():
    config = config_of()
    assert (config.host, config.token, config.paths) == ("127.0.0.1", None, ())
    assert config.workspace == Path("workspace") and config.port in range(8080, 8100)
    assert config.user


def test_the_token_may_come_from_the_environment(monkeypatch):
    monkeypatch.setenv("ARTIWORLD_TOKEN", "from the environment")
    assert config_of("--port", "0").token == "from the environment"
    assert config_of("--port", "0", "--token", "from the line").token == "from the line"


def test_every_option_arrives(scan):
    config = config_of(
        str(scan),
        *"--workspace w --database sqlite:///x.db --port 0 --token".split(),
        "long enough",
        *"--user ada --up-axis y --unit-scale 0.01 --max-upload-mb 7 --segmenter nearest".split(),
        *"--predictor geometric --allow-origin https://a.example".split(),
    )
    assert config.paths == (scan,) and config.database == "sqlite:///x.db"
    assert (config.user, config.up_axis, config.unit_scale) == ("ada", "y", 0.01)
    assert (config.max_upload_mb, config.segmenter, config.token) == (7, "nearest", "long enough")
    assert config.allowed_origins == ("https://a.example",)


def test_a_scene_is_told_from_single_objects(scan, tmp_path):
    bundled = static_assets() / "examples" / "home.scene.json"
    alone = config_of(str(bundled))
    assert (alone.scene, alone.assets, alone.paths) == (bundled, (bundled.parent,), ())
    named = config_of(str(bundled), "--assets", str(tmp_path), "--finder", "lexicon")
    assert named.assets == (tmp_path,)
    assert config_of(str(scan)).scene is None and config_of(str(scan.parent)).scene is None
    assert config_of(str(scan), "--assets", str(tmp_path)).scene == scan


def test_all_the_assets_of_the_bundled_scene_are_bundled():
    path = static_assets() / "examples" / "home.scene.json"
    scene, assets = read_scene(path), index_assets([path.parent])
    assert not scene.problems and len(scene.objects) > 15
    assert all(o.box or (o.asset and assets.find(o.asset)) for o in scene.objects)
    decided = LexiconFinder().find(descriptions(scene))
    assert 6 <= sum(d.articulable for d in decided) < len(scene.objects)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["/no/such/scan.ply"], "/no/such/scan.ply"),
        (["--assets", "."], "scene"),
        ([".", "--assets", "."], "scene"),
        (["pyproject.toml", "--assets", "/no/such/folder"], "/no/such/folder"),
        (["--finder", "magic"], "lexicon"),
        (["--port", "70000"], "70000"),
        (["--host", "203.0.113.9", "--port", "0"], "203.0.113.9"),
        (["--max-upload-mb", "0"], "--max-upload-mb"),
        (["--predictor", "magic"], "geometric"),
        (["--segmenter", "magic"], "default"),
        (["--token", "short"], "--token"),
        (["--allow-origin", "scans.example.org"], "--allow-origin"),
    ],
)
def test_options_that_cant_work_are_named(words, told):
    with pytest.raises(ArtiworldError, match=re.escape(told)):
        config_of(*words)


def test_mistakes_end_the_program_with_one_line(scan, tmp_path):
    workspace = ("--workspace", tmp_path / "w", "--port", 0)
    assert_users_mistake(artiworld("serve", tmp_path / "gone.ply", *workspace), "gone.ply")
    assert_users_mistake(artiworld("serve", scan, *workspace, "--token", "short"), "--token")
    empty = tmp_path / "empty"
    empty.mkdir()
    assert_users_mistake(artiworld("serve", empty, *workspace), "empty")
    bad = ("--workspace", tmp_path / "v", "--port", 0, "--database", "nonsense")
    assert_users_mistake(artiworld("serve", scan, *bad), "database")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        port = taken.getsockname()[1]
        done = artiworld("serve", scan, "--workspace", tmp_path / "w", "--port", port)
        assert_users_mistake(done, f"port {port} is in use")


def empty_file(path: Path) -> None:
    path.touch()


def open_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("pipe", os.mkfifo),
        ("pipe.ply", os.mkfifo),
        ("socket.ply", open_socket),
        ("nothing", empty_file),
        ("nothing.ply", empty_file),
        ("letter.docx", lambda path: path.write_text("Dear Sir")),
    ],
)
def test_what_can_never_be_opened_is_told_before_the_server_starts(name, make, tmp_path):
    make(tmp_path / name)
    done = artiworld("serve", tmp_path / name, "--workspace", tmp_path / "w", "--port", 0)
    assert_users_mistake(done, name)
    assert not (tmp_path / "w").exists()


def test_what_cant_be_opened_beside_others_is_told_and_marked(scan, tmp_path):
    empty_file(tmp_path / "nothing.ply")
    words = (tmp_path / "nothing.ply", "/dev/null", scan)
    with serving(*words, "--workspace", tmp_path / "w", "--port", 0) as (_, _, printed):
        assert "nothing.ply: the file is empty" in printed
        assert "/dev/null: is not a regular file" in printed
    store = Store(tmp_path / "v")
    config = ServeConfig(paths=words, workspace=tmp_path / "v")
    app_state = AppState(config, store, paths_to_open(config))
    try:
        assert [r.id in app_state.queue.unreadable for r in app_state.queue.records()] == [
            True,
            True,
            False,
        ]
    finally:
        app_state.close()


def test_the_pages_messages_are_known_whoever_asked_first():
    """In a process of its own: viser keeps what it knew when it was first asked."""
    words = (
        "from viser import _messages as m; m.Message._subclass_from_type_string();"
        "import app.server.page as p;"
        "known = m.Message._subclass_from_type_string();"
        "assert known['ArtiworldHoverMessage'] is p.ArtiworldHoverMessage"
    )
    subprocess.run([sys.executable, "-c", words], check=True, timeout=60)
