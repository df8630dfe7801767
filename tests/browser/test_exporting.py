"""Downloads, SimReady packages, and accepting many above a confidence, from the browser."""

import io
import zipfile
from pathlib import Path
from typing import Any

import pytest
from pxr import Sdf

from model.core.articulated_object import Prediction
from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import load_object
from sessions import commands as cmd
from tests.browser.browsing import Tab, wait_until
from tests.browser.objects import write_urdf


@pytest.fixture
def cupboard(tmp_path: Path) -> Path:
    return write_urdf(tmp_path)


def test_an_accepted_object_is_downloaded_and_packaged(
    cupboard: Path, start: Any, open_tab: Any
) -> None:
    tab: Tab = open_tab(start(cupboard))
    wait_until(lambda: tab.document.tree is not None, "the joints of the file")
    tab.object.do(cmd.SetCategory("StorageFurniture"), "tester")
    saved = write_asset(load_object(cupboard), cupboard.with_name("asset"), provenance={})
    tab.object.do(cmd.Accept("", (), ""), "tester")
    tab.object.do(cmd.Saved(str(saved.folder)), "tester")
    tab.step("Joints")  # the header has it in every step
    check_the_download(tab)
    check_the_package(tab)


def check_the_download(tab: Tab) -> None:
    """A zip with a URDF that opens, and nothing left on the server."""
    tab.button("Export…").click()
    tab.field("MJCF").check()
    assert tab.field("ROS 2 package").is_visible()
    tab.field("Read back and compare").uncheck()
    with tab.page.expect_download() as coming:
        tab.button("Export").click()
    name = coming.value.suggested_filename
    assert name in {"artiworld_urdf_mjcf.zip", "artiworld_mjcf_urdf.zip"}
    archive = zipfile.ZipFile(io.BytesIO(Path(coming.value.path()).read_bytes()))
    files = archive.namelist()
    assert any(f.endswith(".urdf") for f in files) and any(f.endswith(".xml") for f in files)
    assert archive.testzip() is None
    exports = Path(tab.server.config.workspace) / "exports"
    wait_until(lambda: not any(exports.glob("*")), "no copy stays")


def check_the_package(tab: Tab) -> None:
    """A SimReady package asks for author and license, and is then written and checked."""
    page = tab.page
    tab.button("Export…").click()
    tab.field("URDF").uncheck()
    tab.field("SimReady package (USD)").check()
    tab.field("Read back and compare").uncheck()
    tab.field("Author").fill("A. Author")
    tab.field("License").fill("")
    tab.field("Server folder (empty: download)").fill("ready")
    tab.button("Export").click()
    page.get_by_text("names its author and its license", exact=False).wait_for()
    tab.field("License").fill("CC-BY-4.0")
    tab.drawn()
    tab.button("Export").click()
    page.get_by_text("Written to", exact=False).wait_for()
    out = Path(tab.server.config.workspace) / "exports" / "ready"
    (package,) = out.rglob("*.usdc")
    said = Sdf.Layer.FindOrOpen(str(package)).customLayerData["SimReady_Metadata"]  # type: ignore[attr-defined]
    assert (said["author"], said["asset_license"]) == ("A. Author", "CC-BY-4.0")
    assert list(package.parent.rglob("*.png")), "with its thumbnail"


def test_many_are_accepted_above_a_confidence(cupboard: Path, start: Any, open_tab: Any) -> None:
    other = cupboard.with_name("wardrobe.urdf")
    other.write_text(cupboard.read_text())
    server = start(cupboard, other)
    tab: Tab = open_tab(server)
    records = {r.name: r.id for r in server.app_state.queue.records()}
    for name, sure in (("cupboard", 0.93), ("wardrobe", 0.41)):
        tab.app.tab.act(lambda name=name: tab.app.queue.open(records[name]))
        wait_until(lambda name=name: tab.object and tab.object.record.name == name, "it is open")
        wait_until(lambda: tab.document.tree is not None, "the joints of the file")
        doc = tab.document
        told = Prediction(doc.tree, confidence={"link_1": sure}, backend="test")
        tab.object.do(cmd.RecordPrediction(told, doc.segmentation.labels), "tester")
    page = tab.page
    page.get_by_role("button", name="Gallery or list").click()
    page.get_by_role("button", name="Select all").click()
    page.get_by_text("2 selected").wait_for()
    page.locator(".aw-number").fill("80")
    offered = page.locator(".aw-bulk").get_by_role("button", name="Accept those that passed")
    check = page.locator(".aw-bulk").get_by_role("button", name="Check those that nobody")
    wait_until(lambda: check.is_visible() or offered.is_enabled(), "it says what is offered")
    if check.is_visible():
        check.click()
    wait_until(offered.is_enabled, "the sure one has passed")
    page.get_by_label("Category", exact=True).last.fill("shelf unit")
    page.get_by_role("button", name="Set the category of").click()
    check.click()  # their reports are there already: the page hears of them all the same
    offered.click()

    def states() -> dict[str, str]:
        return {r.name: r.state for r in server.app_state.queue.records()}

    wait_until(lambda: states()["cupboard"] == "accepted", "the sure one is accepted", 120)
    assert states()["wardrobe"] != "accepted", "the other one waits for a person"
    session = server.app_state.hub.session(records["cupboard"])
    wait_until(lambda: session.document.saved is not None, "its asset is known")
    asset = Path(session.document.saved.folder)
    assert [j.type for j in load_object(asset).tree.joints] == ["revolute"]
