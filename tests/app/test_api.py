"""The REST API on a running server, by its own client, and by a browser's requests."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import trimesh

from app.client import ApiError, Client
from app.server.server import Server
from tests.app.api_server import Browser, team_server, token_client
from tests.builders import wait_until, write_cupboard


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("team")
    trimesh.creation.box((1, 1, 1)).export(folder / "box.obj")
    with team_server(
        folder / "workspace", write_cupboard(folder / "cupboard"), folder / "box.obj"
    ) as server:
        yield server


@pytest.fixture
def ann(server: Server) -> Client:
    return token_client(server, "ann", "read", "annotate")


@pytest.fixture
def rob(server: Server) -> Client:
    return token_client(server, "rob", "read", "annotate", "review")


def test_predict_submit_send_back_correct_accept_download(
    server: Server, ann: Client, rob: Client, tmp_path: Path
) -> None:
    (found,) = ann.objects(search="cupboard")
    id = found["id"]
    ann.command(id, kind="set_category", category="StorageFurniture")
    wait_until(lambda: ann.object(id)["segmented"] and ann.object(id)["elements"], "parts", 60)
    (joint,) = ann.predict(id)["joints"]
    assert ann.submit(id, "please check")["review"]["state"] == "submitted"
    assert [o["id"] for o in rob.objects(state="submitted")] == [id]
    assert rob.next() == id
    back = rob.reject(id, "range", "opens too far", joint=joint["child"], place=(0.1, 0.2, 0.3))
    said = {"state": "rejected", "by": "rob", "reason": "range", "comment": "opens too far"}
    said |= {"at": "", "problems": [], "override": "", "decided_at": "", "joint": joint["child"]}
    assert back["review"] | {"at": ""} == said | {"place": [0.1, 0.2, 0.3]}
    assert ann.next() == id, "what came back comes first"
    smaller = {k: v for k, v in joint.items() if k != "confidence"}
    smaller["upper"] = joint["lower"] + 0.5 * (joint["upper"] - joint["lower"])
    changed = ann.command(id, kind="set_joint", joint=smaller)
    assert changed["joints"][0]["upper"] == smaller["upper"]
    ann.submit(id)
    checks = rob.call("GET", f"/objects/{id}/checks")
    assert checks["report"] is not None
    done = rob.accept(id, "fine", override="a test", warnings_seen=True)
    assert (done["review"]["state"], done["review"]["by"]) == ("accepted", "rob")
    listed = rob.call("GET", "/assets")
    assert [a["id"] for a in listed["assets"]] == [id]
    for format, suffix in (("asset", ".urdf"), ("mjcf", ".xml")):
        with zipfile.ZipFile(ann.download(id, tmp_path / f"{format}.zip", format)) as archive:
            assert archive.testzip() is None
            assert any(name.endswith(suffix) for name in archive.namelist())
    history = ann.call("GET", f"/objects/{id}/commands")
    kinds = [(e["who"], e["command"]["kind"]) for e in history]
    mia = token_client(server, "mia", "read", "manage")
    decided = mia.call("GET", "/audit/decisions", object=id, kind="reject")
    assert [(d["who"], d["name"]) for d in decided] == [("rob", "cupboard")]
    figures = {row["person"]: row for row in mia.call("GET", "/statistics")}
    assert figures["rob"]["accepted"] == 1 and figures["ann"]["commands"] >= 4
    for expected in (("ann", "submit"), ("rob", "reject"), ("ann", "set_joint"), ("rob", "accept")):
        assert expected in kinds


def test_upload_undo_and_filters(ann: Client, rob: Client, tmp_path: Path) -> None:
    trimesh.creation.icosphere(2).export(tmp_path / "ball.stl")
    ball = ann.upload(tmp_path / "ball.stl")
    assert (ball["name"], ball["state"]) == ("ball", "todo")
    ann.command(ball["id"], kind="set_category", category="Globe")
    ann.command(ball["id"], kind="add_part", part=1, name="knob")
    assert [p["name"] for p in ann.object(ball["id"])["parts"]] == [None, "knob"]
    assert len(ann.undo(ball["id"])["parts"]) == 1
    assert len(ann.call("POST", f"/objects/{ball['id']}/redo", {})["parts"]) == 2
    assert [o["id"] for o in ann.objects(category="Globe")] == [ball["id"]]
    assert list(ann.objects(category="Globe", state="todo")) == []
    assert {o["name"] for o in ann.objects()} >= {"cupboard", "box", "ball"}
    again = ann.upload(tmp_path / "ball.stl", "globe.stl")
    first, second = ann.object(ball["id"]), ann.object(again["id"])
    assert not {"path", "sha256"} & {*first, *second}, "nothing marks a second annotation"


def test_wrong_requests_say_what_would_be_right(ann: Client, tmp_path: Path) -> None:
    def refused(*call: object, **settings: object) -> tuple[int, str]:
        with pytest.raises(ApiError) as caught:
            ann.call(*call, **settings)  # type: ignore[arg-type]
        return caught.value.status, str(caught.value)

    assert refused("GET", "/objects/999")[0] == 404
    assert refused("GET", "/objects/one")[0] == 422
    status, text = refused("POST", "/objects/1/commands", {"command": {"kind": "saved"}})
    assert status == 422 and "add_click" in text
    bad = {"command": {"kind": "set_category", "category": "x" * 100}}
    assert refused("POST", "/objects/1/commands", bad)[0] == 409
    late = {"command": {"kind": "set_category", "category": "Oven"}, "expected_seq": 99}
    status, text = refused("POST", "/objects/1/commands", late)
    assert status == 409 and "not 99" in text
    assert refused("GET", "/assets/2", format="word")[0] == 422
    assert refused("GET", "/assets/2")[0] == 404
    assert refused("POST", "/objects", b"nothing of ours", name="a.exe")[0] == 400
    assert refused("GET", "/nothing") == (404, "not found")


def test_the_documentation_needs_no_other_server(server: Server) -> None:
    browser = Browser(server)
    assert browser.api("GET", "/openapi.json")[0] == 401, "strangers see no description"
    browser.log_in("ann")
    status, description = browser.api("GET", "/openapi.json")
    assert status == 200 and "/api/v1/objects/{object_id}/commands" in description["paths"]
    status, page = browser.api("GET", "/docs")
    assert status == 200 and b"://" not in page
    for name in (b"swagger-ui-bundle.js", b"swagger-ui.css"):
        assert name in page
        status, content = browser.api("GET", f"/docs/{name.decode()}")
        assert status == 200 and len(content) > 10_000
    assert browser.api("GET", "/docs/..%2f..%2fpyproject.toml")[0] == 404


def test_people_come_by_invitation_and_change_their_password(server: Server) -> None:
    mia, new = Browser(server), Browser(server)
    mia.log_in("mia")
    status, invited = mia.api("POST", "/users", {"name": "zoe", "role": "reviewer"})
    assert status == 201 and invited["path"].startswith("/login#invitation=")
    code = {"code": invited["code"]}
    assert new.api("POST", "/invitation", code) == (200, {"name": "zoe", "role": "reviewer"})
    assert new.api("POST", "/invitation/accept", code | {"password": "short"})[0] == 400
    assert new.api("POST", "/invitation/accept", code | {"password": "a long password"})[0] == 200
    assert new.api("GET", "/me")[1]["scopes"] == ["annotate", "read", "review"]
    other = Browser(server)
    assert other.log_in("ZOE", "a long password") == 200
    body = {"old": "wrong", "new": "another password"}
    assert new.api("POST", "/password", body)[0] == 401
    assert new.api("POST", "/password", body | {"old": "a long password"})[0] == 200
    assert other.api("GET", "/me")[0] == 401, "the other browser is logged out"
    assert new.api("GET", "/me")[0] == 200
    assert new.api("POST", "/logout", {})[0] == 200
    assert new.api("GET", "/me")[0] == 401
    kinds = [e["kind"] for e in mia.api("GET", "/audit?name=zoe")[1]]
    assert kinds == ["logout", "password_changed", "login", "login", "claimed", "invited"]


def test_work_is_assigned_in_turn(server: Server, ann: Client) -> None:
    mia = token_client(server, "mia", "read", "manage")
    given = mia.call("POST", "/assignments", {"objects": [1, 2], "people": ["ann", "bob"]})
    assert given["assigned"] == {"1": "ann", "2": "bob"}
    assert [o["id"] for o in ann.objects(assigned_to="bob")] == [2]
    bob = token_client(server, "bob", "read", "annotate")
    bob.command(2, kind="set_category", category="Box")
    with pytest.raises(ApiError, match=r"assigned to bob|bob works on"):
        ann.command(2, kind="set_category", category="Table")
    mia.call("POST", "/assignments", {"objects": [1, 2], "people": []})
    bob.call("POST", "/objects/2/leave", {})
    ann.command(2, kind="set_category", category="Table")
    ann.call("POST", "/objects/2/enter", {})
    here = bob.call("GET", "/objects/2/presence")
    assert [(p["name"], p["leased"]) for p in here] == [("ann", True)]
    ann.call("POST", "/objects/2/leave", {})


def test_tokens_are_made_in_a_browser_and_shown_once(server: Server) -> None:
    browser = Browser(server)
    browser.log_in("bob")
    body = {"label": "night", "scopes": ["read"], "days": 3}
    status, made = browser.api("POST", "/tokens", body)
    assert status == 201
    client = Client(f"http://127.0.0.1:{server.viser.get_port()}", made["token"])
    assert client.call("GET", "/me")["scopes"] == ["read"]
    mine = [t for t in browser.api("GET", "/tokens")[1] if t["label"] == "night"]
    assert made["token"] not in str(mine)
    assert browser.api("DELETE", f"/tokens/{mine[0]['id']}")[0] == 200
    with pytest.raises(ApiError) as caught:
        client.call("GET", "/me")
    assert caught.value.status == 401


def test_without_accounts_the_api_is_open_to_this_machine_or_to_the_token(tmp_path: Path) -> None:
    with team_server(tmp_path / "a", accounts=False, user="uwe") as server:
        client = Client(f"http://127.0.0.1:{server.viser.get_port()}")
        assert client.call("GET", "/me")["name"] == "uwe"
        assert Browser(server).ask("GET", "/")[0] == 200
        # Accounts that are made while it runs count within seconds.
        server.app_state.store.people.accounts.add("mia", "manager", "a long password")
        wait_until(lambda: Browser(server).ask("GET", "/")[0] == 303, "a login", 20)
        assert Browser(server).api("GET", "/me")[0] == 401
    with team_server(tmp_path / "b", accounts=False, token="a long token") as server:
        url = f"http://127.0.0.1:{server.viser.get_port()}"
        assert Client(url, "a long token").call("GET", "/me")["scopes"] != []
        for token in (None, "another token"):
            with pytest.raises(ApiError, match="log in"):
                Client(url, token).call("GET", "/me")
