"""Every route of the API, from its OpenAPI document: no value is the server's fault, no answer
takes long, and a token does what its scopes say.
"""

from __future__ import annotations

import errno
import io
import re
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.client import ApiError
from app.server import uploads
from app.server.acceptances import AssetDrafts
from app.server.api import guard, objects
from app.server.server import Server
from model.core.errors import NoSpaceError
from sessions.credentials import SCOPES_OF
from tests.app import job_functions as functions
from tests.app.api_server import Browser, team_server, token_client
from tests.builders import wait_until, write_cupboard

PEOPLE = ("nobody", "ann", "rob", "mia", "mia that reads")
NUMBERS = (0, 1, -1, 2**31 - 1, 2**31, 2**63, -(2**63) - 1, 10**30)
TEXTS = ("", "x", "\0", "é\u200b", "a" * 3000, "../..", "'; drop table objects", "NaN", "1e999")
MOST_SECONDS, LONGEST_ANSWER = 2.0, guard.ANSWER_SECONDS
ENDS = ("/login", "/logout", "/password", "/disable", "/revoke", "/role")
"""Routes that end what the others need."""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("routes")
    trimesh.creation.box((1, 1, 1)).export(folder / "box.ply")
    paths = write_cupboard(folder / "cupboard"), folder / "box.ply"
    with pytest.MonkeyPatch.context() as patch, team_server(folder / "w", *paths) as made:
        patch.setattr(guard, "ANSWER_SECONDS", 0.1)
        yield made


@pytest.fixture(scope="module")
def document(server: Server) -> dict[str, Any]:
    browser = Browser(server)
    browser.log_in("mia")
    return browser.api("GET", "/openapi.json")[1]


@pytest.fixture(scope="module")
def routes(document: dict[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    """Method, path and description of all."""
    return [
        (method.upper(), path.removeprefix("/api/v1"), about)
        for path, methods in document["paths"].items()
        for method, about in methods.items()
    ]


@pytest.fixture(scope="module")
def proofs(server: Server) -> dict[str, str]:
    """Header of each person."""
    out = {"nobody": ""}
    for who in PEOPLE[1:]:
        name, _, reads = who.partition(" that ")
        people = server.app_state.store.people
        account = people.accounts.find(name)
        scopes = {"read"} if reads else SCOPES_OF[account.role]
        out[who] = f"Bearer {people.credentials.make_token(account, 'test', scopes)}"
    return out


def body_of(schema: dict[str, Any], document: dict[str, Any], draw: Any) -> Any:
    """A value of a schema, or a wrong one."""
    while "$ref" in schema:
        schema = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
    if "anyOf" in schema:
        return body_of(draw(st.sampled_from(schema["anyOf"])), document, draw)
    if draw(st.integers(0, 19)) == 0:
        return draw(st.sampled_from([None, 7, "x", [], {}, 2**70, -1.5, True]))
    if "enum" in schema:
        return draw(st.sampled_from(schema["enum"]))
    kind = schema.get("type")
    if kind == "object":
        given = schema.get("properties") or {"kind": {}, "part": {"type": "integer"}}
        return {name: body_of(each, document, draw) for name, each in given.items()}
    if kind == "array":
        inner = schema.get("items") or (schema.get("prefixItems") or [{}])[0]
        return [body_of(inner, document, draw) for _ in range(draw(st.integers(0, 3)))]
    if kind == "integer":
        return draw(st.sampled_from(NUMBERS))
    if kind == "number":
        return draw(st.sampled_from([0.0, -1.0, 1e308, *NUMBERS]))
    if kind == "boolean":
        return draw(st.booleans())
    return draw(st.sampled_from([*TEXTS, "set_category", "add_click", "box", "ann", "read"]))


@settings(
    max_examples=150, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True
)
@given(data=st.data())
def test_no_value_of_anybody_is_the_servers_fault(server, document, routes, proofs, data) -> None:
    browser = Browser(server)
    wanted = [r for r in routes if not r[1].endswith(ENDS) and not r[1].startswith("/oidc")]
    method, path, about = data.draw(st.sampled_from(wanted))
    query = []
    for parameter in about.get("parameters", []):
        schema = parameter["schema"]
        kinds = {s.get("type") for s in schema.get("anyOf", [schema])}
        value = data.draw(st.sampled_from(NUMBERS if "integer" in kinds else TEXTS))
        if parameter["in"] == "path":
            path = path.replace(f"{{{parameter['name']}}}", _quoted(value) or "x")
        elif data.draw(st.booleans()):
            query.append(f"{parameter['name']}={_quoted(value)}")
    content = about.get("requestBody", {}).get("content", {}).get("application/json")
    body = body_of(content["schema"], document, data.draw) if content else None
    who = data.draw(st.sampled_from(PEOPLE))
    status, answer = (
        browser.api(
            method, path + ("?" + "&".join(query) if query else ""), body, Authorization=proofs[who]
        )
        if who != "nobody"
        else browser.api(method, path, body)
    )
    assert status < 500, (who, method, path, query, body, answer)


def _quoted(value: object) -> str:
    return quote(str(value), safe="")


@pytest.mark.parametrize(
    "path",
    [
        f"{path}{value}"
        for path in (
            "/objects/", "/assets/", "/audit?before=", "/audit/decisions?first=",
            "/audit/decisions?object=", "/objects/1/commands?after=", "/objects?first=",
        )
        for value in (2**31, 2**63, 10**40, -1)
    ],
)  # fmt: skip
def test_numbers_that_no_database_holds_are_refused(server, proofs, path: str) -> None:
    status, answer = Browser(server).api("GET", path, Authorization=proofs["mia"])
    assert (status == 422 and "less than" in answer["error"]) or "greater" in answer["error"]


def test_numbers_of_webhooks_and_tokens_are_bounded(server, proofs) -> None:
    for path in (f"/webhooks/{2**63}", f"/tokens/{2**70}", "/webhooks/-1"):
        assert Browser(server).api("DELETE", path, Authorization=proofs["mia"])[0] == 422


# --- in time


def ask_all(
    server: Server, routes: list[Any], proofs: dict[str, str], id: int
) -> dict[str, tuple[int, float]]:
    """Status of every route about an object, and of every list, and the seconds that it takes
    longer than a trivial one that is asked beside it."""
    bodies = {
        "commands": {"command": {"kind": "set_category", "category": "Box"}},
        "regions": {"part": 1, "elements": [0, 1]},
        "comments": {"text": "so"}, "comments/{number}": {"done": True},
        "reject": {"reason": "axis"},
    }  # fmt: skip

    def ask(method: str, path: str, body: Any = None) -> tuple[int, float]:
        begun = time.monotonic()
        status, _ = Browser(server).api(method, path, body, Authorization=proofs["mia"])
        return status, time.monotonic() - begun

    out = {}
    for method, path, _ in routes:
        if "{object_id}" not in path and (method != "GET" or "{" in path or "/oidc" in path):
            continue
        tail = path.partition("}/")[2] or path
        body = bodies.get(tail, {}) if method in ("POST", "PUT") else None
        asked = path.replace("{object_id}", str(id)).replace("{number}", "1")
        with ThreadPoolExecutor(1) as pool:
            trivial = pool.submit(ask, "GET", "/me")
            status, seconds = ask(method, asked, body)
        out[f"{method} {tail}"] = status, seconds - trivial.result()[1]
    return out


@contextmanager
def all_held(workers: Iterable[Any], free: Path) -> Iterator[None]:
    """Workers that do nothing for others within the block: who waits for one waits for ever."""
    held = [worker.submit(functions.wait_for, free, priority=50) for worker in workers]
    try:
        yield
    finally:
        free.touch()
    for job in held:
        job.result(60)


def test_no_route_waits_whatever_an_object_is_in(
    server: Server, routes, proofs, tmp_path: Path
) -> None:
    state, mia = server.app_state, token_client(server, "mia", "read", "annotate", "review")
    trimesh.creation.box((3, 1, 1)).export(tmp_path / "unread.ply")
    (tmp_path / "broken.ply").write_bytes(b"ply\nnothing")
    trimesh.creation.box((3, 1, 2)).export(tmp_path / "gone.ply")
    names = ("unread", "broken", "gone")
    unread, broken, gone = state.queue.add([tmp_path / f"{name}.ply" for name in names])
    (tmp_path / "gone.ply").unlink()
    with all_held(state.workers.readers, tmp_path / "readers free"):
        found = {"unread": ask_all(server, routes, proofs, unread)}
    found["broken"] = ask_all(server, routes, proofs, broken)
    found["no parts"] = ask_all(server, routes, proofs, 2)
    for decision in ("todo", "predict", "submit", "reject", "accept"):
        with suppress(ApiError):  # the routes that were asked before decided it already
            mia.call("POST", f"/objects/1/{decision.replace('predict', 'prediction')}", {
                "reason": "axis", "override": "a test", "warnings_seen": True
            })  # fmt: skip
        found[decision] = ask_all(server, routes, proofs, 1)
    found["gone"] = ask_all(server, routes, proofs, gone)
    state.queue.remove(broken)
    lanes = [w for lane in state.workers.lanes for w in (lane.geometry, lane.segmentation)]
    others = (*state.workers.readers, state.workers.prediction, state.workers.saving)
    with all_held((*lanes, *others), tmp_path / "all free"):
        for name, id in (("busy", 1), ("busy and unread", unread), ("removed", broken)):
            found[name] = ask_all(server, routes, proofs, id)
    slow = {(s, r): a for s, of in found.items() for r, a in of.items() if a[1] > MOST_SECONDS}
    assert not slow and LONGEST_ANSWER < MOST_SECONDS
    assert found["unread"]["POST accept"][0] == 409, "it has no joints, and that is said at once"
    assert found["unread"]["POST regions"][0] == 202
    wrong = {(s, r): a for s, of in found.items() for r, a in of.items() if a[0] >= 500}
    assert not wrong


def test_long_work_is_a_job_of_who_asked(server, proofs, tmp_path: Path, monkeypatch) -> None:
    state, browser = server.app_state, Browser(server)
    trimesh.creation.box((4, 1, 1)).export(tmp_path / "late.ply")
    id = state.queue.add([tmp_path / "late.ply"])[0]
    free = tmp_path / "free"
    for reader in state.workers.readers:
        reader.submit(functions.wait_for, free, priority=50)
    body = {"part": 1, "elements": [0]}
    mia = {"Authorization": proofs["mia"]}
    status, answer = browser.api("POST", f"/objects/{id}/regions", body, **mia)
    assert status == 202
    path = f"/jobs/{answer['job']}"
    assert browser.api("GET", path, Authorization=proofs["rob"])[0] == 404
    assert browser.api("GET", path, **mia) == (202, answer)
    monkeypatch.setattr(guard, "MOST_JOBS", 4)
    assert browser.api("POST", f"/objects/{id}/regions", body, **mia)[0] == 429
    free.touch()
    monkeypatch.setattr(guard, "ANSWER_SECONDS", 30.0)
    status, after = browser.api("GET", path, **mia)
    assert status == 200 and after["prompts"], after
    assert browser.api("GET", path, **mia)[0] == 404, "it was handed over"


# --- scopes


def test_a_token_that_reads_changes_no_account(server, routes, proofs) -> None:
    reads = {"Authorization": proofs["mia that reads"]}
    browser = Browser(server)
    people = server.app_state.store.people
    before = people.credentials.tokens()
    for token in before:
        assert browser.api("DELETE", f"/tokens/{token.id}", **reads)[0] == 403
    assert people.credentials.tokens() == before
    for method, path, _ in routes:
        public = path.startswith(("/invitation", "/login", "/logout", "/oidc"))
        if method == "GET" or public:
            continue
        asked = re.sub(r"\{\w+\}", "1", path)
        status, answer = browser.api(method, asked, {}, **reads)
        assert status in (403, 422), (method, path, status, answer)


# --- a full disk


def test_an_upload_that_finds_no_room_is_refused_and_leaves_nothing(
    server: Server, tmp_path: Path, monkeypatch
) -> None:
    def full(*_: object) -> Any:
        raise OSError(errno.ENOSPC, "No space left on device")

    class Full(io.BytesIO):
        write = full

    ann = token_client(server, "ann", "read", "annotate")
    trimesh.creation.icosphere(5).export(tmp_path / "big.ply")
    for module, name, broken in (
        (uploads.shutil, "copyfileobj", full),
        (objects, "unnamed_file", full),
        (objects, "unnamed_file", lambda _: Full()),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, broken)
            with pytest.raises(ApiError, match="check space") as caught:
                ann.upload(tmp_path / "big.ply")
        assert caught.value.status == 507
    assert not [p for p in server.app_state.workspace.rglob("*big*") if p.is_file()]
    assert ann.upload(tmp_path / "big.ply")["name"] == "big"


def test_an_acceptance_that_finds_no_room_is_refused_at_once(
    server: Server, tmp_path: Path, monkeypatch
) -> None:
    state, rob = server.app_state, token_client(server, "rob", "read", "annotate", "review")
    (id,) = state.queue.add([write_cupboard(tmp_path / "second")])
    rob.command(id, kind="set_category", category="Cabinet")
    wait_until(lambda: rob.object(id)["segmented"], "its parts", 60)
    rob.predict(id)
    rob.submit(id)
    rob.call("GET", f"/objects/{id}/checks")

    def full(*_: object) -> None:
        raise NoSpaceError("artiworld.db", "no room is left on the disk")

    with monkeypatch.context() as patch:
        patch.setattr(state.store, "end_acceptance", full)
        saving = state.workers.saving
        patch.setattr(AssetDrafts, "finish", lambda *_: saving.submit(functions.no_room))
        with pytest.raises(ApiError, match="check space") as caught:
            rob.accept(id, override="a test", warnings_seen=True)
        assert id in state.store.pending_acceptances()
    assert caught.value.status == 507
    wait_until(lambda: id not in state.store.pending_acceptances(), "its end is stored", 30)
    assert rob.accept(id, override="a test", warnings_seen=True)["review"]["state"] == "accepted"
