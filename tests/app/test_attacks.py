"""What somebody tries who may not, and that it is refused."""

from __future__ import annotations

import ipaddress
import json
import socket
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
import trimesh
from websockets.exceptions import InvalidStatus

from app.client import ApiError, Client, is_genuine
from app.server import entrance
from app.server.api.project import check_url, is_public, send, signature
from app.server.login import GUESSES
from app.server.server import Server
from model.core.errors import ConfigurationError
from sessions.commands import Reject
from sessions.live import LiveSession
from sessions.store import Store
from sessions.webhooks import MOST_ATTEMPTS
from tests.app.api_server import Browser, WebTab, team_server, token_client
from tests.builders import wait_until
from tests.sessions.people import PASSWORD, add_people


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("attacked")
    trimesh.creation.box((1, 1, 1)).export(folder / "box.obj")
    with team_server(folder / "workspace", folder / "box.obj") as server:
        yield server


def refused(client: Client, method: str, path: str, body: object = None) -> int:
    with pytest.raises(ApiError) as caught:
        client.call(method, path, body)
    return caught.value.status


def kinds(server: Server) -> list[tuple[str, str]]:
    return [(e.who, e.kind) for e in server.app_state.store.history(1)]


# --- a role that may not


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/objects/1/reject", {"reason": "axis"}),
        ("POST", "/objects/1/accept", {}),
        ("POST", "/objects/1/reopen", {}),
        ("PUT", "/users/ann/role", {"role": "manager"}),
        ("POST", "/users", {"name": "eve", "role": "manager"}),
        ("POST", "/users/mia/disable", None),
        ("POST", "/assignments", {"objects": [1], "people": ["ann"]}),
        ("GET", "/audit", None),
        ("GET", "/audit/decisions", None),
        ("GET", "/users", None),
        ("POST", "/webhooks", {"url": "https://example.org", "events": ["object.accepted"]}),
    ],
)
def test_an_annotator_gets_no_higher_role_through_the_api(
    server: Server, method: str, path: str, body: object
) -> None:
    assert refused(token_client(server, "ann", "read", "annotate"), method, path, body) == 403
    browser = Browser(server)
    browser.log_in("ann")
    assert browser.api(method, path, body)[0] == 403
    assert server.app_state.store.people.accounts.find("ann").role == "annotator"


@pytest.mark.parametrize("kind", ["accept", "reject", "reopen", "saved", "record_segmentation"])
def test_decisions_and_results_of_jobs_are_no_commands_of_a_script(
    server: Server, kind: str
) -> None:
    mia = token_client(server, "mia", "read", "annotate", "review", "manage")
    assert refused(mia, "POST", "/objects/1/commands", {"command": {"kind": kind}}) == 422
    click = {"kind": "add_click", "click": {"position": [0, 0, 0], "part": 1}, "answer": None}
    assert refused(mia, "POST", "/objects/1/commands", {"command": click}) == 422


def test_a_token_that_reads_changes_nothing(server: Server) -> None:
    reader = token_client(server, "mia", "read")
    body = {"command": {"kind": "set_category", "category": "Oven"}}
    for path in ("/objects/1/commands", "/objects/1/undo", "/objects/1/submit", "/next"):
        assert refused(reader, "POST", path, body) == 403
    assert refused(reader, "PUT", "/users/ann/role", {"role": "reviewer"}) == 403


def test_messages_of_a_browser_give_no_other_name_and_no_higher_role(server: Server) -> None:
    ann, rob = Browser(server), Browser(server)
    ann.log_in("ann")
    rob.log_in("rob")
    tab = WebTab(ann, memory="rob\n1\n\n\n\nyes")
    wait_until(lambda: any("ann · annotator" in t for t in tab.texts()), "the panel", 60)
    assert not any(t == "Your name" for t in tab.texts()), "there is no box to type a name into"
    wait_until(lambda: any(t.startswith("**box**") for t in tab.texts()), "the object", 60)
    before = kinds(server)
    tab.press("Reject (X)")
    wait_until(lambda: any("Why reject" in t for t in tab.texts()), "the question", 60)
    tab.press("Reason", "1 range")
    wait_until(lambda: any("only a reviewer" in t for t in tab.texts()), "a refusal", 60)
    assert kinds(server) == before
    tab.close()
    server.app_state.store.people.work.leave(1, server.app_state.store.people.accounts.find("ann"))
    # The same messages of a reviewer do reject it, so the test would see it.
    tab = WebTab(rob, memory="ann\n1\n\n\n\nyes")
    wait_until(lambda: any(t.startswith("**box**") for t in tab.texts()), "the object", 60)
    tab.press("Reject (X)")
    wait_until(lambda: "Cancel rejection (Esc)" in tab.texts(), "the question for a reason", 60)
    tab.press("Reason", "1 range")
    wait_until(lambda: ("rob", "reject") in kinds(server), "a rejection", 60)
    tab.close()


def test_malformed_messages_of_a_browser_are_a_line_of_the_log_each(server: Server, caplog) -> None:
    caplog.set_level("WARNING", logger="app")
    browser = Browser(server)
    browser.log_in("mia")
    tab = WebTab(browser)

    def press(value: str) -> str:
        tab.send("ArtiworldPressMessage", action="bulk", value=value)
        return caplog.text

    wait_until(lambda: "ready" in press("ready"), "the panels", 120)
    pressed = [
        (action, value)
        for action in ("bulk", "open", "look", "pad", "people", "step", "theme", "nothing")
        for value in ("", "{", "[1", '{"ids": 7}', "x" * 5000, "1e999", "[[]]", "\ud7ff")
    ]
    for action, value in pressed:
        tab.send("ArtiworldPressMessage", action=action, value=value)
    for uuid in list(tab.widgets)[:20]:
        tab.send("GuiUpdateMessage", uuid=uuid, updates={"nothing": 1})
    press("the last")
    wait_until(lambda: "the last" in caplog.text, "the last one", 120)
    assert [r.getMessage() for r in caplog.records if r.exc_info or r.levelname == "ERROR"] == []
    assert not any("Internal error" in text for text in tab.texts())
    tab.close()


def test_anothers_object_is_not_changed(server: Server) -> None:
    people = server.app_state.store.people
    people.work.assign([1], [people.accounts.find("bob")], "mia")
    ann = token_client(server, "ann", "read", "annotate")
    body = {"command": {"kind": "set_category", "category": "Safe"}}
    for path in ("commands", "undo", "redo", "submit"):
        assert refused(ann, "POST", f"/objects/1/{path}", body) in (403, 409)
    assert server.app_state.store.object(1).category != "Safe"
    people.work.assign([1], [], "mia")


# --- stale and stolen proofs


def test_stale_and_made_up_proofs_are_nobody(server: Server) -> None:
    url = f"http://127.0.0.1:{server.viser.get_port()}"
    people = server.app_state.store.people
    bob = people.accounts.find("bob")
    token = people.credentials.make_token(bob, "old", ["read"])
    session = people.credentials.begin_session(bob)
    people.credentials.revoke(bob, "mia")
    for bad in (token, session, "awt_" + "x" * 43, "", "mia"):
        assert refused(Client(url, bad), "GET", "/me") == 401
    browser = Browser(server)
    browser.cookie = f"artiworld_{browser.port}={session}"
    assert browser.api("GET", "/me")[0] == 401
    assert browser.ask("GET", "/")[0] == 303
    with pytest.raises(InvalidStatus):
        WebTab(browser)
    browser.log_in("bob")
    assert browser.api("GET", "/me", Authorization="Bearer wrong")[0] == 401, "no cookie helps"


def test_a_cookie_is_no_token_and_a_token_no_cookie(server: Server) -> None:
    browser = Browser(server)
    browser.log_in("bob")
    assert browser.cookie is not None
    secret = browser.cookie.partition("=")[2]
    assert refused(Client(f"http://127.0.0.1:{browser.port}", secret), "GET", "/me") == 401
    people = server.app_state.store.people
    token = people.credentials.make_token(people.accounts.find("bob"), "script", ["read"])
    browser.cookie = f"artiworld_{browser.port}={token}"
    assert browser.api("GET", "/me")[0] == 401


def test_a_revoked_session_ends_an_open_tab(server: Server) -> None:
    browser = Browser(server)
    browser.log_in("bob")
    tab = WebTab(browser)
    wait_until(lambda: tab.widgets, "the panel", 60)
    mia = token_client(server, "mia", "read", "manage")
    mia.call("POST", "/users/bob/revoke", {})
    assert tab.closed.wait(20), "the connection ends by itself"
    with pytest.raises(InvalidStatus):
        WebTab(browser)


def test_a_changed_role_ends_an_open_tab_which_comes_back_with_the_new_one(server: Server) -> None:
    people, browser = server.app_state.store.people, Browser(server)
    people.accounts.add("ivy", "manager", PASSWORD)
    browser.log_in("ivy")
    tab = WebTab(browser)
    wait_until(lambda: any("ivy · manager" in t for t in tab.texts()), "the panel", 60)
    people.accounts.set_role("ivy", "annotator", "mia")
    assert tab.closed.wait(20)
    again = WebTab(browser)
    wait_until(lambda: any("ivy · annotator" in t for t in again.texts()), "the panel", 60)
    again.close()


def test_a_token_makes_no_token_and_no_password(server: Server) -> None:
    ann = token_client(server, "ann", "read", "annotate")
    assert refused(ann, "POST", "/tokens", {"label": "x", "scopes": ["read"]}) == 403
    assert refused(ann, "POST", "/password", {"old": PASSWORD, "new": "another one"}) == 403


def test_nobody_revokes_anothers_token(server: Server) -> None:
    people = server.app_state.store.people
    people.credentials.make_token(people.accounts.find("rob"), "rob's", ["read"])
    (theirs,) = [t for t in people.credentials.tokens() if t.label == "rob's"]
    ann = token_client(server, "ann", "read", "annotate")
    assert refused(ann, "DELETE", f"/tokens/{theirs.id}") == 403
    browser = Browser(server)
    browser.log_in("ann")
    assert browser.api("DELETE", f"/tokens/{theirs.id}")[0] == 404
    assert all(t["account"] == "ann" for t in ann.call("GET", "/tokens"))


# --- other sites' pages


@pytest.mark.parametrize(
    "headers",
    [
        {"own": False},
        {"own": False, "Origin": "http://evil.example"},
        {"own": True, "Origin": "http://evil.example"},
        {"own": True, "Origin": "null"},
        {"own": True, "Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "cors"},
    ],
)
def test_another_sites_page_changes_nothing_with_the_cookie(server: Server, headers) -> None:
    browser = Browser(server)
    browser.log_in("mia")
    before = server.app_state.store.people.accounts.find("ann")
    status, _ = browser.api("PUT", "/users/ann/role", {"role": "manager"}, **headers)
    assert status == 403
    assert server.app_state.store.people.accounts.find("ann") == before
    assert browser.api("POST", "/login", {"name": "ann", "password": PASSWORD}, **headers)[0] == 403


# --- logins


def test_no_answer_tells_which_names_there_are(server: Server) -> None:
    people = server.app_state.store.people
    people.accounts.invite("not yet here", "annotator")
    people.accounts.add("left us", "annotator", PASSWORD)
    people.accounts.disable("left us")
    answers = set()
    for name in ("ann", "nobody", "not yet here", "left us"):
        body = {"name": name, "password": "a wrong password"}
        status, answer = Browser(server).api("POST", "/login", body)
        answers.add((status, json.dumps(answer)))
    assert answers == {(401, '{"error": "Name or password is wrong."}')}
    right = {"name": "left us", "password": PASSWORD}
    assert Browser(server).api("POST", "/login", right)[1] == {
        "error": "Name or password is wrong."
    }
    assert Browser(server).api("GET", "/users")[0] == 401


def test_names_that_nobody_has_are_not_kept(server: Server) -> None:
    Browser(server).log_in("my secret password by mistake", "x")
    newest = server.app_state.store.people.audit.events(kind="login_failed", count=1)[0]
    assert newest.subject == "unknown name" and newest.address == "127.0.0.1"


@pytest.mark.parametrize(
    ("trusted", "said"),
    [((), "127.0.0.1"), (("10.0.0.0/8",), "127.0.0.1"), (("127.0.0.0/8",), "203.0.113.7")],
)
def test_only_a_trusted_proxy_says_who_asks(tmp_path, trusted, said) -> None:
    with team_server(tmp_path, trusted_proxies=trusted) as server:
        body = {"name": "ann", "password": "a wrong password"}
        # The visitor made the first address up, the proxy added the second.
        Browser(server).api("POST", "/login", body, X_Forwarded_For="192.0.2.1, 203.0.113.7")
        events = server.app_state.store.people.audit.events(kind="login_failed", count=1)
        assert events[0].address == said


def test_guessing_is_stopped_by_address_and_by_name(tmp_path, monkeypatch) -> None:
    store = Store(tmp_path)
    add_people(store)
    monkeypatch.setattr(store.people.accounts, "check", lambda *_: None)
    door = entrance.Entrance(store.people, entrance.Login(None))
    for k in range(GUESSES):
        with pytest.raises(ConfigurationError, match="is wrong"):
            door.log_in("ann", f"guess {k}", f"10.0.0.{k}")
    with pytest.raises(entrance.TooManyAttempts):
        door.log_in("Ann", PASSWORD, "10.0.1.1")
    with pytest.raises(ConfigurationError, match="is wrong"):
        door.log_in("rob", PASSWORD, "10.0.1.1")
    store.close()


# --- large and slow requests


def test_a_large_request_is_refused_before_it_is_read(server: Server) -> None:
    browser = Browser(server)
    browser.log_in("ann")
    status, answer = browser.api("POST", "/objects/1/commands", {"command": {"kind": "x" * 2**20}})
    assert status == 413 and "larger" in answer["error"]


@pytest.mark.parametrize(
    "raw",
    [
        b"POST /api/v1/login HTTP/1.1\r\nHost: evil.example\r\nContent-Length: 0\r\n\r\n",
        b"POST /api/v1/login HTTP/1.1\r\nHost: a\r\nHost: b\r\nContent-Length: 0\r\n\r\n",
        b"GET /api/v1/../login HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET /api/v1/me HTTP/1.1\r\nHost: localhost\r\nContent-Length: -1\r\n\r\n",
        b"GET /api/v1/me HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
    ],
)
def test_odd_requests_neither_pass_nor_break_the_api(server: Server, raw: bytes) -> None:
    port = server.viser.get_port()
    with socket.create_connection(("127.0.0.1", port), timeout=10) as connection:
        connection.sendall(raw)
        assert b" 200 " not in connection.recv(200)
    assert Browser(server).log_in("rob") == 200


def test_a_connection_of_the_api_is_not_kept_for_the_pages(server: Server) -> None:
    request = b"GET /api/v1/me HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with socket.create_connection(("127.0.0.1", server.viser.get_port()), timeout=10) as connection:
        connection.sendall(request + request)
        answer = b""
        while block := connection.recv(4096):
            answer += block
    assert answer.count(b"HTTP/1.1 401") == 1 and b"connection: close" in answer.lower()


# --- webhooks


@pytest.mark.parametrize(
    "address",
    [
        *"127.0.0.1 10.1.2.3 172.16.0.1 192.168.1.1 169.254.169.254 0.0.0.0 100.64.0.1".split(),
        *"224.0.0.1 255.255.255.255 ::1 :: fe80::1 fc00::1 ::ffff:127.0.0.1".split(),
        *"64:ff9b::7f00:1 2002:7f00:1:: ff02::1".split(),
    ],
)
def test_special_addresses_are_not_public(address: str) -> None:
    assert not is_public(ipaddress.ip_address(address))
    host = f"[{address}]" if ":" in address else address
    with pytest.raises(ConfigurationError, match="public"):
        check_url(f"http://{host}/hook")


@pytest.mark.parametrize("address", ["93.184.215.14", "2606:2800:21f:cb07:6820:80da:af6b:8b2c"])
def test_public_addresses_are(address: str) -> None:
    assert is_public(ipaddress.ip_address(address))


URLS = "ftp://example.org file:///etc/passwd http:// http://a:b@localhost x http://localhost:99999"


@pytest.mark.parametrize(
    "url", [*URLS.split(), "http://2130706433/", "http://127.1/", "http://0x7f.1/"]
)
def test_odd_addresses_of_webhooks_are_refused(server: Server, url: str) -> None:
    mia = token_client(server, "mia", "read", "manage")
    body = {"url": url, "events": ["object.accepted"]}
    assert refused(mia, "POST", "/webhooks", body) == 400


def test_a_name_that_leads_to_this_machine_later_gets_nothing(
    receiver, hooked, monkeypatch
) -> None:
    """It was public when it was added; each delivery looks again and connects to what it saw."""
    store, secret = hooked
    delivery = store.people.webhooks.claim()
    send(store.people.webhooks, delivery)
    assert receiver.heard == []
    assert "public" in store.people.webhooks.all()[0].problem
    assert secret


def test_a_delivery_is_signed_once_and_redirects_are_not_followed(receiver, hooked) -> None:
    store, secret = hooked
    hooks = store.people.webhooks
    delivery = hooks.claim()
    assert hooks.claim() is None, "no other server sends it at the same time"
    receiver.status = 302
    send(hooks, delivery, allowed=lambda _: True)
    assert len(receiver.heard) == 1, "the place that it names isn't asked"
    (hook,) = hooks.all()
    assert (hook.waiting, hook.problem) == (1, "the receiver answered 302")
    receiver.status = 204
    send(hooks, delivery, allowed=lambda _: True)
    assert hooks.all()[0].waiting == 0
    headers, body = receiver.heard[-1]
    message = json.loads(body)
    assert (message["event"], message["object"], message["who"]) == ("object.rejected", 1, "rob")
    header = headers["X-ArtiWorld-Signature"]
    assert is_genuine(secret, header, body)
    assert not is_genuine(secret, header, body + b" ")
    assert not is_genuine("another secret", header, body)
    at = int(header.partition(",")[0].removeprefix("t="))
    assert not is_genuine(secret, header, body, now=at + 301.0), "it can't be played again later"
    assert signature(secret, body, at) == header


def test_a_webhook_is_retried_ever_later_and_given_up(hooked) -> None:
    store, _ = hooked
    hooks = store.people.webhooks
    delivery = hooks.claim()
    for attempt in range(MOST_ATTEMPTS):
        assert delivery.attempts == attempt + 1 and (hooks.all()[0].failed == 0) == (attempt < 7)
        hooks.failed(delivery, "no answer")
        assert hooks.claim() is None, "it waits"
        with closing(sqlite3.connect(store.workspace / "artiworld.db")) as database, database:
            database.execute("UPDATE deliveries SET due = ''")
        delivery = hooks.claim() or delivery
    assert (hooks.all()[0].waiting, hooks.all()[0].failed) == (0, 1)


class Receiver:
    """A web server that notes what it is sent."""

    def __init__(self) -> None:
        self.heard: list[tuple[dict[str, str], bytes]] = []
        self.status = 204
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                outer.heard.append((dict(self.headers), body))
                self.send_response(outer.status)
                self.send_header("Location", "/elsewhere")
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self.http = HTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.http.serve_forever, daemon=True).start()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    out = Receiver()
    yield out
    out.http.shutdown()
    out.http.server_close()


@pytest.fixture
def hooked(tmp_path, receiver: Receiver) -> Iterator[tuple[Store, str]]:
    """A workspace with a webhook at the receiver, and a rejection to tell it of."""
    store = Store(tmp_path)
    add_people(store)
    url = f"http://localhost:{receiver.http.server_port}/hook"
    mia = store.people.accounts.find("mia")
    secret = store.people.webhooks.add(mia, url, ["object.rejected"], "mia")
    live = LiveSession(store, store.open_object(Path("/scans/oven.ply"), None, "oven").id)
    live.do(Reject("axis"), "rob")
    yield store, secret
    store.close()
