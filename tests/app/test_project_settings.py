"""A project's settings: who may change them, what they change, and how text is made safe."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from app.client import ApiError, Client
from app.server.server import Server
from app.viewer.tab import markdown_html
from app.viewer.words import project, queue
from model.core.errors import ConfigurationError
from model.validation.report import KINDS
from sessions.project_settings import ProjectSettings, labels_from_text, labels_to_text
from tests.app.api_server import team_server, token_client
from tests.app.run_cli import artiworld, assert_users_mistake
from tests.builders import wait_until, write_cupboard


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("project")
    paths = (write_cupboard(folder / "cupboard"),)
    with team_server(folder / "workspace", *paths, predictor="geometric") as server:
        yield server


@pytest.fixture
def mia(server: Server) -> Client:
    return token_client(server, "mia", "read", "annotate", "review", "manage")


def test_only_managers_change_settings_and_the_record_says_so(server: Server, mia: Client) -> None:
    ann = token_client(server, "ann", "read", "annotate")
    with pytest.raises(ApiError, match="scope manage"):
        ann.call("PATCH", "/project", {"settings": {"name": "mine"}})
    settings = {"name": "Kitchens", "instructions": "Click the *front*."}
    assert mia.call("PATCH", "/project", {"settings": settings})["name"] == "Kitchens"
    assert ann.call("GET", "/project")["instructions"] == "Click the *front*."
    event = mia.call("GET", "/audit", kind="project_changed")[0]
    assert (event["who"], event["detail"]) == ("mia", "name, instructions")
    for wrong, said in (
        ({"colour": "red"}, "unknown field 'colour'"),
        ({"formats": ["vhs"]}, "formats"),
        ({"required": ["luck"]}, "expected one of geometry"),
        ({"strict": True}, "give labels"),
        ({"labels": [{"category": "Oven"}, {"category": "oven"}]}, "there twice"),
        ({"labels": [{"category": "Oven, Stove"}]}, "neither comma nor colon"),
        ({"instructions": "x" * 20_001}, "at most 20000"),
    ):
        with pytest.raises(ApiError, match=said):
            mia.call("PATCH", "/project", {"settings": wrong})
    assert mia.call("GET", "/project")["labels"] == []


def test_strict_labels_and_required_checks_prevent_acceptance(server: Server, mia: Client) -> None:
    id = mia.call("GET", "/objects")["objects"][0]["id"]
    wait_until(lambda: server.app_state.object(id).asset is not None, "read", 60)
    mia.command(id, kind="set_category", category="Ovenn")
    mia.command(id, kind="name_part", part=1, name="dor")
    wait_until(lambda: mia.object(id)["segmented"], "parts", 60)
    mia.predict(id)

    def kinds() -> set[tuple[str, str, str]]:
        joints = mia.call("GET", f"/objects/{id}/checks")["report"]["joints"]
        found = [(j["child"], f) for j in joints for f in j["findings"] if f["kind"] == "name"]
        return {(child, f["verdict"], f["sentence"]) for child, f in found}

    assert kinds() == set()
    labels = [{"category": "Cupboard", "parts": ["door", "shelf"]}]
    mia.call("PATCH", "/project", {"settings": {"labels": labels, "strict": True}})
    broken = {("link_0", "broken"), ("link_1", "broken")}
    assert {(child, verdict) for child, verdict, _ in kinds()} == broken
    with pytest.raises(ApiError, match="error"):
        mia.accept(id, warnings_seen=True)
    mia.call("PATCH", "/project", {"settings": {"required": ["name"]}})
    with pytest.raises(ApiError, match="The project requires this check"):
        mia.accept(id, override="I like it", warnings_seen=True)
    mia.command(id, kind="set_category", category="cupboard")
    mia.command(id, kind="name_part", part=1, name="Door")
    assert kinds() == set(), "case doesn't count"
    joint = {k: v for k, v in mia.object(id)["joints"][0].items() if k != "confidence"}
    mia.command(id, kind="set_joint", joint=joint | {"lower": -0.5, "upper": 1.0})
    mia.call("PATCH", "/project", {"settings": {"required": ["limits"]}})
    with pytest.raises(ApiError, match="The project requires this check"):
        mia.accept(id, override="I like it", warnings_seen=True)
    with pytest.raises(ApiError, match="The project requires this check"):
        mia.submit(id)
    mia.call("PATCH", "/project", {"settings": {"required": []}})
    assert mia.accept(id, override="a test", warnings_seen=True)["review"]["state"] == "accepted"


def test_labels_are_written_and_read_as_lines() -> None:
    text = "Oven: door, knob\nTable"
    settings = ProjectSettings().changed({"labels": labels_from_text(f"{text}\n\n")})
    assert labels_to_text(settings.labels) == text
    assert settings.part_names("oven") == ("door", "knob")
    strict = settings.changed({"strict": True})
    assert strict.knows_part("Knob", "Oven") and not strict.knows_part("lid", "Oven")
    assert not strict.knows_category("Chair") and settings.knows_category("Chair")
    with pytest.raises(ConfigurationError, match="needs letters"):
        settings.changed({"labels": labels_from_text(": door")})


def test_instructions_run_nothing_and_load_nothing() -> None:
    html = markdown_html(
        "# Title\n<script>alert(1)</script> ![x](https://example.org/a.png) "
        "[good](https://example.org) [bad](javascript:alert(1)) [worse](data:text/html,x) "
        "<img src=x onerror=alert(1)>\n\n|a|b|\n|-|-|\n|1|2|"
    )
    assert "<h1>Title</h1>" in html and "<table>" in html
    assert "<script" not in html and "<img" not in html
    assert 'href="https://example.org"' in html and html.count("href=") == 1
    assert 'rel="noopener noreferrer nofollow"' in html


def test_the_dialogs_offer_all_there_is() -> None:
    assert set(project.KINDS) == set(KINDS)
    for collision in queue.COLLISIONS.values():
        assert ProjectSettings().changed({"collision": collision}).collision == collision


def test_the_command_line_shows_and_sets(tmp_path: Path) -> None:
    workspace = tmp_path / "workspace"
    assert_users_mistake(artiworld("project", workspace), str(workspace), "no workspace")
    with team_server(workspace, write_cupboard(tmp_path / "cupboard"), accounts=False):
        pass
    labels = tmp_path / "labels.txt"
    labels.write_text("Oven: door, knob\n")
    words = f"project set {workspace} --name Kitchens --labels {labels} --strict"
    artiworld(*words.split(), *"--require floating,collision --format mjcf,usd".split())
    shown = artiworld("project", workspace).stdout
    assert "Kitchens" in shown and "Oven: door, knob" in shown and "floating" in shown
    assert_users_mistake(artiworld("project", "set", workspace, "--format", "vhs"), "vhs")
    assert_users_mistake(artiworld("project", "set", workspace), "nothing to change")
