"""The guard before viser, seen by real HTTP and websocket clients."""

from __future__ import annotations

import contextlib
import gc
import gzip
import http.client
import json
import logging
import socket
import threading
import time
import tracemalloc
import urllib.error
import urllib.request
from http import HTTPStatus

import msgspec
import pytest
import viser
import zstandard
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from app.server import guard, network
from app.server.guard import RouteAnswer, RouteRequest, guarded_server
from app.server.login import ATTEMPTS, GUESSES, Login, new_token
from app.server.network import Room, check_address, free_port, is_loopback
from app.server.uploads import plain_name
from model.core.errors import ConfigurationError
from tests.builders import wait_until

TOKEN = "correct horse, battery"
LIMIT = 3_000_000
VISER = viser.__version__


class Client:
    """Requests without redirects, so that each answer is seen."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.cookie: str | None = None

    def get(self, path: str, **headers: str):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        fields = {name.replace("_", "-"): value for name, value in headers.items()}
        if self.cookie:
            fields["Cookie"] = self.cookie
        connection.request("GET", path, headers=fields)
        answer = connection.getresponse()
        body = answer.read()
        connection.close()
        return answer.status, dict(answer.getheaders()), body

    def log_in(self, token: str = TOKEN):
        status, headers, body = self.get("/login", X_ArtiWorld_Token=token.replace(" ", "%20"))
        if "Set-Cookie" in headers:
            self.cookie = headers["Set-Cookie"].partition(";")[0]
        return status, headers, body

    def websocket(self, **headers: str):
        fields = {name.replace("_", "-"): value for name, value in headers.items()}
        if self.cookie:
            fields["Cookie"] = self.cookie
        return connect(
            f"ws://127.0.0.1:{self.port}/",
            additional_headers=fields,
            subprotocols=[f"viser-v{VISER}"],  # type: ignore[list-item]
            max_size=None,
            proxy=None,
        )


def slow_route(request: RouteRequest) -> RouteAnswer:
    time.sleep(float(request.query["seconds"]))
    return RouteAnswer(b"{}")


def file_route(request: RouteRequest) -> RouteAnswer:
    return RouteAnswer(request.path.encode(), "text/plain", download_name="añb.zip")


def broken_route(_: RouteRequest) -> RouteAnswer:
    raise KeyError("secret detail")


ROUTES = {"/api/slow": slow_route, "/files/": file_route, "/broken": broken_route}


def is_listening(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture(scope="module")
def open_server():
    server = guarded_server(port=0, max_upload_bytes=LIMIT, routes=ROUTES)
    yield server
    server.stop()


@pytest.fixture
def token_server():
    server = guarded_server("0.0.0.0", 0, TOKEN, LIMIT, ROUTES)
    yield server
    server.stop()


@pytest.fixture
def client(open_server):
    return Client(open_server.get_port())


@pytest.fixture
def stranger(token_server):
    return Client(token_server.get_port())


# Who may come in


def test_listens_on_this_machine_alone_by_default(open_server):
    port = open_server.get_port()
    assert open_server.get_host() == "127.0.0.1"
    own = socket.gethostbyname(socket.gethostname())
    if not is_loopback(own):
        with pytest.raises(OSError), socket.create_connection((own, port), timeout=2):
            pass


def test_a_page_that_is_opened_while_the_server_starts_goes_on_by_itself(monkeypatch):
    go_on, port = threading.Event(), free_port("127.0.0.1")
    real = guard.UploadGuard

    def held(limit: int, room: Room):
        assert go_on.wait(30)
        return real(limit, room)

    monkeypatch.setattr(guard, "UploadGuard", held)
    servers: list[viser.ViserServer] = []
    thread = threading.Thread(target=lambda: servers.append(guarded_server(port=port)))
    thread.start()
    wait_until(lambda: is_listening(port), "it listens")
    status, headers, _ = Client(port).get("/")
    assert (status, headers["Refresh"]) == (503, "1")
    go_on.set()
    thread.join(30)
    status, headers, page = Client(port).get("/")
    assert status == 200 and "Refresh" not in headers and b"<html" in page
    servers[0].stop()


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5"])
def test_other_hosts_need_a_token(host):
    with pytest.raises(ConfigurationError, match="--token"):
        guarded_server(host, 0)


def test_short_token_is_refused():
    with pytest.raises(ConfigurationError, match="at least 8"):
        guarded_server("0.0.0.0", 0, "short")


def test_page_and_health_without_token(client):
    status, headers, body = client.get("/")
    assert status == 200 and b"<title>ArtiWorld</title>" in body
    assert str(LIMIT).encode() in body
    packed = client.get("/", Accept_Encoding="gzip")[2]
    assert gzip.decompress(packed) == body
    assert headers["X-Frame-Options"] == "DENY"
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    status, headers, body = client.get("/healthz")
    assert status == 200 and json.loads(body) == {"status": "ok"}
    assert headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize("path", ["/", "/index.html", "/api/slow?seconds=0", "/files/a", "//"])
def test_stranger_sees_nothing_but_the_login_page_and_health(stranger, path):
    status, headers, body = stranger.get(path)
    assert (status, headers.get("Location")) in [(303, "/login"), (401, None)]
    assert b"Viser" not in body and b"ArtiWorld</title>" not in body
    assert stranger.get("/healthz")[0] == 200
    status, headers, body = stranger.get("/login")
    assert status == 200 and b'type="password"' in body
    assert "script-src 'nonce-" in headers["Content-Security-Policy"]


def test_wrong_token_then_right_token(stranger):
    status, headers, _ = stranger.log_in("wrong token")
    assert status == 401 and "Set-Cookie" not in headers
    status, headers, _ = stranger.log_in()
    assert status == 200
    cookie = headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert TOKEN not in cookie
    assert b"<title>ArtiWorld</title>" in stranger.get("/")[2]
    with stranger.websocket() as websocket:
        assert websocket.recv(timeout=10)


def test_login_by_address_sets_the_cookie_and_leaves_the_address(stranger):
    status, headers, _ = stranger.get("/login?token=correct+horse,%20battery")
    assert status == 303 and headers["Location"] == "/"
    stranger.cookie = headers["Set-Cookie"].partition(";")[0]
    assert stranger.get("/")[0] == 200


def test_wrong_tokens_lock_nobody_else_of_the_address_out(stranger):
    for _ in range(ATTEMPTS):
        assert stranger.log_in("a wrong token")[0] == 401
    assert stranger.log_in("a wrong token")[0] == 429
    assert stranger.log_in()[0] == 200
    assert stranger.cookie is not None


def test_lock_ends_after_its_time(monkeypatch):
    now = 1000.0
    monkeypatch.setattr("app.server.login.time.monotonic", lambda: now)
    login = Login(TOKEN)
    heard = [login.try_token("wrong wrong", "1.2.3.4") for _ in range(GUESSES - 1)]
    assert heard == [False] * ATTEMPTS + [None] * (GUESSES - 1 - ATTEMPTS)
    assert login.try_token(TOKEN, "1.2.3.4") is True
    assert login.try_token("wrong wrong", "1.2.3.4") is None
    assert login.try_token(TOKEN, "1.2.3.4") is None
    assert login.try_token(TOKEN, "1.2.3.5") is True
    now += 61
    assert login.try_token(TOKEN, "1.2.3.4") is True


@pytest.mark.parametrize(
    "cookie", [None, "artiworld_{port}=", "artiworld_{port}=0", "a=b;;=; {odd}"]
)
def test_websocket_without_the_cookie_is_refused(stranger, cookie):
    if cookie:
        stranger.cookie = cookie.replace("{port}", str(stranger.port))
    with pytest.raises(InvalidStatus) as caught:
        stranger.websocket()
    assert caught.value.response.status_code == 401


def test_cookie_holds_after_a_restart_with_the_same_token_only():
    cookie = Login(TOKEN).cookie(8080, secure=False).partition(";")[0]
    assert Login(TOKEN).knows([cookie], 8080)
    assert Login(TOKEN).knows(['other={"odd": [1]}; =; ' + cookie, "x"], 8080)
    assert not Login(TOKEN).knows([cookie], 8081)
    assert not Login(new_token()).knows([cookie], 8080)


# Other sites' pages


@pytest.mark.parametrize(
    "origin",
    [
        *"http://evil.example null http://127.0.0.1:1".split(),
        *"http://127.0.0.1.evil.example file://".split(),
    ],
)
def test_foreign_origin_is_refused_on_websocket_and_http(client, origin):
    with pytest.raises(InvalidStatus) as caught:
        client.websocket(Origin=origin)
    assert caught.value.response.status_code == 403
    assert client.get("/", Origin=origin)[0] == 403


def test_foreign_origin_is_refused_even_with_the_cookie(stranger):
    stranger.log_in()
    with pytest.raises(InvalidStatus) as caught:
        stranger.websocket(Origin="http://evil.example")
    assert caught.value.response.status_code == 403


def test_own_origin_is_welcome(client):
    with client.websocket(Origin=f"http://127.0.0.1:{client.port}") as websocket:
        assert websocket.recv(timeout=10)
    host = f"localhost:{client.port}"
    assert client.get("/", Host=host, Origin=f"http://{host}")[0] == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "a b"]
)
def test_a_foreign_name_for_this_machine_is_refused(client, host):
    assert client.get("/", Host=host)[0] == 403


def test_another_sites_image_tag_gets_nothing_but_a_link_works(client):
    fetch = {"Sec_Fetch_Site": "cross-site"}
    assert client.get("/files/a", **fetch, Sec_Fetch_Mode="no-cors")[0] == 403
    assert client.get("/", **fetch, Sec_Fetch_Mode="navigate")[0] == 200


def test_a_proxys_address_can_be_allowed():
    server = guarded_server(port=0, allowed_origins=("https://scans.example.org",))
    try:
        client = Client(server.get_port())
        good = {"Host": "scans.example.org", "Origin": "https://scans.example.org"}
        assert client.get("/", **good)[0] == 200
        assert client.get("/", Origin="https://scans.example.org")[0] == 200
        assert client.get("/", Host="other.example.org")[0] == 403
    finally:
        server.stop()


# Routes and odd requests


def test_routes_answer_by_path_and_by_folder(client):
    status, headers, body = client.get("/files/a%20b/c?x=1")
    assert status == 200 and body == b"/files/a b/c"
    assert headers["Content-Disposition"] == "attachment; filename*=UTF-8''a%C3%B1b.zip"
    assert client.get("/files")[0] == 404
    assert client.get("/../../etc/passwd")[0] == 404


def test_a_broken_route_tells_no_details(client, caplog):
    with caplog.at_level(logging.CRITICAL):
        status, _, body = client.get("/broken")
    assert status == 500 and b"secret" not in body
    assert client.get("/healthz")[0] == 200


def test_a_slow_route_holds_nobody_up(client):
    slow = threading.Thread(target=client.get, args=("/api/slow?seconds=1",))
    slow.start()
    assert client.get("/healthz")[0] == 200
    assert slow.is_alive()
    slow.join()


@pytest.mark.parametrize(
    "raw",
    [
        b"POST /login HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4\r\n\r\nabcd",
        b"\x00\x01\x02\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: null\r\nOrigin: http://localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\n\r\n",
    ],
)
def test_odd_requests_neither_pass_nor_break_the_server(client, raw):
    with socket.create_connection(("127.0.0.1", client.port), timeout=10) as connection:
        connection.sendall(raw)
        answer = connection.recv(200)
    assert b" 200 " not in answer
    assert client.get("/healthz")[0] == 200


def test_urllib_sees_a_plain_web_server(open_server):
    url = f"http://localhost:{open_server.get_port()}/healthz"
    with urllib.request.urlopen(url, timeout=10) as answer:
        assert answer.status == HTTPStatus.OK
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(url + "/nothing", timeout=10)


# viser's own doors


def send(websocket, kind: str, **fields) -> None:
    websocket.send(msgspec.msgpack.encode({"type": kind, **fields}))


def receive_until(websocket, kind: str, seconds: float = 10.0) -> dict:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        data = websocket.recv(timeout=end - time.monotonic())
        packed = int.from_bytes(data[8:16], "little")
        inner = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed])
        for message in msgspec.msgpack.decode(inner)["messages"]:
            if message["type"] == kind:
                return message
    raise AssertionError(f"no {kind} came")


def test_nobody_can_open_a_share_tunnel(open_server, client, monkeypatch):
    opened = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *a, **k: opened.append(a))
    with client.websocket() as websocket:
        send(websocket, "ShareUrlRequest")
        send(websocket, "ShareUrlDisconnect")
        time.sleep(0.3)
        websocket.ping().wait(5)
    assert not opened
    with pytest.raises(ConfigurationError):
        open_server.request_share_url()


def test_too_large_a_message_ends_the_connection(client):
    with client.websocket() as websocket:
        with pytest.raises(ConnectionClosed) as caught:
            websocket.send(bytes(17 * 2**20))
            while True:
                websocket.recv(timeout=10)
        assert caught.value.rcvd is not None and caught.value.rcvd.code == 1009


@pytest.fixture
def uploads(open_server, client):
    """An upload button and what arrives through it."""
    button = open_server.gui.add_upload_button("Upload")
    arrived: list[tuple[str, bytes]] = []
    button.on_upload(lambda _: arrived.append((button.value.name, button.value.content)))
    with client.websocket() as websocket:
        send_camera(websocket)
        yield websocket, button_named(websocket, "Upload"), arrived
    button.remove()


def send_camera(websocket) -> None:
    """viser knows a client from its first camera message on."""
    send(
        websocket,
        "ViewerCameraMessage",
        wxyz=(1.0, 0.0, 0.0, 0.0),
        position=(0.0, 0.0, 1.0),
        fov=1.0,
        near=0.1,
        far=10.0,
        image_height=10,
        image_width=10,
        look_at=(0.0, 0.0, 0.0),
        up_direction=(0.0, 0.0, 1.0),
    )


def button_named(websocket, label: str) -> str:
    """The id of a button, as the browser gets it."""
    while True:
        message = receive_until(websocket, "GuiUploadButtonMessage")
        if message["props"]["label"] == label:
            return message["uuid"]


def announce(
    websocket, button: str, size: int, parts: int, name: str = "scan.ply", key="t"
) -> None:
    send(
        websocket,
        "FileTransferStartUpload",
        source_component_uuid=button,
        transfer_uuid=key,
        filename=name,
        mime_type="",
        part_count=parts,
        size_bytes=size,
    )


def part(websocket, button: str, index: int, content: bytes, key: str = "t") -> None:
    send(
        websocket,
        "FileTransferPart",
        source_component_uuid=button,
        transfer_uuid=key,
        part_index=index,
        content=content,
    )


def test_a_small_upload_arrives_with_a_plain_name(uploads):
    websocket, button, arrived = uploads
    announce(websocket, button, 5, 2, "../../etc/passwd\x00<b>.ply")
    part(websocket, button, 1, b"de")
    part(websocket, button, 0, b"abc")
    wait_until(lambda: arrived)
    assert arrived == [("passwd__b_.ply", b"abcde")]


def test_an_empty_upload_still_arrives(uploads):
    websocket, button, arrived = uploads
    announce(websocket, button, 0, 0)
    wait_until(lambda: arrived)
    assert arrived == [("scan.ply", b"")]


@contextlib.contextmanager
def nothing_kept():
    """Fail where more of what is sent within the block stays than the last message, packed and
    unpacked."""
    tracemalloc.start()
    try:
        yield
        gc.collect()
        assert sum(trace.size > 300_000 for trace in tracemalloc.take_snapshot().traces) <= 2
    finally:
        tracemalloc.stop()


def test_a_2_gb_upload_is_refused_at_its_announcement(uploads):
    websocket, button, arrived = uploads
    announce(websocket, button, 2_000_000_000, 3815)
    note = receive_until(websocket, "NotificationShowMessage")
    assert "2,000 MB" in note["props"]["body"] and "limit is 3 MB" in note["props"]["body"]
    with nothing_kept():
        for i in range(6):  # a browser goes on sending
            part(websocket, button, i, bytes(512 * 1024))
        later = receive_until(websocket, "NotificationUpdateMessage")
    assert later["uuid"] == "upload-t" and later["props"]["title"] == "Upload refused"
    assert not arrived
    announce(websocket, button, 3, 1, key="small")
    part(websocket, button, 0, b"abc", key="small")
    wait_until(lambda: arrived)


def test_more_bytes_than_announced_are_dropped(uploads):
    websocket, button, arrived = uploads
    with nothing_kept():
        announce(websocket, button, 2_900_000, 10)
        for index in range(4):
            part(websocket, button, index, bytes(800_000))
        note = receive_until(websocket, "NotificationShowMessage")
    assert "larger than the announced" in note["props"]["body"]
    assert not arrived


def test_many_uploads_at_once_share_the_limit(uploads):
    websocket, button, arrived = uploads
    for key in "ab":
        announce(websocket, button, 2_000_000, 4, name=f"{key}.ply", key=key)
    note = receive_until(websocket, "NotificationShowMessage")
    assert "b.ply: too much is being sent" in note["props"]["body"]
    for index in range(4):
        for key in "ba":
            part(websocket, button, index, bytes(500_000), key=key)
    wait_until(lambda: arrived)
    assert [name for name, _ in arrived] == ["a.ply"]
    announce(websocket, button, 2_000_000, 4, key="c")
    for index in range(4):
        part(websocket, button, index, bytes(500_000), key="c")
    wait_until(lambda: len(arrived) == 2, "there is room again")


@pytest.mark.parametrize(("size", "parts"), [(-1, 1), (10, -1), (10, 11), (5, 2**40)])
def test_senseless_announcements_are_refused(uploads, size, parts):
    websocket, button, _ = uploads
    announce(websocket, button, size, parts)
    note = receive_until(websocket, "NotificationShowMessage")
    assert "is malformed" in note["props"]["body"]


def test_an_upload_into_one_clients_own_panel_is_guarded_too(open_server, client):
    made = {}
    # Browsers of earlier tests may still be leaving; they get a panel too.
    before = set(open_server.get_clients())

    def welcome(c):
        made[c.client_id] = c.gui.add_upload_button("Mine")

    open_server.on_client_connect(welcome)
    with client.websocket() as websocket:
        send_camera(websocket)
        wait_until(lambda: set(made) - before)
        button, uuid = made[max(set(made) - before)], button_named(websocket, "Mine")
        announce(websocket, uuid, LIMIT + 1, 7)
        assert receive_until(websocket, "NotificationShowMessage")
        announce(websocket, uuid, 3, 1, key="ok")
        part(websocket, uuid, 0, b"abc", key="ok")
        wait_until(lambda: button.value.content == b"abc")


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("scan.ply", "scan.ply"),
        ("C:\\a\\b.obj", "b.obj"),
        ("..", "upload"),
        ("", "upload"),
        ("日本 1.glb", "日本 1.glb"),
        ("x" * 300 + ".ply", "x" * 116 + ".ply"),
    ],
)
def test_plain_name(name, plain):
    assert plain_name(name) == plain


# Addresses


def test_a_taken_port_is_named():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        port = taken.getsockname()[1]
        with pytest.raises(ConfigurationError, match=f"port {port} is in use"):
            guarded_server(port=port)


@pytest.mark.parametrize(
    ("host", "port", "words"),
    [
        ("127.0.0.1", 70000, "out of range"),
        ("203.0.113.7", 0, "can't listen"),
        ("no.such.host.invalid", 0, "can't be resolved"),
    ],
)
def test_an_address_that_cant_work_is_named_at_once(host, port, words):
    with pytest.raises(ConfigurationError, match=words):
        check_address(host, port)


def test_the_next_free_port_is_taken(monkeypatch):
    assert free_port("127.0.0.1") in network.PORTS
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        port = taken.getsockname()[1]
        monkeypatch.setattr(network, "PORTS", range(port, port + 50))
        assert free_port("127.0.0.1") > port
