"""The project page, and objects assigned to people in the gallery, in a real browser."""

import csv
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import trimesh

import tests.accepted
from model.prediction.experience import in_use
from sessions.store import Store
from tests.accepted import accept, cupboard
from tests.browser.browsing import Tab, log_in, wait_until

PASSWORD = "three horses eat 42 apples"


@pytest.fixture
def paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Three boxes; anna accepted the first one today, and ben the second one yesterday."""
    monkeypatch.setattr(tests.accepted, "BEGIN", datetime.now(UTC) - timedelta(days=1, seconds=60))
    paths = [tmp_path / f"box_{k}.ply" for k in range(3)]
    for path in paths:
        trimesh.creation.box((0.4, 0.3, 0.2)).export(path)
    store = Store(tmp_path / "workspace")
    accept(store, paths[0], cupboard("Oven"), "anna", day=1)
    accept(store, paths[1], cupboard("Chair"), "<b>ben</b>", day=0)
    store.close()
    return paths


def open_project(tab: Tab) -> Any:
    tab.page.get_by_role("button", name="Project", exact=True).click()
    tab.page.locator(".aw-project ul").wait_for()
    return tab.page.locator(".aw-project")


def test_the_page_shows_the_project_and_leads_to_objects(
    paths: list[Path], start: Any, open_tab: Any
) -> None:
    tab: Tab = open_tab(start(*paths))
    page = open_project(tab)
    page.get_by_text("2 of 3 accepted (67 %)").wait_for()
    rows = page.locator("tbody tr")
    assert rows.count() == 1, "ben did nothing today"
    assert rows.locator("td").all_text_contents()[:5] == ["anna", "1", "1", "too few", "20 s"]
    assert page.locator("li b").all_text_contents() == ["box_0", "box_1"]
    assert page.get_by_text("<b>ben</b>", exact=False).count(), "names are no HTML"
    assert tab.page.locator(".mantine-Modal-content canvas").count() == 1, "the plot"
    with tab.page.expect_download() as download:
        page.get_by_role("button", name="Download CSV").click()
    with Path(download.value.path()).open(newline="") as file:
        assert [row["person"] for row in csv.DictReader(file)] == ["<b>ben</b>", "anna"]
    page.get_by_role("button", name="box_1", exact=False).click()
    wait_until(lambda: tab.object.record.name == "box_1", "the object is opened")
    page.first.wait_for(state="detached")
    open_project(tab)
    tab.page.keyboard.press("Escape")
    page.first.wait_for(state="detached")


def test_a_manager_assigns_objects_and_an_annotator_sees_only_their_own_figures(
    paths: list[Path], start: Any, open_page: Any
) -> None:
    store = Store(paths[0].with_name("workspace"))
    for name, role in (("mona", "manager"), ("anna", "annotator")):
        if any(a.name == name for a in store.people.accounts.all()):
            continue
        store.people.accounts.add(name, role, PASSWORD)  # type: ignore[arg-type]
    secret = store.people.accounts.invite("carl", "annotator")
    store.people.accounts.claim(secret, PASSWORD)
    store.close()
    server = start(*paths)

    def come(name: str) -> Tab:
        page = open_page(server.url)
        log_in(page, server, name, PASSWORD)
        return Tab(page, server).ready()

    tab = come("mona")
    page, work = tab.page, server.app_state.store.people.work
    page.get_by_role("button", name="Gallery or list").click()
    page.get_by_label("Select box_2").check()
    page.get_by_label("Person", exact=True).select_option("carl")
    page.get_by_role("button", name="Assign the selected objects").click()
    page.get_by_text("to do · → carl").wait_for()
    ids = {r.name: r.id for r in server.app_state.queue.records()}
    assert work.assigned() == {ids["box_2"]: "carl"}
    page.get_by_label("Person", exact=True).select_option(label="nobody")
    page.get_by_role("button", name="Assign the selected objects").click()
    wait_until(lambda: work.assigned() == {}, "it is nobody's again")

    tab = come("carl")
    tab.page.get_by_role("button", name="Gallery or list").click()
    tab.page.get_by_label("Select box_2").check()
    tab.page.get_by_text("1 selected").wait_for()
    assert not tab.page.get_by_label("Person", exact=True).is_visible()
    send = "(v) => window.__artiworldMarkup.send('bulk', v)"
    tab.page.evaluate(send, f'{{"action":"assign","value":"carl","ids":[{ids["box_2"]}]}}')
    tab.page.get_by_text("only a manager may assign objects", exact=False).wait_for()
    assert work.assigned() == {}
    open_project(tab).get_by_text("Nobody has worked on it today.").wait_for()


def test_a_manager_lets_predictions_learn_from_accepted_objects(
    tmp_path: Path, start: Any, open_tab: Any
) -> None:
    box = trimesh.creation.box((0.4, 0.3, 0.2))
    box.export(tmp_path / "new.ply")
    store = Store(tmp_path / "workspace")
    for k in range(3):
        accept(store, tmp_path / f"oven_{k}.ply", cupboard(upper=0.4))
    store.close()
    tab: Tab = open_tab(
        start(tmp_path / "new.ply", *(tmp_path / f"oven_{k}.ply" for k in range(3)))
    )
    page = open_project(tab)
    page.get_by_role("button", name="Learn", exact=True).click()
    text = "Predictions follow 3 accepted objects (version 1): of their joints 100 %"
    tab.page.get_by_text(text, exact=False).wait_for()
    assert in_use(tmp_path / "workspace") is not None
    page.get_by_role("button", name="Close", exact=True).click()
    page.first.wait_for(state="detached")
    open_project(tab).get_by_text(text, exact=False).wait_for()
    assert tab.object.services.predictor.startswith("learned:")
