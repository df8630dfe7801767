"""A real scanned kitchen that nobody has labelled: two objects are clicked out of it, articulated
in place, and the room is saved with them where they stood."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from app.server import tasks
from app.viewer.words.review import FIXES
from model.geometry.crop import largest_component
from model.geometry.picking import Picker
from model.io.open_asset import open_asset
from model.segmentation.prompts import iou, next_click
from model.validation.report import Severity
from tests.browser.browsing import SceneTab, wait_until
from tests.model.scenes.saved import points_in_place

REFRIGERATOR = ((2.40, 0.29, 0.06), (2.80, 1.24, 2.17))
CABINET = ((2.50, 2.72, 0.06), (2.97, 3.60, 0.88))
FRONT = ((2.72, 0.40, 0.62), (2.76, 1.20, 2.04))
DOOR = ((2.93, 2.95, 0.14), (2.96, 3.40, 0.70))
"""Where they stand in the room, and the door of each, metres."""
EYES = ((6.6, 1.9, 2.4), (5.2, 3.1, 2.6))
"""From where the one and the other are seen whole."""


BETWEEN_PANELS = ((0.22, 0.05), (0.68, 0.95))
"""Of the picture, what no panel covers."""
"""Seconds that collision shapes of a scan may take where the machine is busy."""
MOVING = ("PhysicsRevoluteJoint", "PhysicsPrismaticJoint")


class RoomTab(SceneTab):
    """A tab that shows a room, and a person who looks and clicks."""

    clicks = 0

    @property
    def origin(self) -> np.ndarray:
        """Of the open object's frame in the room; it isn't turned there."""
        scene, id = self.scene_workspace, self.scene.choice.inside
        world = wait_until(
            lambda: (found := scene.world_from_copy(scene.items[id])) is not None and (found,),
            "its size is known",
        )
        return world[0][:3, 3]

    def press(self, text: str) -> None:
        button = self.button(text).locator("visible=true").first
        button.scroll_into_view_if_needed()
        button.click()
        self.clicks += 1

    def look(self, eye: Any, at: Any) -> None:
        """Orbit to where ``at`` is seen from ``eye``; both in the room."""
        camera = self.app.tab.client.camera
        with self.app.tab.client.atomic():
            camera.position = np.asarray(eye) - self.origin
            camera.look_at = np.asarray(at) - self.origin
        spot = np.asarray(at) - self.origin
        wait_until(lambda: np.abs(self.pixel(spot) - self.middle()).max() < 3, "it looks there")

    def middle(self) -> np.ndarray:
        """Pixel in the middle of the picture."""
        x, y, width, height = self.canvas()
        return np.array([x + width / 2, y + height / 2])

    def canvas(self) -> list[float]:
        """Left, top, width and height of the picture."""
        return self.page.evaluate(
            "() => { const b = window.__viserMutable.canvas.getBoundingClientRect();"
            " return [b.left, b.top, b.width, b.height]; }"
        )

    def box(self, low: Any, high: Any) -> None:
        """Drag a box round what stands between two corners, with Alt."""
        corners = np.array([np.where([i >> k & 1 for k in range(3)], high, low) for i in range(8)])
        at = np.array([self.pixel(c - self.origin) for c in corners])
        before = len(self.document.prompts)
        self.drag_box(at.min(0), at.max(0))
        self.clicks += 1
        wait_until(lambda: len(self.document.prompts) > before, "the box is a prompt")
        self.settled()

    def open_room(self, eye: Any, at: Any) -> None:
        """Open the whole room to pick from, and look at a spot."""
        if self.scene.choice.selected != "room":  # it is chosen at first: there is nothing else
            self.page.get_by_role("button", name="room").first.click()
            self.clicks += 1
        wait_until(lambda: self.scene.choice.selected == "room", "the room is chosen")
        self.press("Extract an object")
        wait_until(lambda: self.selection.picking and self.app.drawing.drawn, "the room is open")
        self.wait_node("/scan")
        wait_until(lambda: "encode" not in self.object.busy, "it can be clicked on")
        self.look(eye, at)

    def aim(self, low: Any, high: Any) -> None:
        """Remember what stands between two corners as wanted, and what of it is to be seen."""
        asset = tasks.asset_of(self.object.asset.folder)
        self.points = asset.element_centers + self.origin
        wanted = ((self.points >= low) & (self.points <= high)).all(1)
        wanted[np.flatnonzero(wanted)[~largest_component(self.points[wanted])]] = False
        self.wanted = wanted
        self.seen = Picker(asset).select_box(self.app.queries.camera(), *BETWEEN_PANELS)

    @property
    def labels(self) -> np.ndarray:
        labels = self.object.labels
        return np.zeros(len(self.points), int) if labels is None else labels

    @property
    def reached(self) -> float:
        """IoU of the chosen part with what is wanted."""
        return iou(self.labels == self.selection.part, self.wanted)

    def click_until(self, good: float, most: int) -> None:
        """Click the middle of the largest visible error, as a person would, until it is good."""
        for _ in range(most):
            if self.reached >= good:
                return
            seen = self.seen
            answer = (self.labels == self.selection.part)[seen]
            found = next_click(self.points[seen], self.wanted[seen], answer)
            assert found is not None, f"nothing wrong is to be seen at IoU {self.reached:.2f}"
            spot = self.points[seen][found[0]] - self.origin
            self.prompt(spot, () if found[1] else ("Shift",))
            self.clicks += 1

    def cut(self, y: float) -> None:
        """Cut what was clicked by two clicks, one above the other; choose what is wanted of it."""
        before = len(self.document.prompts)
        self.key("k")
        wait_until(lambda: self.app.pointing.armed == "cut", "cut waits for places")
        mine = self.seen[self.labels[self.seen] == self.selection.part]
        off = [np.abs(self.points[mine] - [0, y, z])[:, 1:].sum(1) for z in (0.25, 0.7)]
        self.click_places(*(self.points[mine[o.argmin()]] - self.origin for o in off))
        wait_until(lambda: len(self.document.prompts) > before, "the part is cut")
        self.settled()
        part = int(np.bincount(self.labels[self.wanted & (self.labels > 0)]).argmax())
        if part != self.selection.part:
            self.key(str(part))
            wait_until(lambda: self.selection.part == part, "the wanted side is chosen")
        self.clicks += 4

    def take_out(self, name: str) -> str:
        """Make an object of what is chosen in the room; its id."""
        self.field("Name").fill(name)
        self.press("Extract")
        wait_until(
            lambda: (self.scene.choice.inside or "").startswith(name) and self.app.drawing.drawn,
            "it is open",
        )
        self.wait_node("/scan")
        wait_until(lambda: "encode" not in self.object.busy, "it can be clicked on")
        return self.scene.choice.inside

    def swing_open(self, degrees: int) -> None:
        """Predict the door's joint, limit it, accept it, and go back to the room."""
        self.key("p")
        tree = wait_until(lambda: self.document.tree, "a kinematic tree")
        (joint,) = tree.joints
        assert joint.type == "revolute" and abs(joint.axis[2]) > 0.9  # an upright hinge
        assert joint.lower == 0.0  # as it was scanned it is closed
        wait_until(lambda: self.selection.step == "Joints", "the joints are shown")
        self.set_number("Upper [°]", degrees)
        upper = np.radians(degrees)
        wait_until(lambda: abs(self.document.tree.joints[0].upper - upper) < 0.008, "the limit")
        obj = self.object
        self.step("Review")
        for _ in range(3):
            report = wait_until(lambda: not obj.busy and obj.validation.report, "the gate's answer")
            if report.severity != Severity.ERROR:
                break
            # A scan's door may graze its body: a person takes the range that is free.
            self.button(FIXES["limits"]).first.click()
            self.clicks += 1
            wait_until(lambda seen=report: obj.validation.report is not seen, "the gate asks again")
        assert report.severity != Severity.ERROR
        accept = (
            self.page.get_by_role("button", name=re.compile("^Accept"))
            .locator("visible=true")
            .first
        )
        accept.click()
        if report.severity == Severity.WARNING:  # it is shown first
            self.clicks += 1
            wait_until(lambda: self.app.review.validation_list.looked_at(obj), "it was shown")
            self.wait_seen()
            accept.click()
        self.clicks += 4
        wait_until(lambda: obj.document.review.state == "accepted", "accepted")
        wait_until(lambda: self.scene.choice.inside is None or self.object is not obj, "it goes on")
        if self.scene.choice.inside is not None:
            self.press("Back to the scene (Backspace)")
        wait_until(lambda: self.object is None, "back in the room")


def test_two_objects_come_out_of_a_real_room(
    start: Any, open_tab: Any, shared_data: Path, tmp_path: Path
) -> None:
    mujoco = pytest.importorskip("mujoco")
    scan = shared_data / "scans" / "scannet" / "scene0011_00.ply"
    if not scan.exists():
        pytest.skip(f"{scan} is not here")
    room = tmp_path / "kitchen.ply"  # without the labels that lie beside it there
    shutil.copyfile(scan, room)
    tab = open_tab(start(scene=room, predictor="geometric"), kind=RoomTab)
    assert list(tab.scene_workspace.items) == ["room"] and tab.status("room") == "static"

    tab.open_room(EYES[0], np.mean(REFRIGERATOR, axis=0))
    tab.aim(*REFRIGERATOR)
    tab.click_until(0.85, 8)
    assert tab.reached >= 0.85
    first = tab.take_out("refrigerator")
    tab.look(EYES[0], np.mean(REFRIGERATOR, axis=0))
    tab.box(*FRONT)
    tab.swing_open(110)
    tab.open_room(EYES[1], np.mean(CABINET, axis=0))
    tab.aim(*CABINET)
    # It stands in a row of cabinets with one front: two straight cuts tell it apart.
    tab.click_until(0.35, 2)
    tab.cut(CABINET[0][1])
    tab.cut(CABINET[1][1])
    tab.click_until(0.7, 4)
    assert tab.reached >= 0.65
    second = tab.take_out("cabinet")
    tab.look(EYES[1], np.mean(CABINET, axis=0))
    tab.box(*DOOR)
    tab.swing_open(90)
    assert (first, second) == ("refrigerator 1", "cabinet 1")
    assert tab.status(first) == tab.status(second) == "accepted"
    tab.press("Save scene")
    assert tab.clicks <= 36
    saved = wait_until(lambda: tab.scene_workspace.document.saved, "the room is saved")
    out = Path(saved.folder)

    said = {o["id"]: o for o in json.loads((out / "scene.json").read_text())["objects"]}
    states = {i: o["state"] for i, o in said.items()}
    assert states == {"room": "static", first: "accepted", second: "accepted"}
    points, whole = points_in_place(out), open_asset(room).cloud
    assert whole is not None and len(points) == len(whole)
    assert KDTree(points).query(whole.points)[0].max() < 1e-6
    stage = pytest.importorskip("pxr.Usd").Stage.Open(str(out / "scene.usda"))
    assert sum(p.GetTypeName() in MOVING for p in stage.Traverse()) == 2
    assert (out / "scene.sdf").is_file()
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    assert model.njnt == 2
    data = mujoco.MjData(model)
    for _ in range(round(1 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
