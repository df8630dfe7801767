"""Time a person who takes a queue of mixed objects to accepted assets, one after the other.

``python -m tests.browser.time_queue PARTNET_MOBILITY`` opens the eight bundled examples, eight
meshes and two simulated camera scans of PartNet-Mobility, and two reconstructed scans of it at any
rotation and scale on a table, all in one queue. Of each object a script in Chromium does what a
person does who knows the answer: turns the view to the moving parts, clicks each visible one in its
middle and up to twice more on the largest visible error, names it by its key, takes the category,
predicts, checks, and accepts. Joints that come out wrong are counted, and corrected where another
of the offered motions is right. Person's time is that of :mod:`tests.browser.time_annotator`.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from app.viewer.panels.part_list import names_for
from app.viewer.picture.palette import PART_NAMES
from app.viewer.words.annotate import PART_NAME
from app.viewer.words.common import OTHER
from model.core.articulated_object import ArticulatedObject
from model.core.asset import Asset
from model.core.files import static_assets
from model.core.geometry import Material, Mesh, PointCloud
from model.data.folders import Bundled, PartNetMobility
from model.data.registry import Dataset
from model.data.simulated.depth_camera import ReconstructionSettings, reconstruct_scan
from model.evaluation.scans import joints_right, part_numbers
from model.evaluation.segmentation_clicks import (
    LEAST_PIXELS,
    Picture,
    dataset_objects,
    largest_component,
    middle_of,
    picture_from,
)
from model.geometry.sampling import sample_surface
from model.io.write import write_cloud, write_mesh
from tests.browser.browsing import (
    CHROMIUM_FLAGS,
    COARSE,
    FEWER_FRAMES,
    PAGE_TIMEOUT,
    Tab,
    find_chromium,
    wait_until,
)
from tests.browser.time_annotator import Annotator, Times

GOOD, MORE = 0.9, 2
"""Visible IoU at which a person is content, and further clicks that a part gets at most."""
TURNS = 8
"""Directions from which a person may look."""
Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Task:
    """An object of the queue with its truth.

    Attributes:
        kind: bundled, mesh, scan or raw scan.
        source_from_object: (4, 4) the file's frame from the truth's.
    """

    kind: str
    truth: ArticulatedObject
    source_from_object: Array = field(default_factory=lambda: np.eye(4))

    @property
    def numbers(self) -> Array:
        """(P,) the part number of each of the truth's parts."""
        return part_numbers(self.truth)

    def labels_at(self, places: Array, asset_from_source: Array) -> Array:
        """(N,) the true part at places of the asset."""
        rng = np.random.default_rng(0)
        points, labels = [], []
        for number, part in zip(self.numbers, self.truth.parts, strict=True):
            if part.mesh is not None:
                area = float(part.mesh.face_areas.sum())
                count = int(np.clip(4e4 * area, 1000, 20_000)) if area else 0
                found = (
                    sample_surface(part.mesh, count, rng)[0].points if count else np.empty((0, 3))
                )
            else:
                assert part.cloud is not None
                found = part.cloud.points
            points.append(found)
            labels.append(np.full(len(found), number))
        frame = asset_from_source @ self.source_from_object
        there = np.concatenate(points) @ frame[:3, :3].T + frame[:3, 3]
        return np.concatenate(labels)[KDTree(there).query(places)[1]].astype(np.int16)


def write_tasks(root: Path, out: Path) -> dict[str, Task]:
    """Write the files of the queue; name of the object → task."""
    tasks: dict[str, Task] = {}
    bundled = Bundled()
    for name in bundled.ids():
        (file,) = (
            p for p in (static_assets() / "examples").glob(f"{name}.*") if p.suffix != ".json"
        )
        (out / file.name).write_bytes(file.read_bytes())
        tasks[name] = Task("bundled", bundled.load(name).object)
    data = PartNetMobility(root)
    few = [i for i in data.ids() if 2 <= _moving(data, i) <= 3]
    np.random.default_rng(0).shuffle(few)
    for number, object_id in enumerate(few[:12]):
        truth = data.load(object_id).object
        name = f"{truth.category}_{object_id}"
        if number < 10:
            kind = "mesh" if number < 8 else "scan"
            one = _Single(data, object_id)
            (item,) = dataset_objects(one, kind, 60_000, 1, 0, 99)  # type: ignore[arg-type]
            if item.asset.mesh is not None:
                write_mesh(item.asset.mesh, out / f"{name}.glb")
            else:
                assert item.asset.cloud is not None
                write_cloud(item.asset.cloud, out / f"{name}.ply")
            tasks[name] = Task(kind, truth)
        else:
            scan = reconstruct_scan(
                truth, ReconstructionSettings(ahead=-np.pi / 2), np.random.default_rng(number)
            )
            write_cloud(scan.cloud, out / f"{name}.ply")
            tasks[name] = Task("raw scan", truth, scan.source_from_object.astype(np.float64))
    return tasks


def _moving(data: Dataset, object_id: str) -> int:
    return sum(j.type != "fixed" for j in data.load(object_id).object.tree.joints)


@dataclass(frozen=True)
class _Single:
    """One object of a data set."""

    data: Any
    only: str
    name: str = "one"

    def ids(self) -> tuple[str, ...]:
        return (self.only,)

    def category(self, object_id: str) -> str | None:
        return self.data.category(object_id)

    def load(self, object_id: str) -> Any:
        return self.data.load(object_id)


class QueueAnnotator(Annotator):
    """Annotates one object with its truth."""

    task: Task
    asset: Asset
    true: Array

    def begin(self, task: Task) -> None:
        """Take the present object, levelled where that is asked for."""
        tab, self.task = self.tab, task
        wait_until(lambda: tab.object.asset is not None, "it is read")
        if task.kind == "raw scan":
            wait_until(lambda: tab.object.preparing.current, "a proposal")
            tab.drawn()
            if tab.selection.step != "Prepare":
                self.times.act(points=1, thoughts=1)
                tab.step("Prepare")
            self.key("Enter")
            wait_until(lambda: tab.selection.step == "Annotate", "annotating")
            wait_until(lambda: tab.object.asset is not None and not tab.object.busy, "it is read")
        shown = tab.object.asset
        if shown.display_points is None:
            faces = shown.display_faces
            material = np.zeros(len(faces), np.int32)
            mesh = Mesh(shown.display_vertices, faces, material, (Material(),))
            self.asset = Asset("shown", mesh=mesh)
        else:
            self.asset = Asset("shown", cloud=PointCloud(shown.display_points))
        frame = tab.document.frame.object_from_read if task.kind == "raw scan" else np.eye(4)
        self.true = task.labels_at(shown.display_centers, np.asarray(frame, np.float64))

    def look(self) -> Picture:
        """The picture from where the camera is."""
        self.tab.camera_at_rest()
        camera = self.tab.app.tab.client.camera
        return picture_from(
            self.asset, np.asarray(camera.position), np.asarray(camera.look_at), float(camera.fov)
        )

    def seen(self, picture: Picture) -> dict[int, int]:
        """Moving part → pixels."""
        numbers, counts = np.unique(picture.of(self.true), return_counts=True)
        return {
            int(n): int(c)
            for n, c in zip(numbers, counts, strict=True)
            if n > 0 and c >= LEAST_PIXELS
        }

    def turn(self) -> Picture:
        """Drag the view to where most moving parts are seen, if another view shows more."""
        best, tab = self.look(), self.tab
        camera = tab.app.tab.client.camera
        target = np.asarray(camera.look_at)
        away = np.asarray(camera.position) - target
        radius = float(np.linalg.norm(away))
        start, most, eye = np.arctan2(away[1], away[0]), len(self.seen(best)), None
        for k in range(TURNS):
            angle = start + 2 * np.pi * k / TURNS
            there = target + radius * np.array([0.87 * np.cos(angle), 0.87 * np.sin(angle), 0.5])
            picture = picture_from(self.asset, there, target, float(camera.fov))
            if len(self.seen(picture)) > most:
                most, eye = len(self.seen(picture)), there
        if eye is None:
            return best
        self.times.act(points=1, thoughts=1)
        camera.position = eye  # which carries the target along
        camera.look_at = target
        return self.look()

    def annotate(self) -> tuple[list[int], float]:
        """Click and name all visible moving parts; these and their mean visible IoU."""
        tab = self.tab
        picture = self.turn()
        true = picture.of(self.true)
        parts = sorted(self.seen(picture), key=lambda p: -self.seen(picture)[p])
        names = dict(zip(self.task.numbers, (p.name for p in self.task.truth.parts), strict=True))
        for part in parts:
            self.click(
                picture.click(middle_of(largest_component(true == part)[0]), 1).position, part
            )
            for _ in range(MORE):
                error = self._error(picture, true, part)
                if error is None:
                    break
                pixel, modifiers = error
                self.times.act(points=1, keys=len(modifiers), thoughts=1)
                tab.prompt(picture.click(pixel, 1).position, modifiers)
            self._name(str(names[part] or "part").split("_")[-1].lower())
        if tab.document.category is None and tab.app.annotate.likely_category:
            self.key("Shift+Digit0")
            wait_until(lambda: tab.document.category, "the category is taken")
        shown = picture.of(tab.object.labels)
        return parts, float(np.mean([_iou(shown == p, true == p) for p in parts]))

    def _error(self, picture: Picture, true: Array, part: int) -> Any:
        """Pixel and modifier keys of the next click; None where the part is good enough."""
        shown = picture.of(self.tab.object.labels)
        if _iou(shown == part, true == part) >= GOOD:
            return None
        missing = largest_component((true == part) & (shown != part))
        surplus = largest_component((shown == part) & (true != part) & (true >= 0))
        region, size = max((missing, surplus), key=lambda found: found[1])
        if size < LEAST_PIXELS:
            return None
        return middle_of(region), ("Shift",) if region is surplus[0] else ()

    def _name(self, name: str) -> None:
        tab = self.tab
        buttons = names_for(tab.app.annotate.likely_category)
        if name in buttons:
            self.name(name)
        else:
            listed = name in PART_NAMES
            self.times.act(points=2, keys=0 if listed else len(name) + 1, thoughts=1)
            tab.choose(PART_NAME[0], name if listed else OTHER)
            if not listed:
                tab.drawn()
                tab.field(PART_NAME[1]).fill(name)
                tab.field(PART_NAME[1]).press("Enter")
                tab.wait_for_keyboard()
        part = tab.selection.part
        wait_until(lambda: tab.document.part_names.get(part) == name, "it has its name")

    def correct(self, parts: list[int]) -> None:
        """Take another likely motion of a wrong joint, where that is right."""
        tab = self.tab
        for part in parts:
            right, total = self.joints([part])
            link = f"link_{part}"
            joint = tab.document.tree.joint_of.get(link)
            likely = () if joint is None else tab.document.likely_joints(joint)
            if right == total or len(likely) < 2:
                continue
            self.times.act(points=1, thoughts=1)
            tab.page.locator(f'[data-press="joint"][value="{link}"]').click()
            wait_until(lambda link=link: tab.selection.child == link, "its joint is selected")
            for _ in likely:
                before = tab.document
                self.key("m")
                wait_until(lambda before=before: tab.document != before, "another motion")
                if self.joints([part])[0] > right:
                    break

    def joints(self, parts: list[int]) -> tuple[int, int]:
        """Right and true joints of the parts that were seen."""
        document = self.tab.document
        frame = document.frame.object_from_read if self.task.kind == "raw scan" else np.eye(4)
        asset_from_truth = np.asarray(frame, np.float64) @ self.task.source_from_object
        right, total, _ = joints_right(
            self.task.truth, self.task.numbers, parts, document.tree, asset_from_truth
        )
        return right, total


def _iou(shown: Array, true: Array) -> float:
    return float((shown & true).sum() / max((shown | true).sum(), 1))


def rows(browser: Any, folder: Path, tasks: dict[str, Task]) -> Iterator[dict[str, Any]]:
    """One row an object, in the queue's order."""
    from app.cli.serve import start_server
    from app.server.config import ServeConfig

    server = start_server(
        ServeConfig(paths=(folder,), workspace=folder / "ws", port=0, user="timed")
    )
    context = browser.new_context(viewport={"width": 1440, "height": 900})
    try:
        context.add_init_script(FEWER_FRAMES)
        page = context.new_page()
        page.set_default_timeout(PAGE_TIMEOUT)
        page.goto(server.url + COARSE)
        tab = Tab(page, server).ready()
        done: set[str] = set()
        while len(done) < len(tasks):
            times = Times()
            person = QueueAnnotator(tab, times)
            name = tab.object.record.name
            task = tasks[name]
            person.begin(task)
            tab.drawn()
            times.phase("open")
            parts, iou = person.annotate()
            times.phase("clicks and names")
            person.key("p")
            wait_until(lambda: tab.document.tree, "a kinematic tree")
            times.phase("joints")
            first, total = person.joints(parts)
            person.correct(parts)
            right, _ = person.joints(parts)
            times.phase("corrections")
            here = tab.object.record.id
            person.accept(saved=False)  # it is written while the next one is annotated
            done.add(name)
            if len(done) < len(tasks):
                wait_until(lambda here=here: tab.object.record.id != here, "the next object")
            times.phase("accept")
            yield {
                "name": name, "kind": task.kind, "parts": len(parts), "IoU": iou, "first": first,
                "right": right, "joints": total, "times": times,
            }  # fmt: skip
    finally:
        context.close()
        server.close()


def main() -> None:
    """Print a table."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as temporary, sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=find_chromium(), args=list(CHROMIUM_FLAGS)
        )
        folder = Path(temporary)
        tasks = write_tasks(Path(sys.argv[1]), folder)
        print(
            "| object | parts | IoU | joints right, corrected | keys | clicks | person | waiting "
            "| sum |"
        )
        sums, waits = [], []
        for row in rows(chromium, folder, tasks):
            t = row["times"]
            waiting = sum(t.waited.values())
            if row["parts"] in (2, 3):
                sums.append(t.person + waiting)
                waits.append(waiting)
            print("  " + ", ".join(f"{k} {v:.1f} s" for k, v in t.waited.items()))
            print(
                f"| {row['name']}, {row['kind']} | {row['parts']} | {row['IoU']:.2f} "
                f"| {row['first']}, {row['right']} of {row['joints']} | {t.keys} | {t.points} "
                f"| {t.person:.1f} s | {waiting:.1f} s | {t.person + waiting:.1f} s |",
                flush=True,
            )
        print(
            f"objects of 2 or 3 parts: {len(sums)}, median {median(sums):.1f} s, "
            f"of which waiting {median(waits):.1f} s"
        )
        chromium.close()


if __name__ == "__main__":
    main()
