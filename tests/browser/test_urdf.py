"""An articulated object that somebody else made, checked in a real browser."""

from pathlib import Path
from typing import Any

from tests.browser.browsing import Tab, wait_until
from tests.browser.objects import write_urdf


def test_its_joints_move_at_once_and_an_edit_goes_back_to_the_file(
    tmp_path: Path, start: Any, open_tab: Any
) -> None:
    tab: Tab = open_tab(start(write_urdf(tmp_path)))
    app, page = tab.app, tab.page
    wait_until(lambda: tab.selection.step == "Joints", "its joints are shown")
    page.get_by_text("From cupboard.urdf.", exact=True).wait_for()
    wait_until(tab.object.part_payloads, "the parts as they move")
    page.evaluate("document.activeElement?.blur()")
    tab.key(" ")
    wait_until(lambda: app.motion.q.get("hinge", 0.0) > 0.1, "the door opens")
    tab.key("r")
    tab.key("f")
    wait_until(lambda: tab.document.edited_joints == ("link_1",), "the axis is turned")
    page.get_by_text("The gray arrow is the axis in cupboard.urdf").wait_for()
    page.get_by_role("button", name="Reset to the file's joint").click()
    wait_until(lambda: not tab.document.edited_joints, "as in the file")
    tab.key("p")
    wait_until(lambda: tab.document.prediction.file is None, "predicted anew")
