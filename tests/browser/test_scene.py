"""A whole scene in a real browser: choose, work on one object in place, decide, go back, save."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from app.viewer.picture import palette
from app.viewer.picture.scene_nodes import Surroundings
from sessions import commands as cmd
from tests.browser.browsing import SceneTab, wait_until
from tests.model.scenes.scenes_made import make_assets, own, own_object, write_scene


def entry(id: str, asset: str, x: float, **more: Any) -> dict[str, Any]:
    half = 0.7071067811865476
    more = {"description": id.rstrip("12 "), **more}
    return own_object(id, asset, [x, 0.0, 0.4], [half, 0.0, 0.0, -half], **more)


def check_picture_of_the_chosen(tab: SceneTab) -> None:
    """It is seen from its front, at -y, and its parts look in the picture as in the table."""
    eye = tab.camera_at_rest()
    center = tab.scene.picture.bounds(["cabinet 1"]).mean(0)
    pose = tab.scene_workspace.world_from_copy(tab.scene_workspace.items["cabinet 1"])
    assert ((eye - center) @ pose[:3, :3])[1] < -0.5
    links = {n.link: n for n in tab.scene.picture.nodes if n.work is not None}
    rows = tab.page.locator(".aw-tree").inner_html()
    for part in (1, 2):
        color = palette.part_color(part)
        (sent,) = links[f"link_{part}"].handles
        np.testing.assert_array_equal(sent.batched_colors, [palette.albedo(color)])
        assert f"rgb{color}" in rows


def load_again(tab: SceneTab) -> None:
    before = tab.app
    tab.page.reload()
    wait_until(lambda: tab.server.apps and tab.app is not before, "the page is loaded again")


def play_by_keys(tab: SceneTab) -> None:
    work = tab.scene_workspace.work("cabinet 1")
    wait_until(lambda: work.drawn is not None, "it can play")
    tab.drawn()
    tab.page.locator("canvas").first.focus()
    for key in ("Space", "Shift+Space"):
        tab.key(key)
        wait_until(lambda: tab.scene.motion.playing, "it plays")
        tab.key(key)
        wait_until(lambda: not tab.scene.motion.playing, "and stops")
    play_one_joint(tab)


def play_one_joint(tab: SceneTab) -> None:
    """A row of the chosen object plays its joint alone."""
    tab.scene.choice.choose("cabinet 1")
    tab.page.get_by_role("button", name="drawer 2", exact=False).first.click()
    moving = tab.scene.motion
    wait_until(lambda: moving.playing, "the drawer slides")
    tab.button("Stop (Space)").click()
    wait_until(lambda: not moving.playing, "and stops")
    check_a_small_window(tab)


def check_a_small_window(tab: SceneTab) -> None:
    """The list folds for the picture; *Save scene* stays in sight."""
    share = "window.__viserMutable.canvas.getBoundingClientRect().width / innerWidth"
    tab.page.set_viewport_size({"width": 1024, "height": 700})
    unfold = tab.button("Expand column")
    unfold.wait_for()
    wait_until(lambda: tab.page.evaluate(share) >= 0.6, "the picture has most of it")
    box = tab.button("Save scene").bounding_box()
    assert box["y"] + box["height"] <= 700
    tab.page.set_viewport_size({"width": 1280, "height": 800})
    unfold.click()
    tab.page.locator(".aw-open b").first.wait_for()


def sort_again(tab: SceneTab) -> None:
    """What becomes more urgent keeps its place in the list until it is sorted."""
    names = tab.page.locator(".aw-open b")
    before = names.all_inner_texts()
    again = tab.button("Sort again")
    assert not again.is_visible()
    tab.scene_workspace.set_articulable("rock 2", True, "tester")
    again.wait_for()
    assert names.all_inner_texts() == before == ["cabinet 1", "rock 2"]
    again.click()
    wait_until(lambda: names.all_inner_texts() == ["rock 2", "cabinet 1"], "what is to do is first")


def accept_in_gallery(tab: SceneTab) -> None:
    """All objects above a confidence are one decision, which undo takes back."""
    tab.button("Gallery or list").click()
    tab.button("Select all").click()
    tab.page.get_by_label("Minimum confidence in percent").fill("5")
    tab.page.get_by_text("Accept 1 from").click()
    wait_until(lambda: tab.status("cabinet 1") == "accepted", "the predicted one is accepted")
    tab.key("Escape")
    tab.button("Undo").first.click()
    wait_until(lambda: tab.status("cabinet 1") == "predicted", "and not any more")


def test_open_choose_work_in_place_accept_and_save(
    start: Any, open_tab: Any, tmp_path: Path
) -> None:
    assets = make_assets(tmp_path / "assets")
    objects = own([entry("cabinet 1", "cab", 0.0), entry("rock 2", "rock", 1.2)])
    scene = write_scene(tmp_path / "home.json", objects)
    tab = open_tab(start(scene=scene, assets=(assets,), predictor="geometric"), kind=SceneTab)
    wait_until(lambda: tab.status("cabinet 1") == "predicted", "the cabinet is predicted")
    wait_until(lambda: tab.scene_workspace.work("cabinet 1").drawn is not None, "it is drawn")
    assert tab.status("rock 2") == "static"

    # Click the static rock in the picture, say that it moves, take that back.
    tab.scene.picture.frame()
    tab.camera_at_rest()
    low, high = tab.scene.picture.bounds(["rock 2"])
    tab.click3d([*((low + high) / 2)[:2], high[2]])
    wait_until(lambda: tab.scene.choice.selected == "rock 2", "a click chooses the rock")
    tab.button("Articulable").click()
    wait_until(lambda: tab.status("rock 2") == "todo", "a person says that it is articulable")
    tab.button("Undo").first.click()
    wait_until(lambda: tab.status("rock 2") == "static", "undo")

    # N goes to what wants a decision; Enter works on it in place.
    tab.page.locator("canvas").first.focus()
    tab.key("n")
    wait_until(lambda: tab.scene.choice.selected == "cabinet 1", "N goes to the cabinet")
    check_picture_of_the_chosen(tab)
    load_again(tab)
    wait_until(lambda: tab.scene.choice.selected == "cabinet 1", "a reload keeps the choice")
    tab.page.locator("canvas").first.focus()
    tab.key("Enter")
    wait_until(lambda: tab.object is not None and tab.app.drawing.drawn, "the cabinet is open")
    tab.wait_node("/scan")
    root = tab.app.tab.client.scene.get_handle_by_name("/world")
    pose = tab.scene_workspace.world_from_copy(tab.scene_workspace.items["cabinet 1"])
    np.testing.assert_allclose(root.position, np.linalg.inv(pose)[:3, 3], atol=1e-6)
    around = next(n for n in tab.scene.picture.nodes if isinstance(n, Surroundings))
    wait_until(
        lambda: around.ghost is not None and around.ghost.visible, "its surroundings: ghosts"
    )
    assert tab.selection.step == "Joints"
    load_again(tab)
    wait_until(
        lambda: tab.scene.choice.inside == "cabinet 1" and tab.app.drawing.drawn,
        "a reload comes back to it",
    )
    tab.wait_node("/scan")
    tab.button("Back to the scene (Backspace)").click()
    wait_until(lambda: tab.object is None and tab.scene.choice.inside is None, "back in the scene")

    accept_in_gallery(tab)
    play_by_keys(tab)
    # All joints at once, then a decision from the scene.
    tab.button("Play all joints (Shift+Space)").click()
    wait_until(
        lambda: any(n.now != n.rest for n in tab.scene.picture.nodes if n.work is not None),
        "parts move",
    )
    tab.button("Stop (Space)").click()
    wait_until(lambda: not tab.scene.motion.playing, "and stop")
    accept, choice = tab.button("Accept (Y)").first, tab.scene.choice
    wait_until(lambda: accept.is_visible() or choice.choose("cabinet 1"), "it is chosen")
    tab.wait_seen()
    accept.click()
    wait_until(lambda: tab.status("cabinet 1") == "accepted", "accepted")
    assert (Path(tab.save().folder) / "scene.xml").is_file()
    sort_again(tab)


def test_y_inside_needn_t_wait_for_the_gate(start: Any, open_tab: Any, tmp_path: Path) -> None:
    assets = make_assets(tmp_path / "assets")
    small = entry("cabinet 2", "cab", 1.2, scale=[0.7, 0.7, 0.7])
    scene = write_scene(tmp_path / "home.json", own([entry("cabinet 1", "cab", 0.0), small]))
    server = start(scene=scene, assets=(assets,), predictor="geometric")
    tab = open_tab(server, kind=SceneTab)
    for id in ("cabinet 1", "cabinet 2"):
        wait_until(lambda id=id: tab.status(id) == "predicted", "it is predicted")
    tab.scene.choice.choose("cabinet 1")
    tab.page.locator("canvas").first.focus()
    tab.key("Enter")
    wait_until(lambda: tab.object is not None and tab.app.drawing.drawn, "it is open")
    tab.wait_node("/part/1")
    obj, app_state = tab.object, server.app_state
    wait_until(lambda: obj.validation.report, "a verdict")
    held = app_state.workers.prediction.submit(time.sleep, 600.0, priority=99)
    wait_until(lambda: held.state == "running", "judging is held up")
    # The drawer goes backwards, through the back.
    joint = next(j for j in obj.document.tree.joints if j.type == "prismatic")
    obj.do(cmd.SetJoint(replace(joint, axis=tuple(-v for v in joint.axis))), "tester")
    tab.wait_seen()
    tab.key("y")
    wait_until(
        lambda: tab.scene.choice.inside is None and tab.scene.choice.selected == "cabinet 2",
        "the next",
    )
    row = tab.scene_workspace.row(tab.scene_workspace.items["cabinet 1"])
    assert row.shown == "validating" and obj.validation.acceptance_waits
    tab.drawn()
    tab.page.screenshot(path=str(tmp_path / "judged_later.png"))
    held.cancel()
    tab.page.get_by_text("cabinet 1: 1 error. drawer 2", exact=False).first.wait_for()
    assert tab.scene_workspace.row(tab.scene_workspace.items["cabinet 1"]).shown == "on_hold"
    assert tab.scene.choice.selected == "cabinet 2" and obj.document.review.state == "predicted"
    tab.scene.choice.choose("cabinet 1")
    tab.page.get_by_text("Not accepted: drawer 2", exact=False).first.wait_for()
    tab.page.screenshot(path=str(tmp_path / "held.png"))
    tab.key("Enter")
    wait_until(lambda: tab.object is obj and tab.selection.step == "Review", "its review")
    worst = obj.validation.report.joints[0].worst
    wait_until(lambda: tab.app.motion.q == dict(worst.q), "the worst pose")
    tab.drawn()
    tab.page.screenshot(path=str(tmp_path / "inside.png"))
