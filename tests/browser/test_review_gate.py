"""The gate in a real browser: shown, posed by a click, mended, accepted against with a reason."""

import json
import re
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.server.prompt_file import read_prompts
from app.viewer.input import keys
from app.viewer.words.common import TOO_FAST
from app.viewer.words.review import FIXES
from model.core.articulated_object import Prediction
from model.core.files import static_assets
from model.core.tree import KinematicTree
from model.validation.report import Severity
from sessions import commands as cmd
from tests.browser.browsing import Tab, wait_until
from tests.builders import CUPBOARD_DOOR as DOOR
from tests.builders import write_cupboard

TREE = KinematicTree(("link_0", "link_1"), (replace(DOOR, axis=(0, 0, 1)),))


def record_prediction(obj: Any, sure: float) -> None:
    """A door that swings inward, as a predictor might have it."""
    wait_until(
        lambda: obj.document.segmentation is not None and obj.document.segmentation_current, "parts"
    )
    labels = obj.document.segmentation.labels
    prediction = Prediction(TREE, confidence={"link_1": sure})
    obj.do(cmd.RecordPrediction(prediction, labels), "tester")


def joint_button(tab: Tab, words: str) -> Any:
    return tab.page.get_by_role("button", name=re.compile(words)).first


def check_marks_leave(tab: Tab, contact: Any) -> None:
    """The mark of a moment goes with its pose, and with the step."""
    tab.page.evaluate("document.activeElement?.blur()")
    tab.key("r")
    handle = tab.app.tab.client.scene.get_handle_by_name
    wait_until(lambda: not tab.app.motion.q, "back at rest")
    wait_until(lambda: handle("/moment") is None, "no moment at rest")
    wait_until(lambda: not contact.visible, "no contact at rest")
    joint_button(tab, r"part 1.*: error").click()
    tab.wait_node("/moment")
    tab.step("Joints")
    wait_until(lambda: handle("/moment") is None, "no moment in another step")
    tab.step("Review")


def check_the_pose_follows_the_limits(tab: Tab, obj: Any, report: Any) -> None:
    """Limits that are changed at the worst moment move what is shown into them."""
    joint_button(tab, r"part 1.*: error").click()
    wait_until(lambda: tab.app.motion.q == dict(report.of("door").worst.q), "the worst pose again")
    obj.do(cmd.SetJoint(replace(TREE.joints[0], upper=0.1)), "tester")
    wait_until(lambda: tab.app.motion.q == {"door": 0.1}, "the picture is within the limits")
    obj.do(cmd.Undo(), "tester")
    wait_until(lambda: obj.validation.report is report, "the report of before")
    tab.wait_seen()


def test_see_the_worst_moment_mend_and_accept_with_a_reason(
    start: Any, open_tab: Any, tmp_path: Path
) -> None:
    server = start(write_cupboard(tmp_path / "cupboard"), write_cupboard(tmp_path / "other"))
    tab = open_tab(server)
    obj = tab.object
    record_prediction(obj, 0.4)
    tab.wait_node("/part/1")
    tab.step("Review")
    report = wait_until(lambda: obj.validation.report, "a verdict")
    assert report.severity == Severity.ERROR

    # A click on the joint poses the object at the worst moment and marks the contact.
    joint_button(tab, r"part 1.*: error").click()
    worst = report.of("door").worst
    wait_until(lambda: tab.app.motion.q == dict(worst.q), "the worst pose")
    tab.wait_node("/moment")
    marker = tab.app.tab.client.scene.get_handle_by_name("/moment")
    wait_until(lambda: np.allclose(marker.position, worst.where), "the mark is in its place")
    frame = tab.app.tab.client.scene.get_handle_by_name("/part/1")
    expected = obj.document.tree.pose(worst.q)["link_1"][:3, 3]
    wait_until(lambda: np.allclose(frame.position, expected, atol=1e-6), "the posed link")
    tab.page.screenshot(path=str(tmp_path / "worst.png"))
    contact = tab.app.tab.client.scene.get_handle_by_name("/contact/0")
    wait_until(lambda: contact.visible, "the contact is shown")

    check_marks_leave(tab, contact)

    check_the_pose_follows_the_limits(tab, obj, report)

    # With errors the key is not enough.
    tab.page.evaluate("document.activeElement?.blur()")
    tab.key("y")
    tab.page.get_by_text("give a reason for the override").first.wait_for()
    assert obj.document.review.state == "predicted"

    # One click fixes, and the checks run again; undo works as usual.
    tab.button("Flip").first.click()
    wait_until(lambda: obj.document.tree.by_name["door"] == DOOR, "flipped")
    wait_until(
        lambda: (found := obj.validation.report) and found.severity == Severity.OK, "a new verdict"
    )
    wait_until(lambda: not tab.app.motion.q, "back at rest")
    tab.button("Undo").click()
    wait_until(lambda: obj.document.tree == TREE, "undone")
    wait_until(lambda: obj.validation.report is report, "the answer of before")

    # A reason overrides the errors, and it is recorded.
    box = tab.field("Reason for override")
    box.fill("the shelf is soft")
    box.press("Enter")
    wait_until(lambda: tab.app.review.override_text == "the shelf is soft", "the reason")
    tab.wait_seen()  # what was there before Undo counts as new
    joint_button(tab, "Accept anyway").click()
    wait_until(lambda: obj.document.saved and not tab.button("Flip").count(), "saved, not to fix")
    assert obj.document.review.override == "the shelf is soft"
    record = json.loads((Path(obj.document.saved.folder) / "provenance.json").read_text())
    assert (record["gate"]["verdict"], record["gate"]["override"]) == (
        "broken",
        "the shelf is soft",
    )
    # The next object is there without a click.
    wait_until(lambda: tab.object is not obj, "the next object")
    # Y once more is no change that would need the object to be reopened.
    tab.key("b")
    wait_until(lambda: tab.object is obj, "back at it")
    tab.wait_seen()
    tab.key("y")
    tab.page.get_by_text("Reopen it to edit it").wait_for()
    check_it_is_reopened_where_one_looks(tab)


def check_it_is_reopened_where_one_looks(tab: Tab) -> None:
    """An accepted object's fields are off, P says so at once, and the way out is beside them."""
    tab.step("Joints")
    wait_until(lambda: tab.field("Type").is_disabled(), "the type can't be changed")
    tab.key("p")
    tab.page.get_by_text("reopen it before you change it").wait_for()
    assert "predict" not in tab.object.jobs
    tab.button("Reopen to edit").click()
    wait_until(lambda: tab.document.review.state == "in_progress", "reopened")
    wait_until(lambda: tab.field("Type").is_enabled(), "the type can be changed")
    tab.page.get_by_text("reopen it before you change it").wait_for(state="hidden")


def test_y_shows_what_wants_a_look_before_it_accepts(
    start: Any, open_tab: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = start(write_cupboard(tmp_path / "cupboard"), write_cupboard(tmp_path / "other"))
    tab = open_tab(server)
    obj = tab.object
    other = server.app_state.object(server.app_state.queue.records()[1].id)
    hinge = replace(DOOR, origin=(-0.28, -0.003, 0.2))
    tree = KinematicTree(("link_0", "link_1"), (hinge,))
    for each, sure in ((obj, 0.4), (other, 0.5)):
        record_prediction(each, sure)
        each.do(cmd.SetJoint(hinge), "tester")
    tab.step("Joints")
    report = wait_until(lambda: obj.validation.report, "a verdict")
    assert report.severity == Severity.WARNING and obj.document.tree == tree
    tab.page.evaluate("document.activeElement?.blur()")
    tab.wait_seen()
    tab.key("y")
    tab.key("y")  # a double press shows it, no more
    wait_until(lambda: tab.app.motion.q == dict(report.joints[0].worst.q), "the worst pose")
    tab.wait_node("/moment")
    assert tab.selection.step == "Review" and obj.document.review.state == "predicted"
    joint_button(tab, "Accept anyway").wait_for()
    check_a_confirmation_ends_when_one_leaves(tab, obj, other, monkeypatch)
    tab.page.screenshot(path=str(tmp_path / "look.png"))
    # Its asset takes long to write: the person goes on meanwhile, and is told once it is there.
    held = server.app_state.workers.saving.submit(time.sleep, 600.0, priority=9)
    tab.key("y")
    wait_until(lambda: tab.object is other, "the next object")
    assert obj.document.review.state == "predicted" and "save" in obj.jobs
    tab.page.get_by_title("cupboard: saving").wait_for()
    # Back at it, nothing asks for a decision that was made, and one stays there.
    tab.key("b")
    wait_until(lambda: tab.object is obj and tab.app.drawing.drawn, "back at it")
    tab.step("Review")
    tab.page.get_by_text("cupboard · saving").wait_for()
    tab.page.get_by_text("1 saving · 1 to review").wait_for()
    accepting = tab.button("Accepting…")
    assert accepting.is_disabled() and tab.object is obj
    color = accepting.evaluate("b => getComputedStyle(b).color")
    assert max(map(int, color[4:-1].split(", "))) < 100, "it can be read"
    tab.page.screenshot(path=str(tmp_path / "saving.png"))
    tab.key("n")
    wait_until(lambda: tab.object is other, "the other one again")
    held.cancel()
    tab.page.get_by_text("cupboard: Saved in", exact=False).wait_for()
    assert obj.document.review.state == "accepted"
    wait_until(lambda: not obj.is_shown, "nobody looks at it any more")
    tab.wait_seen()
    assert tab.object is other
    monkeypatch.setattr(keys, "LOOK_SECONDS", 3600.0)
    tab.key("y")  # too early: nobody has seen it
    tab.page.get_by_text(TOO_FAST[1]).wait_for()
    assert tab.app.review.validation_list.looked_at(other) is None
    assert other.document.review.state == "predicted"


def open_while_drawing(tab: Tab, patch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Have the next object opened in the middle of a drawing, and hold what follows that."""
    app, begun, opened, looked = tab.app, *(threading.Event() for _ in range(3))
    draw, drawn, select = app.queue.draw, app.guard.drawn, tab.selection.open

    def draw_queue() -> None:
        draw()
        if not begun.is_set():
            begun.set()
            opened.wait(1.0)  # which it isn't before the end of this drawing

    def all_drawn() -> None:
        drawn()
        if opened.is_set():
            looked.wait(60.0)

    patch.setattr(app.queue, "draw", draw_queue)
    patch.setattr(app.guard, "drawn", all_drawn)
    patch.setattr(tab.selection, "open", lambda obj: (select(obj), opened.set()))
    app.tab.invalidate()
    assert begun.wait(60.0)
    return looked.set


def check_a_confirmation_ends_when_one_leaves(
    tab: Tab, obj: Any, other: Any, patch: pytest.MonkeyPatch
) -> None:
    """It names its object, and is asked for anew on the way back."""
    note = tab.page.locator(".mantine-Notification-root", has_text="cupboard: 1 warning")
    note.wait_for()
    tab.page.evaluate("window.__before = window.__viserSceneTree.getState()['/scan']")
    with patch.context() as within:
        go_on = open_while_drawing(tab, within)
        tab.key("n")
        # No panel tells of the next object while picture or queue show the one before.
        behind = tab.page.wait_for_function(
            "() => document.body.innerText.includes('other · ')"
            " && {same: window.__viserSceneTree.getState()['/scan'] === window.__before,"
            " listed: document.querySelector('.aw-card [aria-current=true] b').innerText}"
        )
        go_on()
    assert behind.json_value() == {"same": False, "listed": "other"}
    note.wait_for(state="hidden")
    assert tab.object is other and tab.app.review.validation_list.looked_at(obj) is None
    tab.key("b")
    wait_until(lambda: tab.object is obj and tab.app.drawing.drawn, "back at it")
    tab.step("Review")
    tab.wait_seen()
    tab.key("y")
    joint_button(tab, "Accept anyway").wait_for()
    assert obj.document.review.state == "predicted", "it is shown again first"
    tab.wait_seen()


def check_a_wish_is_taken_back(tab: Tab, picture: Path) -> None:
    """Y before the verdict, and Esc: it isn't accepted then."""
    tab.wait_seen()
    tab.key("y")
    tab.button("Cancel acceptance (Esc)").wait_for()
    tab.page.get_by_text("Checking…", exact=True).wait_for()
    assert tab.object.validation.acceptance_waits
    tab.page.screenshot(path=str(picture))
    # Who looked at another one meanwhile is told once all the same.
    obj = tab.object
    tab.key("b")
    wait_until(lambda: tab.object is not obj, "another object")
    tab.key("n")
    wait_until(lambda: tab.object is obj, "back at it")
    tab.step("Review")
    tab.key("Escape")
    told = tab.page.get_by_text("Cancelled before the checks were done")
    told.first.wait_for()
    tab.drawn()
    assert told.count() == 1
    assert not obj.validation.acceptance_waits
    tab.button("Cancel acceptance (Esc)").wait_for(state="hidden")


def test_y_before_the_verdict_goes_on_and_what_is_held_back_comes_again(
    start: Any, open_tab: Any, tmp_path: Path
) -> None:
    names = ("grazing", "clean", "third")
    server = start(*(write_cupboard(tmp_path / name) for name in names))
    tab = open_tab(server)
    app_state = server.app_state
    grazing, clean, third = (app_state.object(r.id) for r in app_state.queue.records())
    for obj, sure in ((grazing, 0.6), (clean, 0.7), (third, 0.8)):
        record_prediction(obj, sure)
    wait_until(lambda: all(o.validation.report for o in (grazing, clean, third)), "verdicts")
    held = app_state.workers.prediction.submit(time.sleep, 600.0, priority=99)
    wait_until(lambda: held.state == "running", "judging is held up")
    grazing.do(cmd.SetJoint(replace(DOOR, origin=(-0.28, -0.003, 0.2))), "tester")
    for obj in (clean, third):
        obj.do(cmd.SetJoint(DOOR), "tester")
    tab.step("Review")
    tab.field("Comment").fill("the hinge is bent")
    tab.page.evaluate("document.activeElement?.blur()")
    wait_until(lambda: tab.app.review.comment_text == "the hinge is bent", "the comment")
    tab.wait_seen()
    tab.key("y")
    wait_until(lambda: tab.object is clean, "the next object")
    tab.page.get_by_title("grazing: checking, then accepted").wait_for()
    tab.wait_seen()
    tab.key("y")
    wait_until(lambda: tab.object is third, "the next object again")
    assert {o.document.review.state for o in (grazing, clean)} == {"predicted"}
    tab.page.screenshot(path=str(tmp_path / "judged_later.png"))
    check_a_wish_is_taken_back(tab, tmp_path / "waiting.png")
    assert grazing.validation.acceptance_waits and clean.validation.acceptance_waits

    held.cancel()
    tab.page.get_by_text("clean: Saved in", exact=False).wait_for()
    assert clean.document.review.state == "accepted"
    tab.page.get_by_text("Y again", exact=False).first.wait_for()
    assert grazing.document.review.state == "predicted" and tab.object is third
    tab.page.get_by_title("grazing: on hold: 1 warning. part 1").wait_for()
    tab.page.screenshot(path=str(tmp_path / "look_again.png"))

    # One key opens it at the worst pose, with the comment; Y accepts it now.
    tab.button("On hold: grazing").wait_for()
    tab.page.get_by_text("1 on hold").wait_for()
    tab.page.keyboard.press("Shift+Y")
    wait_until(lambda: tab.object is grazing, "back at it")
    worst = grazing.validation.report.joints[0].worst
    wait_until(lambda: tab.app.motion.q == dict(worst.q), "the worst pose")
    tab.wait_node("/moment")
    assert tab.selection.step == "Review" and tab.app.review.comment_text == "the hinge is bent"
    joint_button(tab, "Accept anyway").wait_for()
    tab.wait_seen()
    tab.page.screenshot(path=str(tmp_path / "back.png"))
    tab.key("y")
    wait_until(lambda: grazing.document.saved is not None, "saved")
    assert grazing.document.review.comment == "the hinge is bent"
    wait_until(lambda: not tab.app.queue.on_hold.visible, "nothing is held back")


def test_one_click_a_joint_mends_a_predicted_demo(start: Any, open_tab: Any) -> None:
    """What the bundled clicks and the predictor give of a cabinet, with one joint spoilt."""
    path = static_assets() / "examples" / "cabinet.glb"
    file = read_prompts(path.with_suffix(".prompts.json"))
    server = start(path)
    tab = open_tab(server, 900, 600)
    obj = tab.object
    obj.do(cmd.SetCategory(file.category), "tester")
    for part, name in file.names.items():
        obj.do(cmd.AddPart(part, name), "tester")
    for click in file.prompts.clicks:
        obj.do(cmd.AddClick(click), "tester")
    tab.settled()
    tab.button("Predict joints (P)").first.click()
    tree = wait_until(lambda: obj.document.tree, "joints")
    wait_until(lambda: tab.selection.step == "Joints", "the joints are shown")
    # A door about a line that lies askew in it, so that it runs into the body.
    door = tree.joint_of["link_1"]
    askew = replace(door, axis=(0.3, 0.0, -0.954), origin=np.add(door.origin, (0.03, 0.02, 0)))
    obj.do(cmd.SetJoint(askew), "tester")
    tab.step("Review")
    report = wait_until(lambda: obj.validation.report, "a verdict")
    assert report.severity == Severity.ERROR
    pressed = 0
    while report.severity == Severity.ERROR and pressed < 4:
        worst = next(j for j in report.joints if j.fixes)
        before = report
        tab.button(FIXES[worst.fixes[0].kind]).first.click()
        wait_until(lambda: obj.validation.report is not before, "the edit")  # noqa: B023
        report = wait_until(lambda: obj.validation.report, "a new verdict")
        pressed += 1
    assert report.severity == Severity.OK
    tab.page.get_by_text(re.compile("Checks: ✓ 5 OK")).first.wait_for()
    # No reason is asked for any more.
    tab.page.get_by_role("button", name=re.compile("Accept anyway")).wait_for(state="hidden")
    tab.button("Accept with edits (Y)").click()
    saved = wait_until(lambda: obj.document.saved, "saved")
    validation_list = json.loads((Path(saved.folder) / "provenance.json").read_text())["gate"]
    assert (validation_list["verdict"], validation_list["override"]) == ("fine", "")


def test_the_least_sure_prediction_follows_a_decision(
    start: Any, open_tab: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = start(*(write_cupboard(tmp_path / name) for name in ("a", "b", "c")))
    tab = open_tab(server)
    objects = [server.app_state.object(r.id) for r in server.app_state.queue.records()]
    for obj, sure in zip(objects, (0.5, 0.9, 0.2), strict=True):
        record_prediction(obj, sure)
    assert tab.object is objects[0]
    tab.step("Review")
    viewer = tab.app.tab
    carry_out = viewer.do

    def slowly(command: cmd.Command) -> None:
        carry_out(command)
        before = viewer.drawings

        def drawn() -> bool:
            viewer.invalidate()
            return viewer.drawings > before + 1

        wait_until(drawn, "the tab draws the decision meanwhile")

    monkeypatch.setattr(tab.app.tab, "do", slowly)
    tab.page.evaluate("document.activeElement?.blur()")
    tab.wait_seen()
    tab.key("x")
    wait_until(lambda: tab.app.commands.rejecting.asking, "it asks what is wrong")
    assert objects[0].document.review.state == "predicted"
    tab.key("2")
    wait_until(lambda: objects[0].document.review.state == "rejected", "rejected")
    wait_until(lambda: tab.object is objects[2], "the least sure one")
    tab.key("x")  # at once: it asks about the one that is shown
    tab.page.get_by_text("Why reject c?").wait_for()
    assert objects[0].document.review.reason == "axis"
    assert tab.selection.step == "Review"
    tab.key("n")
    tab.page.get_by_text("Why reject c?").wait_for(state="hidden")
    assert objects[2].document.review.state == "predicted"
