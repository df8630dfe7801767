"""Joints in the picture: limits and a tree that are dragged, views, one part alone, measuring."""

from typing import Any

import numpy as np
import pytest

from app.viewer.picture.joint_handles import Side
from tests.browser.browsing import Tab, wait_until
from tests.browser.test_main_job import annotate, predict


def test_limits_parents_views_and_lengths_in_the_picture(
    start: Any, open_tab: Any, cabinet: Any
) -> None:
    path, points = cabinet
    tab = open_tab(start(path))
    annotate(tab, points)
    predict(tab)
    tab.page.locator('[data-press="joint"][value="link_1"]').click()
    wait_until(lambda: tab.selection.child == "link_1", "a click in the tree chooses the joint")
    check_the_axis_handles(tab)
    check_the_limits(tab)
    check_the_tree(tab)
    check_the_views(tab)
    check_one_part_alone(tab)
    check_measuring(tab)


def check_the_axis_handles(tab: Tab) -> None:
    """The axis is pulled, and the likely motions stay in the picture: M takes the first of them."""
    before = tab.document.tree.joint_of["link_1"]
    tab.button("Axis handles (G)").click()
    tab.wait_node("/gizmo")
    tab.drawn()
    # The handle along x: grab its arrow and pull.
    tip = np.asarray(before.origin) + np.array([0.15 * tab.object.asset.diagonal, 0, 0])
    assert drag_until_moved(tab, tip, tab.pixel(before.origin), before)
    after = tab.document.tree.joint_of["link_1"]
    assert np.linalg.norm(np.subtract(after.origin, before.origin)) > 1e-3
    tab.wait_node("/axis/likely-1")
    tab.wait_node("/axis/likely-2")
    tab.key("m")
    wait_until(lambda: tab.document.tree.joint_of["link_1"].origin == before.origin, "the first")
    tab.key("m")
    other = tab.document.prediction.alternatives["link_1"][0]
    wait_until(lambda: tab.document.tree.joint_of["link_1"].origin == other.origin, "the second")
    tab.button("Reset to prediction").click()
    wait_until(lambda: tab.document.tree.joint_of["link_1"] == before, "reset")
    tab.button("Axis handles (G)").click()
    handle = tab.app.tab.client.scene.get_handle_by_name
    wait_until(lambda: handle("/gizmo") is None, "the handles are off")
    tab.step("Review")
    wait_until(lambda: handle("/axis/likely-2") is None, "M takes none of them here")
    tab.step("Joints")


def drag_until_moved(tab: Tab, tip: np.ndarray, origin: tuple[float, float], before: Any) -> bool:
    """Pull at points along the gizmo's x arrow until one is its handle."""
    x0, y0 = origin
    x1, y1 = tab.pixel(tip)
    for share in (1.0, 0.8, 1.2, 0.6, 1.4, 0.4):
        x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
        tab.page.mouse.move(x, y)
        tab.frames(3)  # the page sees what is under the pointer when it draws
        tab.page.mouse.down()
        tab.page.mouse.move(x + 0.5 * (x1 - x0), y + 0.5 * (y1 - y0), steps=6)
        tab.frames(2)
        tab.page.mouse.up()
        try:
            wait_until(
                lambda: tab.document.tree.joint_of["link_1"].origin != before.origin, "moved", 8.0
            )
        except AssertionError:
            continue
        return True
    return False


def check_the_limits(tab: Tab) -> None:
    """A grip is dragged: the part follows, and letting go is one command; Shift snaps."""
    before = tab.document.tree.joint_of["link_1"]
    pull(tab, "upper", np.radians(61.0))
    wait_until(lambda: tab.document.tree.joint_of["link_1"] != before, "the limit is set")
    after = tab.document.tree.joint_of["link_1"]
    assert np.degrees(after.upper) == pytest.approx(61.0, abs=1.5)
    assert after.lower == before.lower
    tab.key("Control+z")
    wait_until(lambda: tab.document.tree.joint_of["link_1"] == before, "one undo takes it back")
    tab.drawn()
    pull(tab, "lower", np.radians(-23.0), "Shift")
    wait_until(lambda: tab.document.tree.joint_of["link_1"] != before, "the other limit is set")
    lower = np.degrees(tab.document.tree.joint_of["link_1"].lower)
    assert lower == pytest.approx(5 * round(lower / 5), abs=1e-6) and -30.1 < lower < -14.9
    tab.key("Control+z")
    wait_until(lambda: tab.document.tree.joint_of["link_1"] == before, "undone as well")


def pull(tab: Tab, side: Side, q: float, key: str | None = None) -> None:
    """Drag a grip of the selected joint to where ``q`` is."""
    limits = tab.app.motion.limits
    wait_until(lambda: limits.gauge is not None, "the gauge is drawn")
    tab.wait_node(f"/limits/{side}")
    tab.drawn()
    page, joint = tab.page, tab.selection.joint
    page.mouse.move(*tab.pixel(limits.gauge.place(getattr(joint, side))))
    tab.frames(3)  # the page sees what is under the pointer when it draws
    page.mouse.down()
    if key:
        page.keyboard.down(key)
    page.mouse.move(*tab.pixel(limits.gauge.place(q)), steps=6)
    tab.frames(2)
    wait_until(lambda: tab.app.motion.q.get(joint.name), "the part follows")
    page.mouse.up()
    if key:
        page.keyboard.up(key)


def check_the_tree(tab: Tab) -> None:
    """A part is dragged onto another one, and back by two clicks."""
    page = tab.page
    wait_until(lambda: not tab.object.busy, "the checks, which draw the rows again, are done")
    tab.drawn()
    page.drag_and_drop('.aw-node[data-link="link_1"]', '.aw-node[data-link="link_2"]')
    wait_until(lambda: tab.document.tree.joint_of["link_1"].parent == "link_2", "it hangs there")
    tab.drawn()
    page.get_by_role("button", name="Set parent").click()
    wait_until(lambda: tab.app.pointing.armed == "parent", "it is asked for")
    tab.drawn()
    page.locator('[data-press="joint"][value="link_0"]').click()
    wait_until(lambda: tab.document.tree.joint_of["link_1"].parent == "link_0", "and back")
    assert tab.app.pointing.armed == ""
    tab.app.motion.reset()
    tab.drawn()


def check_the_views(tab: Tab) -> None:
    """The number pad and the corner turn the camera; what is looked at stays."""
    camera = tab.app.tab.client.camera
    at = np.array(camera.look_at)

    def looks(along: tuple[float, float, float]) -> bool:
        away = np.asarray(camera.position) - camera.look_at
        return bool(away / np.linalg.norm(away) @ along > 0.999)

    for act, along in (
        (lambda: tab.key("Numpad1"), (0.0, -1.0, 0.0)),
        (lambda: tab.key("Control+Numpad3"), (-1.0, 0.0, 0.0)),
        (lambda: tab.page.get_by_role("button", name="View from +Z").click(), (0.0, 0.0, 1.0)),
    ):
        act()
        wait_until(lambda along=along: looks(along), f"looks from {along}")
        tab.camera_at_rest()
    assert np.allclose(camera.look_at, at, atol=1e-3)
    assert tab.selection.step == "Joints", "the number pad's digits choose no part"

    def extent() -> float:
        """Half the height of what is seen at the place that the camera looks at."""
        return np.linalg.norm(camera.position - camera.look_at) * np.tan(camera.fov / 2)

    before = pytest.approx(extent(), rel=1e-2)
    tab.key("Numpad5")
    wait_until(lambda: camera.fov < 0.1 and extent() == before, "flat, and as large as before")
    tab.key("Numpad5")
    wait_until(lambda: camera.fov > 0.5, "perspective again")


def check_one_part_alone(tab: Tab) -> None:
    """The slash hides all but the selected joint's part, and brings them back."""
    tab.key("/")
    wait_until(lambda: tab.selection.hidden == {0, 2}, "the door alone")
    tab.key("/")
    wait_until(lambda: not tab.selection.hidden, "all again")


def check_measuring(tab: Tab) -> None:
    """Two clicks near corners give the length between the corners; Escape ends."""
    tab.app.tab.act(tab.app.picture.frame_camera)
    tab.key("Shift+M")
    wait_until(lambda: tab.app.pointing.armed == "measure", "the next clicks measure")
    scene = tab.app.tab.client.scene
    for k, x in enumerate((-0.3995, 0.3995)):
        tab.drawn()
        tab.camera_at_rest()  # another hint may give the picture another size
        tab.click3d((x, 0.2245, 0.6))  # the front has the door's corners beside
        wait_until(lambda k=k: scene.get_handle_by_name(f"/measure/{k}"), "the place is marked")
    label = wait_until(lambda: scene.get_handle_by_name("/measure/label"), "the length is shown")
    assert label.text == "80.0 cm"
    tab.key("Escape")
    wait_until(lambda: scene.get_handle_by_name("/measure/line") is None, "Escape removes it")
