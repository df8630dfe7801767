"""Whether a scan is completed is a choice of the review, with undo."""

from pathlib import Path
from typing import Any

from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.geometry.completion import SURFACE
from model.io.assets.reader import read_provenance
from tests.browser.browsing import wait_until
from tests.browser.objects import write_cloud

LABEL = "Fill in surfaces that the scan missed"


def test_a_scan_is_completed_where_it_is_checked(start: Any, open_tab: Any, tmp_path: Path):
    from model.core.articulated_object import Prediction
    from sessions import commands as cmd

    places = write_cloud(tmp_path / "chest.ply")
    tab = open_tab(start(tmp_path / "chest.ply"))
    tab.prompt(places["lid"])
    lid = Joint("lid", "revolute", "link_0", "link_1", (1, 0, 0), (0, 0.2, 0.3), 0, 1)
    tree = KinematicTree(("link_0", "link_1"), (lid,))
    labels = tab.document.segmentation.labels
    tab.object.do(cmd.RecordPrediction(Prediction(tree, backend="test"), labels), "tester")
    tab.step("Review")
    box = tab.page.get_by_label(LABEL)
    assert not box.is_checked() and tab.document.complete is None
    box.check()
    wait_until(lambda: tab.document.complete, "it is on")
    tab.drawn()
    tab.page.keyboard.press("Control+z")
    wait_until(lambda: tab.document.complete is None, "undone")
    wait_until(lambda: not box.is_checked(), "off again")
    box.check()
    wait_until(lambda: tab.document.complete, "on again")

    def accepted() -> dict:
        wait_until(lambda: tab.object.validation.report, "the checks")
        from app.server.accepting import accept

        before = tab.document.saved
        accept(tab.object, "", "tester", "fine", seen=tab.object.validation.report)
        saved = wait_until(lambda: tab.document.saved is not before and tab.document.saved, "saved")
        return read_provenance(Path(saved.folder))["asset"]

    assert SURFACE in accepted()["completed"]["base"]
    tab.drawn()
    tab.object.do(cmd.Reopen(""), "tester")
    tab.object.do(cmd.SetCompletion(False), "tester")
    assert "completed" not in accepted()
