"""Two server processes on one PostgreSQL database and one storage, behind nginx with TLS."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import ssl
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.cli.commands import ServeCommand
from app.cli.main import parse
from app.client import ApiError, Client
from sessions.store import Store
from tests.app.api_server import upload_at_once
from tests.builders import wait_until, write_cupboard
from tests.sessions.people import PASSWORD, add_people
from tests.sessions.postgresql import free_port, postgresql

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
HOSTS = ("127.0.0.1", "127.0.0.2")
"""Both servers listen at the same port, as in containers: the names of cookies have it."""


class Pair:
    """Two servers of one workspace.

    Attributes:
        port: that both listen at.
        people: of the workspace.
        workspace: its folder.
    """

    def __init__(self, folder: Path, database: str, paths: list[Path]) -> None:
        self.workspace = folder / "workspace"
        store = Store(self.workspace, database)
        add_people(store)
        self.port, self.people, self._store = free_port(), store.people, store
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        for host in HOSTS:
            words = [
                sys.executable, "-m", "app.cli.main", "serve", *map(str, paths), "--host", host,
                "--port", str(self.port), "--workspace", str(folder / "workspace"),
                "--database", database, "--storage", f"file://{folder}/storage",
                "--allow-origin", "https://scans.example.org", "--predictor", "geometric",
                "--trusted-proxy", "127.0.0.1",
            ]  # fmt: skip
            with (folder / f"{host}.log").open("wb") as log:
                self.running[host] = subprocess.Popen(
                    words, stdout=log, stderr=log, env={**os.environ, "OMP_NUM_THREADS": "1"}
                )
            # One after the other: the first one makes the working copies.
            wait_until(lambda host=host: self._answers(host), f"the server at {host}", 120)

    def _answers(self, host: str) -> bool:
        with contextlib.suppress(OSError):
            url = f"http://{host}:{self.port}/healthz"
            return urllib.request.urlopen(url, timeout=2).status == 200
        return False

    def client(self, host: str, name: str, *scopes: str) -> Client:
        """A client of one server with a token of an account."""
        account = self.people.accounts.find(name)
        token = self.people.credentials.make_token(account, "test", scopes)
        return Client(f"http://{host}:{self.port}", token)

    def close(self) -> None:
        """End both."""
        for process in self.running.values():
            process.terminate()
        for process in self.running.values():
            process.wait(60)
        self._store.close()


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    folder = tmp_path_factory.mktemp("several")
    with postgresql() as url:
        pair = Pair(folder, f"{url}/postgres", [write_cupboard(folder / "cupboard")])
        try:
            yield pair
        finally:
            pair.close()


def test_leases_and_decisions_hold_between_servers(pair: Pair, tmp_path: Path) -> None:
    one, two = HOSTS
    ann, bob = (pair.client(h, n, "read", "annotate") for h, n in ((one, "ann"), (two, "bob")))
    rob = pair.client(two, "rob", "read", "annotate", "review")
    id = ann.next()
    assert id is not None
    assert bob.next() is None, "ann has the only one"
    ann.command(id, kind="set_category", category="Cupboard")
    with pytest.raises(ApiError, match="ann works on this object now") as refused:
        bob.command(id, kind="set_category", category="Oven")
    assert refused.value.status == 403
    assert [p["name"] for p in bob.call("GET", f"/objects/{id}/presence")] == ["ann"]
    wait_until(lambda: ann.object(id)["segmented"], "parts", 60)
    ann.predict(id)
    wait_until(lambda: len(bob.object(id)["joints"]) == 1, "the other server's prediction", 30)
    ann.submit(id)
    wait_until(lambda: rob.object(id)["state"] == "submitted", "the other server's state", 30)
    rob.accept(id, override="a test", warnings_seen=True)
    wait_until(lambda: ann.object(id)["saved"], "accepted and saved here, too", 30)
    assert ann.object(id)["state"] == "accepted"
    assert ann.download(id, tmp_path / "asset.zip").stat().st_size > 1000


def test_the_same_files_sent_to_both_servers_are_whole(pair: Pair, tmp_path: Path) -> None:
    clients = [pair.client(host, "ann", "read", "annotate") for host in HOSTS]
    for number in range(3):
        upload_at_once(tmp_path / str(number), clients, number)
    folders = list((pair.workspace / "uploads").glob("*/objects"))
    assert [len(list(f.rglob("*.*"))) for f in folders] == [120] * 3


def test_a_browser_session_holds_at_both_and_ends_at_both(pair: Pair) -> None:
    def ask(host: str, path: str, body: Any = None, cookie: str = "") -> Any:
        request = urllib.request.Request(
            f"http://{host}:{pair.port}/api/v1{path}",
            None if body is None else json.dumps(body).encode(),
            {"X-ArtiWorld": "1", "Content-Type": "application/json", "Cookie": cookie},
        )
        return urllib.request.urlopen(request, timeout=30)

    cookie = ask(HOSTS[0], "/login", {"name": "mia", "password": PASSWORD}).headers["Set-Cookie"]
    cookie = cookie.partition(";")[0]
    for host in HOSTS:
        assert json.load(ask(host, "/me", cookie=cookie))["name"] == "mia"
    # A project's settings reach the other server.
    patch = pair.client(HOSTS[0], "mia", "read", "manage")
    patch.call("PATCH", "/project", {"settings": {"name": "Kitchens"}})
    there = pair.client(HOSTS[1], "mia", "read")
    wait_until(lambda: there.call("GET", "/project")["name"] == "Kitchens", "its settings", 30)
    pair.people.credentials.revoke(pair.people.accounts.find("mia"), "mia")
    for host in HOSTS:
        with pytest.raises(urllib.error.HTTPError, match="401"):
            ask(host, "/me", cookie=cookie)


@pytest.fixture
def proxy(pair: Pair, tmp_path: Path) -> Iterator[str]:
    """Address of nginx with the configuration of ``deploy``, but for names and ports."""
    program = shutil.which("nginx", path=f"{os.environ['PATH']}:/usr/sbin")
    if program is None or shutil.which("openssl") is None:
        pytest.skip("nginx or openssl is not installed: apt-get install nginx openssl")
    certs = tmp_path / "certs"
    certs.mkdir()
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj",
         "/CN=scans.example.org", "-keyout", certs / "server.key", "-out", certs / "server.crt"],
        check=True, capture_output=True, timeout=60,
    )  # fmt: skip
    port, text = free_port(), (DEPLOY / "nginx.conf").read_text()
    for name, host in zip(("artiworld-1", "artiworld-2"), HOSTS, strict=True):
        assert f"server {name}:8080;" in text
        text = text.replace(f"{name}:8080", f"{host}:{pair.port}")
    text = text.replace("cookie_artiworld_8080", f"cookie_artiworld_{pair.port}")
    text = text.replace("listen 443 ssl", f"listen 127.0.0.1:{port} ssl")
    text = text.replace("certs/server", f"{certs}/server")
    text = f"daemon off;\npid {tmp_path}/nginx.pid;\n{text}"
    temp = "".join(f"  {n}_temp_path {tmp_path}/{n};\n" for n in ("client_body", "proxy"))
    text = text.replace("http {\n", f"http {{\n{temp}  access_log off;\n")
    (tmp_path / "nginx.conf").write_text(text)
    words = [program, "-c", tmp_path / "nginx.conf", "-e", tmp_path / "error.log"]
    subprocess.run([*words, "-t"], check=True, capture_output=True, timeout=30)
    process = subprocess.Popen(words)
    try:
        yield f"https://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait(30)


def test_behind_the_proxy_one_server_may_end(pair: Pair, proxy: str) -> None:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    headers = {
        "Host": "scans.example.org", "Origin": "https://scans.example.org", "X-ArtiWorld": "1",
        "Content-Type": "application/json",
    }  # fmt: skip

    def ask(path: str, body: Any = None, cookie: str = "") -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(proxy + path, data, {**headers, "Cookie": cookie})
        return urllib.request.urlopen(request, timeout=30, context=context)

    wait_until(lambda: _is_up(ask), "the proxy", 30)
    answer = ask("/api/v1/login", {"name": "rob", "password": PASSWORD})
    assert "Secure" in answer.headers["Set-Cookie"]
    cookie = answer.headers["Set-Cookie"].partition(";")[0]
    assert b"</html>" in ask("/", cookie=cookie).read()
    assert json.load(ask("/api/v1/me", cookie=cookie))["name"] == "rob"
    pair.running[HOSTS[0]].terminate()
    pair.running[HOSTS[0]].wait(60)
    for _ in range(6):
        assert json.load(ask("/api/v1/me", cookie=cookie))["name"] == "rob"


def _is_up(ask: Any) -> bool:
    with contextlib.suppress(OSError):
        return ask("/healthz").status == 200
    return False


def test_the_compose_file_gives_options_that_there_are() -> None:
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    services = compose["services"]
    assert set(services) == {"postgres", "storage", "artiworld-1", "artiworld-2", "proxy"}
    for service in services.values():
        for volume in service.get("volumes", ()):
            place = volume.partition(":")[0]
            known = place in compose["volumes"] or (DEPLOY / place).exists()
            assert known or place == "./certs", place
        for name in service.get("depends_on", ()):
            assert name in services
    texts = (DEPLOY / "nginx.conf").read_text()
    for name in ("artiworld-1", "artiworld-2"):
        command = services[name]["command"]
        asked, _ = parse(command)
        assert isinstance(asked, ServeCommand)
        assert (asked.port, asked.host, str(asked.workspace)) == (8080, "0.0.0.0", "/workspace")
        assert (
            str(asked.database).startswith("postgresql+pg8000://")
            and str(asked.storage)[:5] == "s3://"
        )
        assert f"server {name}:{asked.port};" in texts
    s3 = json.loads((DEPLOY / "s3.json").read_text())
    assert s3["identities"][0]["credentials"]
    used = set((DEPLOY / "compose.yaml").read_text().split("${")[1:])
    head = (DEPLOY / "compose.yaml").read_text().partition("x-artiworld")[0]
    assert all(u.partition("}")[0] in head for u in used), "what .env needs is said"
