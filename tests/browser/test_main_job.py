"""The main job in a real browser: open, click, predict, move, edit, accept; and nothing is lost."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from model.core.joint import motion
from sessions.commands import SetCategory
from tests.browser.browsing import COARSE, Tab, wait_until
from tests.browser.objects import write_cloud

MASK = r"Mask (\d+) of (\d+): \d"


def annotate(tab: Tab, points: dict[str, np.ndarray]) -> None:
    """Door as part 1 by a click, drawer as part 2 after its number key; both are named."""
    tab.prompt(points["door"])
    tab.choose("Part name", "door")
    wait_until(lambda: tab.document.part_names.get(1) == "door", "part 1 is a door")
    tab.key("2")
    wait_until(lambda: tab.selection.part == 2, "key 2 chooses part 2")
    tab.prompt(points["drawer"])
    tab.choose("Part name", "drawer")
    wait_until(lambda: tab.document.part_names.get(2) == "drawer", "part 2 is a drawer")


def predict(tab: Tab) -> None:
    tab.button("Predict joints (P)").first.click()
    wait_until(lambda: tab.document.tree is not None, "a kinematic tree")
    wait_until(lambda: tab.selection.step == "Joints", "the joints are shown")
    tab.wait_node("/part/1")


def test_parts_are_named_with_one_click_each(start: Any, open_tab: Any, cabinet: Any) -> None:
    """Where they are clicked, or where their joints are looked at; the last word predicts again."""
    path, points = cabinet
    tab = open_tab(start(path))
    for _ in range(3):
        tab.key("Control+z")
        tab.page.get_by_text("Nothing to undo").wait_for()
    assert not tab.page.locator(".mantine-Notification-root:visible").count(), "no pile of notes"
    tab.prompt(points["door"])
    tab.button("door").click()
    wait_until(lambda: tab.document.part_names == {1: "door"}, "part 1 is a door")
    tab.page.locator('.aw-names [aria-pressed="true"]', has_text="door").wait_for()
    for key, place in (("2", "drawer"), ("3", "base")):
        tab.key(key)
        wait_until(lambda key=key: tab.selection.part == int(key), "the key chooses the part")
        tab.page.get_by_text("Pick a name", exact=False).wait_for()
        tab.prompt(points[place])
    predict(tab)
    before = tab.document.prediction
    # The question is about the joint that is shown, as long as its part has no name.
    tab.page.get_by_text("What is part 2?").wait_for()
    assert tab.selection.child == "link_2"
    tab.selection.choose_joint("link_3")
    tab.page.get_by_text("What is part 3?").wait_for()
    tab.selection.choose_joint("link_1")
    tab.page.get_by_text("What is part 2? (The selected part is named").wait_for()
    tab.button("drawer").click()
    tab.page.get_by_text("What is part 3?").wait_for()
    assert tab.selection.child == "link_3" and tab.document.prediction is before
    # What no button says stands in a list, as in Annotate.
    tab.choose("Part name", "seat")
    tab.button("lid").wait_for(state="hidden")
    assert tab.document.part_names == {1: "door", 2: "drawer", 3: "seat"}
    tab.page.get_by_text("What is the object?").wait_for()
    assert tab.document.prediction is before
    tab.choose("Category", "StorageFurniture")
    wait_until(lambda: tab.document.prediction is not before, "joints are predicted anew")
    assert tab.document.category == "StorageFurniture"
    assert tab.document.tree.joint_of["link_2"].type == "prismatic"
    tab.page.get_by_text("What is the object?").wait_for(state="hidden")
    # Where a joint was changed by hand the question stays, and the answer predicts nothing.
    wait_until(lambda: not tab.object.busy, "the gate has judged")
    predicted = tab.document.prediction
    tab.object.do(SetCategory(None), "tester")
    tab.app.motion.stop()
    tab.key("f")
    wait_until(lambda: tab.document.edited_joints, "a joint is flipped")
    tab.page.get_by_text("What is the object?").wait_for()
    tab.choose("Category", "Table")
    wait_until(lambda: tab.document.category == "Table", "the category is said")
    assert tab.document.edited_joints and "predict" not in tab.object.jobs
    assert tab.document.prediction is predicted


def test_names_and_category_have_keys(start: Any, open_tab: Any, cabinet: Any) -> None:
    """Shift and a number picks the name of the part that the next click makes, or says it where its
    joint is looked at; the category is a guess by the file's name until it is taken, and a list
    changes it."""
    path, points = cabinet
    tab = open_tab(start(path))
    tab.button("StorageFurniture?").wait_for()
    assert tab.document.category is None, "a guess is said by nobody"
    tab.key("Shift+Digit1")
    tab.page.get_by_text("New door: click on it").wait_for()
    tab.prompt(points["door"])
    tab.page.get_by_text("New door: click on it").wait_for(state="hidden")
    assert tab.document.part_names == {1: "door"}, "made and named by one click"
    tab.key("Control+z")
    wait_until(lambda: tab.document.part(1) is None, "and taken back by one undo")
    tab.key("Control+Shift+z")
    wait_until(lambda: tab.document.part_names == {1: "door"}, "a door again")
    tab.button("door").click()  # the next one
    wait_until(lambda: tab.app.pointing.tools.label == "door", "another door is picked")
    assert tab.selection.part == 2
    tab.key("Escape")
    wait_until(lambda: not tab.app.pointing.tools.label, "Escape ends that")
    tab.key("2")
    wait_until(lambda: tab.selection.part == 2, "key 2 chooses part 2")
    tab.page.get_by_text("Pick a name", exact=False).wait_for()
    tab.prompt(points["drawer"])
    predict(tab)
    before = tab.document.prediction
    tab.page.get_by_text("What is part 2?").wait_for()
    tab.key("Shift+Digit2")
    tab.page.get_by_text("What is the object?").wait_for()
    assert tab.document.part_names == {1: "door", 2: "drawer"}
    assert tab.document.prediction is before
    tab.key("Shift+Digit0")
    wait_until(lambda: tab.document.prediction is not before, "joints are predicted anew")
    assert tab.document.category == "StorageFurniture"
    tab.page.get_by_text("What is the object?").wait_for(state="hidden")
    tab.step("Annotate")
    assert not tab.button("StorageFurniture?").is_visible()
    tab.choose("Category", "Table")
    wait_until(lambda: tab.document.category == "Table", "another category in one step")
    # While something is typed the keys are letters.
    tab.key("2")
    wait_until(lambda: tab.selection.part == 2, "key 2 chooses part 2")
    tab.choose("Part name", "Other…")
    tab.field("Other name").click()
    tab.key("Shift+Digit3")
    wait_until(lambda: tab.document.part_names == {1: "door", 2: "#"}, "what was typed")


def test_click_predict_move_edit_accept(
    start: Any, open_tab: Any, cabinet: Any, tmp_path: Path
) -> None:
    path, points = cabinet
    server = start(path, workspace=tmp_path / "workspace")
    tab = open_tab(server)
    annotate(tab, points)
    labels = tab.object.services.store.get_array(tab.document.segmentation.labels)
    assert len(labels) == tab.object.asset.element_count
    predict(tab)
    tree = tab.document.tree
    door, drawer = tree.joint_of["link_1"], tree.joint_of["link_2"]
    assert tree.root == "link_0"
    assert (door.type, drawer.type) == ("revolute", "prismatic")
    assert abs(door.axis[2]) > 0.99
    assert drawer.axis[1] < -0.99

    # The tree scrolls by itself, however many joints there are.
    style = "() => getComputedStyle(document.querySelector('.aw-tree')).overflowY"
    wait_until(lambda: tab.page.evaluate(style) == "auto", "the tree leaves room for the editor")

    # A slider moves the link; the drawn frame is where the kinematics says.
    tab.set_slider("drawer 2 [mm]", 100)
    wait_until(lambda: abs(tab.app.motion.q.get(drawer.name, 0) - 0.1) < 1e-6, "the slider moves q")
    frame = tab.app.tab.client.scene.get_handle_by_name("/part/2")
    wait_until(lambda: np.allclose(frame.position, (0, -0.1, 0), atol=1e-3), "the link moves")
    tab.set_slider("door 1 [°]", 45)
    wait_until(
        lambda: abs(tab.app.motion.q.get(door.name, 0) - math.pi / 4) < 1e-6, "the door turns"
    )
    frame = tab.app.tab.client.scene.get_handle_by_name("/part/1")
    expected = motion(door, math.pi / 4)[:3, 3]
    wait_until(lambda: np.allclose(frame.position, expected, atol=1e-4), "the door's frame")

    # Edit by number, then undo.
    tab.choose("Joint", "door 1")
    wait_until(lambda: tab.selection.child == "link_1", "the door is chosen")
    tab.set_number("Upper [°]", 110)
    upper = math.radians(110)
    wait_until(
        lambda: abs(tab.document.tree.joint_of["link_1"].upper - upper) < 1e-6, "the new limit"
    )
    tab.button("Undo").click()
    wait_until(lambda: tab.document.tree == tree, "undo brings the limit back")

    # What is refused leaves the fields, and is said in the unit that they have.
    tab.set_number("Upper [°]", -20)
    tab.page.get_by_text("lower limit 0° is above upper limit -20°").first.wait_for()
    assert tab.document.tree == tree
    shown = f"{math.degrees(door.upper):.1f}".removesuffix(".0")
    wait_until(lambda: tab.field("Upper [°]").input_value() == shown, "the limit that holds")
    tab.set_number("Axis", 0, index=2)
    tab.page.get_by_text("axis must not be zero").first.wait_for()
    wait_until(lambda: float(tab.field("Axis", 2).input_value()) == door.axis[2], "the axis")
    tab.button("Redo").click()
    wait_until(lambda: tab.document.tree != tree, "redo")

    # Accept; the asset on disk loads and moves alike.
    tab.step("Review")
    wait_until(lambda: not tab.object.busy, "sweeps are done")
    tab.button("Accept with edits (Y)").click()
    wait_until(lambda: tab.document.review.state == "accepted", "accepted")
    saved = wait_until(lambda: tab.document.saved, "saved")
    check_saved(Path(saved.folder), tab)


def check_saved(folder: Path, tab: Tab) -> None:
    import yourdfpy

    robot = yourdfpy.URDF.load(str(folder / "object.urdf"), load_meshes=True)
    tree = tab.document.tree
    q = {j.name: 0.4 * (j.upper or 1.0) for j in tree.joints if j.moves}
    assert list(robot.joint_map) == ["door_1_hinge", "drawer_2_slide"]
    robot.update_cfg(dict(zip(robot.joint_map, q.values(), strict=True)))
    posed = tree.pose(q)
    for link, name in {"link_0": "base", "link_1": "door_1", "link_2": "drawer_2"}.items():
        rest = np.eye(4)
        if link != tree.root:
            rest[:3, 3] = tree.joint_of[link].origin
        np.testing.assert_allclose(robot.get_transform(name, "base"), posed[link] @ rest, atol=1e-6)
    record = json.loads((folder / "provenance.json").read_text())
    assert record["source"]["sha256"]
    assert len(record["prompts"]) == 2
    assert json.loads((folder / "tree.json").read_text())
    assert any((folder / "meshes").iterdir())


def test_shift_click_box_removal_and_reject(start: Any, open_tab: Any, cabinet: Any) -> None:
    path, points = cabinet
    tab = open_tab(start(path))
    tab.prompt(points["door"])
    tab.prompt(points["base"], ("Shift",))
    clicks = tab.document.prompts
    assert [c.positive for c in clicks] == [True, False]
    asset = tab.object.asset
    labels = tab.object.services.store.get_array(tab.document.segmentation.labels)
    assert labels[clicks[0].element] == 1
    assert labels[clicks[1].element] != 1
    np.testing.assert_allclose(clicks[0].position, points["door"], atol=0.01 * asset.diagonal)

    # A box over the drawer's handle gives it to the chosen part.
    x, y = tab.pixel(points["drawer"])
    tab.drag_box((x - 30, y - 30), (x + 30, y + 30))
    wait_until(lambda: len(tab.document.prompts) == 3, "the box is a prompt")
    tab.settled()
    region = tab.document.prompts[2]
    chosen = tab.object.services.store.get_array(region.elements)
    labels = tab.object.services.store.get_array(tab.document.segmentation.labels)
    assert region.count == len(chosen) > 0
    assert (labels[chosen] == 1).all()

    tab.button("Last").click()
    wait_until(lambda: len(tab.document.prompts) == 2, "the last prompt is removed")
    tab.page.keyboard.press("Control+z")
    wait_until(lambda: len(tab.document.prompts) == 3, "Ctrl+Z brings it back")
    tab.page.keyboard.press("Control+Shift+z")
    wait_until(lambda: len(tab.document.prompts) == 2, "Ctrl+Shift+Z removes it again")
    tab.settled()
    check_reject_with_a_reason(tab, points)


def check_reject_with_a_reason(tab: Tab, points: dict[str, np.ndarray]) -> None:
    tab.step("Review")
    tab.field("Comment").fill("the drawer is missing <b>{1+1}</b>")
    wait_until(lambda: tab.app.review.comment_text.startswith("the drawer"), "the comment")
    tab.button("Reject (X)").click()
    tab.button("4 parts").click()
    wait_until(lambda: tab.document.review.state == "rejected", "rejected")
    tab.page.get_by_text("cabinet: back to annotation").wait_for()
    assert tab.document.review.reason == "parts"
    assert tab.document.review.comment == "the drawer is missing <b>{1+1}</b>"
    # The words show as they were typed: neither HTML nor an expression.
    wait_until(
        lambda: "<b>{1+1}</b>" in tab.page.locator("body").inner_text(), "the comment as text"
    )
    tab.step("Annotate")
    tab.prompt(points["drawer"])
    wait_until(lambda: tab.document.review.state == "in_progress", "its annotator goes on")


def test_numbers_and_delete(start: Any, open_tab: Any, cabinet: Any) -> None:
    path, points = cabinet
    tab = open_tab(start(path))
    tab.prompt(points["door"])
    # A click into the air says so.
    hint = tab.page.locator("#artiworld-hint")
    tab.page.mouse.click(330, 760)
    wait_until(lambda: hint.inner_text() == "Nothing there", "the click met nothing")
    # A number alone is no part yet: it comes with its first click, and goes with its undo.
    edits = tab.document.edits
    for number in ("5", "4"):
        tab.key(number)
        wait_until(lambda number=number: tab.selection.part == int(number), f"part {number}")
    assert tab.document.edits == edits and [p.id for p in tab.document.parts] == [0, 1]
    tab.prompt(points["drawer"])
    assert [p.id for p in tab.document.parts] == [0, 1, 4]
    # Delete takes the chosen part away, but not while somebody types.
    box = tab.field("Your name")
    box.fill("me")
    box.press("Home")
    box.press("Delete")
    box.press("Enter")
    wait_until(lambda: tab.app.tab.user == "e", "a letter is deleted")
    tab.drawn()
    assert box.input_value() == "e" and tab.document.edits == edits + 1
    tab.wait_for_keyboard()
    tab.key("Delete")
    wait_until(lambda: [p.id for p in tab.document.parts] == [0, 1], "the part is deleted")
    tab.key("Control+z")
    wait_until(lambda: len(tab.document.prompts) == 2, "undo brings it back")
    tab.key("Control+z")
    wait_until(lambda: [p.id for p in tab.document.parts] == [0, 1], "a click and its part")
    # What is typed into a list replaces what stands there, and Enter takes the first that fits.
    tab.field("Category").click()
    tab.page.keyboard.type("refr")
    tab.page.keyboard.press("Enter")
    wait_until(lambda: tab.document.category == "Refrigerator", "the category is chosen")
    check_a_note_shows_the_whole_path(tab)


def check_a_note_shows_the_whole_path(tab: Tab) -> None:
    """A long path was cut off where it says which file."""
    place = "/home/somebody/with_a_long_name/workspace_of_today/assets/cabinet-1"
    tab.object.notify("Accepted", f"Saved in {place}", "green")
    note = tab.page.get_by_text(place, exact=False)
    note.wait_for()
    assert note.evaluate("e => e.scrollWidth <= e.clientWidth")


def test_two_tabs_show_the_same(start: Any, open_tab: Any, cabinet: Any) -> None:
    path, points = cabinet
    server = start(path)
    first = open_tab(server)
    one = first.app
    second = open_tab(server)
    assert second.app is not one
    second.prompt(points["door"])
    wait_until(lambda: len(one.tab.selection.object.document.prompts) == 1, "the first tab's state")
    first.wait_node("/prompt/0")
    first.wait_node("/tint/1")
    second.page.close()
    # A reload shows the saved state.
    first.page.reload()
    first.ready()
    first.wait_node("/prompt/0")
    first.wait_node("/tint/1")


def test_next_object_and_a_cloud(start: Any, open_tab: Any, cabinet: Any, tmp_path: Path) -> None:
    path, _ = cabinet
    chest = tmp_path / "chest.ply"
    points = write_cloud(chest)
    tab = open_tab(start(path, chest))
    tab.page.keyboard.press("n")
    wait_until(lambda: tab.object.record.name == "chest", "the next object")
    wait_until(lambda: tab.app.drawing.drawn, "the chest is open")
    tab.camera_at_rest()
    tab.prompt(points["lid"])
    wait_until(lambda: tab.document.segmentation_current, "labels")
    predict(tab)
    assert tab.document.tree.joint_of["link_1"].moves
    tab.page.keyboard.press(" ")
    wait_until(lambda: any(abs(v) > 0.01 for v in tab.app.motion.q.values()), "Space plays")
    tab.page.keyboard.press("r")
    wait_until(lambda: not any(tab.app.motion.q.values()), "R resets the pose")


def test_a_file_that_cannot_be_opened_says_so(
    start: Any, open_page: Any, tmp_path: Path, cabinet: Any
) -> None:
    bad = tmp_path / "a_bad.ply"
    bad.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\n")
    server = start(bad, cabinet[0])
    page = open_page(f"{server.url}{COARSE}")
    wait_until(lambda: server.apps, "the server sees the tab")
    selection = server.apps[max(server.apps)].tab.selection
    wait_until(
        lambda: selection.object is not None and selection.object.problem, "the problem is known"
    )
    page.get_by_text("a_bad.ply").first.wait_for()
    hint = page.get_by_text("Pick a name", exact=False)
    hint.wait_for(state="hidden")
    again = page.get_by_role("button", name="Retry")
    again.wait_for()
    page.get_by_role("button", name="Remove").click()
    wait_until(lambda: selection.object.asset is not None, "the next object is open")
    assert len(server.app_state.queue.records()) == 1
    page.get_by_role("button", name="Restore a_bad").click()
    again.wait_for()
    bad.write_bytes(cabinet[0].read_bytes())
    again.click()
    wait_until(lambda: selection.object.asset is not None, "it opens once the file is mended")
    hint.wait_for()
    again.wait_for(state="hidden")
    page.keyboard.press("n")
    wait_until(lambda: selection.object.asset is not None, "the next one opens all the same")


def test_uploads_join_the_queue(start: Any, open_tab: Any, cabinet: Any, tmp_path: Path) -> None:
    path, _ = cabinet
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    write_cloud(folder / "chest.ply")
    (folder / "notes.docx").write_bytes(b"not a mesh")
    tab = open_tab(start(path))
    chooser = tab.page.locator('input[type="file"]').first
    chooser.set_input_files(str(folder / "notes.docx"))
    tab.page.get_by_text("unknown kind of file", exact=False).first.wait_for()
    assert len(tab.server.app_state.queue.records()) == 1
    chooser.set_input_files(str(folder / "chest.ply"))
    wait_until(lambda: tab.object.record.name == "chest", "the upload is open")
    wait_until(lambda: tab.object.asset is not None, "it is read")
    assert tab.object.asset.element_kind == "point"
    check_an_obj_is_uploaded_with_its_texture(tab, tmp_path)


def check_an_obj_is_uploaded_with_its_texture(tab: Tab, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "tri.obj").write_text(
        "mtllib tri.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
        "f 1/1 2/2 3/3\n"
    )
    (folder / "tri.mtl").write_text("newmtl a\nmap_Kd oak.png\n")
    Image.new("RGB", (4, 4), (200, 100, 50)).save(folder / "oak.png")
    chosen = [folder / "oak.png", folder / "tri.mtl", folder / "tri.obj"]
    with tab.page.expect_file_chooser() as chooser:
        tab.button("Add files").click()
    chooser.value.set_files([str(p) for p in chosen])
    wait_until(lambda: tab.object.record.name == "tri", "the new object is open")
    asset = wait_until(lambda: tab.object.asset, "it is read")
    assert not asset.warnings
    kept = asset.source.path.parent
    assert {p.name for p in kept.iterdir()} == {"oak.png", "tri.mtl", "tri.obj"}


def test_a_lying_object_in_another_unit_is_prepared(
    start: Any, open_tab: Any, cabinet: Any
) -> None:
    path, points = cabinet
    tab = open_tab(start(path))
    tab.prompt(points["door"])
    before = tab.object.asset.bounds[1] - tab.object.asset.bounds[0]
    tab.step("Prepare")
    tab.row("Rotate 90°").get_by_role("button", name="X", exact=True).click()
    wait_until(lambda: tab.document.label == "rotate 90° about X", "it is rotated")
    wait_until(lambda: tab.object.asset is not None, "it is read again")
    tab.choose("File's unit", "millimetres")
    wait_until(lambda: tab.document.unit_scale == 0.001, "another unit")
    wait_until(lambda: tab.object.asset is not None, "it is read again")
    size = tab.object.asset.bounds[1] - tab.object.asset.bounds[0]
    np.testing.assert_allclose(size, before[[0, 2, 1]] * 0.001, rtol=1e-5)
    assert not tab.document.prompts
    tab.step("Annotate")
    tab.page.get_by_text("0.8 mm wide: is the file in metres?").first.wait_for()
    tab.key("Enter")
    wait_until(lambda: tab.selection.step == "Prepare", "the step that asks")
    tab.key("Enter")
    wait_until(lambda: tab.document.unit_scale == 1.0, "the file is in metres")
    wait_until(lambda: tab.object.asset is not None, "it is read again")
    for _ in range(3):
        tab.page.keyboard.press("Control+z")
    wait_until(lambda: len(tab.document.prompts) == 1, "undo brings the old reading back")


def below_the_picture(tab: Tab) -> bool:
    picture = tab.page.locator("canvas").first.bounding_box()
    hint = tab.page.locator("#artiworld-hint").bounding_box()
    middles = [b["x"] + b["width"] / 2 for b in (picture, hint)]
    return abs(middles[0] - middles[1]) < 2


def test_tools_offer_other_masks(start: Any, open_tab: Any, cabinet: Any) -> None:
    path, points = cabinet
    tab = open_tab(start(path))
    store = tab.server.app_state.store
    tab.prompt(points["door"])
    first = store.get_array(tab.document.segmentation.labels)
    tab.page.keyboard.press("Tab")
    wait_until(lambda: len(tab.document.prompts) > 1, "Tab offers another mask")
    tab.settled()
    second = store.get_array(tab.document.segmentation.labels)
    assert (first != second).any()
    assert second[tab.document.prompts[0].element] == 1
    tab.page.get_by_text("1 on this part, 1 in total").wait_for()
    hint = tab.page.locator("#artiworld-hint")
    said = wait_until(lambda: re.match(MASK, hint.inner_text()), "the page says which mask it is")
    at, total = map(int, said.groups())
    tab.page.keyboard.press("Shift+Tab")
    smaller = f"Mask {(at - 2) % total + 1} of "
    wait_until(lambda: hint.inner_text().startswith(smaller), "Shift+Tab goes back")
    tab.settled()
    np.testing.assert_array_equal(store.get_array(tab.document.segmentation.labels), first)
    tab.page.keyboard.press("Tab")
    wait_until(lambda: hint.inner_text().startswith(f"Mask {at} of "), "and Tab on again")
    # It stays below the middle of the picture in a window of another size, and after a reload.
    tab.page.set_viewport_size({"width": 1000, "height": 700})
    wait_until(lambda: below_the_picture(tab), "the hint follows the picture")
    tab.page.reload()
    tab.ready()
    wait_until(lambda: hint.inner_text().startswith(f"Mask {at} of "), "the hint is back")
    wait_until(lambda: below_the_picture(tab), "where it belongs")
    # Clicks in vain: they say what the mask shows already.
    tab.prompt(points["door"])
    wait_until(lambda: not hint.is_visible(), "a click ends it")
    tab.page.keyboard.press("Tab")
    wait_until(lambda: re.match(MASK, hint.inner_text()), "the next click has masks anew")
    while tab.object.state.can_undo and len(tab.document.prompts) > 1:
        tab.app.commands.undo()
    tab.settled()
    np.testing.assert_array_equal(store.get_array(tab.document.segmentation.labels), first)
    tab.button("All parts").click()
    wait_until(lambda: len(tab.document.parts) > 2, "parts are proposed")
    tab.settled()
    assert len(np.unique(store.get_array(tab.document.segmentation.labels))) > 2
