"""Comments of reviewers: pinned, listed, done; and regions that a script marks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import trimesh

from app.client import ApiError, Client
from app.server.server import Server
from model.core.errors import CommandError
from sessions.commands import AddComment, Reject, ResolveComment, Undo
from sessions.document import CommentRecord
from sessions.serialise import state_from_json, state_to_json
from sessions.state import Context, SessionState, apply
from tests.app.api_server import Browser, WebTab, team_server, token_client
from tests.builders import wait_until, write_cupboard


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("comments")
    paths = (write_cupboard(folder / "cupboard"), folder / "lid.ply", folder / "box.ply")
    for path in paths[1:]:
        trimesh.creation.box((1, 1, 1)).export(path)
    with team_server(folder / "workspace", *paths, predictor="geometric") as server:
        yield server


@pytest.fixture
def ann(server: Server) -> Client:
    return token_client(server, "ann", "read", "annotate")


@pytest.fixture
def rob(server: Server) -> Client:
    return token_client(server, "rob", "read", "annotate", "review")


def test_a_reviewer_pins_and_an_annotator_ticks_off(ann: Client, rob: Client) -> None:
    id = ann.call("GET", "/objects")["objects"][0]["id"]
    ann.command(id, kind="set_category", category="Cupboard")
    wait_until(lambda: ann.object(id)["segmented"], "parts", 60)
    child = ann.predict(id)["joints"][0]["child"]
    with pytest.raises(ApiError, match="scope review"):
        ann.comment(id, "mine")
    with pytest.raises(ApiError, match="the comment is empty"):
        rob.comment(id, "  ")
    with pytest.raises(ApiError, match="no joint here"):
        rob.comment(id, "x", joint="link_7")
    before = ann.object(id)["review"]["state"]
    assert rob.comment(id, "a knob is missing", place=(0.1, 0.2, 0.3))["review"]["state"] == before
    rob.reject(id, "range", "too far", joint=child)
    first, second = ann.object(id)["comments"]
    assert (first["number"], first["text"], first["place"]) == (
        1,
        "a knob is missing",
        [0.1, 0.2, 0.3],
    )
    assert (second["by"], second["joint"], second["done"]) == ("rob", child, False)
    with pytest.raises(ApiError, match="only a reviewer may undo"):
        ann.undo(id)
    assert [c["done"] for c in ann.resolve(id, 1)["comments"]] == [True, False]
    assert [c["done"] for c in ann.resolve(id, 1, False)["comments"]] == [False, False]
    assert [c["done"] for c in ann.undo(id)["comments"]] == [True, False], "one's own mark"
    with pytest.raises(ApiError, match="there is no comment 9"):
        ann.resolve(id, 9)


def test_what_came_back_comes_first(server: Server, ann: Client, rob: Client) -> None:
    cupboard, lid, box = (o["id"] for o in ann.call("GET", "/objects")["objects"])
    ann.command(box, kind="add_part", part=1)
    rob.reject(box, "parts", "which ones?")
    if ann.object(cupboard)["state"] == "rejected":
        rob.call("POST", f"/objects/{cupboard}/reopen", {})

    def listed() -> list[int]:
        return [r["id"] for r in server.app_state.gallery.rows({"sort": "order"})["rows"]]

    wait_until(lambda: listed() == [box, cupboard, lid], "what came back stands first", 30)
    browser = Browser(server)
    assert browser.log_in("ann") == 200
    tab = WebTab(browser)
    try:
        app = wait_until(lambda: next(iter(server.apps.values()), None), "the tab", 60)
        shown = app.tab.selection
        wait_until(lambda: shown.object is not None, "an object", 60)
        assert shown.object.record.id == cupboard, "the first one that waits"
        app.tab.act(lambda: app.commands.step(1))
        wait_until(lambda: shown.object.record.id != cupboard, "another object", 60)
        assert shown.object.record.id == box, "what came back, before the next of the queue"
        app.tab.act(lambda: app.commands.step(1))
        wait_until(lambda: shown.object.record.id != box, "another object", 60)
    finally:
        tab.close()


def test_a_script_marks_a_region(server: Server, ann: Client) -> None:
    id = ann.call("GET", "/objects")["objects"][0]["id"]
    count = server.app_state.object(id).need_asset().element_count
    with pytest.raises(ApiError, match=f"from 0 to {count - 1}"):
        ann.add_region(id, 2, [0, count])
    with pytest.raises(ApiError, match="elements"):
        ann.add_region(id, 2, [])
    after = ann.add_region(id, 2, [1, 0, 1])
    assert (after["prompts"][-1]["part"], after["prompts"][-1]["count"]) == (2, 2)
    obj = server.app_state.object(id)
    wait_until(lambda: obj.document.segmentation_current and obj.labels is not None, "labels", 60)
    assert {int(v) for v in np.asarray(obj.labels)[:2]} == {2}


def test_comments_survive_snapshots_and_keep_their_numbers() -> None:
    rob, ann = Context("rob", "2026-01-01", "reviewer"), Context("ann", "2026-01-02", "annotator")
    state = apply(SessionState(), AddComment("one"), rob)
    state = apply(state, Reject("other", place=(1.0, 2.0, 3.0), listed=True), rob)
    state = apply(state, ResolveComment(2), ann)
    assert state.present.comments == (
        CommentRecord(1, "one", "", None, "rob", "2026-01-01"),
        CommentRecord(2, "other", "", (1.0, 2.0, 3.0), "rob", "2026-01-01", True),
    )
    assert state_from_json(state_to_json(state)) == state
    assert apply(state, ResolveComment(2), ann) is state, "it is done already"
    state = apply(state, Undo(), ann)
    with pytest.raises(CommandError, match="only a reviewer"):
        apply(state, AddComment("from an annotator"), ann)
    with pytest.raises(CommandError, match="only a reviewer"):
        apply(apply(SessionState(), AddComment("one"), rob), Undo(), ann)
