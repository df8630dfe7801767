"""A scene on a real workbench with its worker processes: what becomes of its objects."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.config import ServeConfig
from app.scene_desk import SceneDesk
from app.workbench import Workbench
from model.errors import CommandError
from sessions import commands as cmd
from sessions.scene_commands import DecideObjects, SetArticulable
from sessions.store import Store
from tests.model.scenes.scenes_made import make_assets, own, write_scene

EVIL = "rock <script>alert(1)</script>"


def wait(condition: Callable[[], Any], what: str, seconds: float = 240.0) -> Any:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := condition():
            return value
        time.sleep(0.05)
    raise AssertionError(f"waited in vain for: {what}")


def entry(id: str, asset: str | None, x: float, description: str, **more: Any) -> dict[str, Any]:
    return {
        "id": id, "description": description, "asset": asset, "position": [x, 0.5, 0.4],
        "quaternion_wxyz": [0.8, 0.0, 0.0, 0.6], "scale": [1, 1, 1], "anchor": "center", **more,
    }  # fmt: skip


OBJECTS = [
    entry("first", "cab", 0.0, "cabinet"),
    entry("twin", "cab", 1.5, "cabinet"),
    entry("small", "cab", 3.0, "cabinet", scale=[0.5, 0.6, 0.7]),
    entry(EVIL, "rock", 4.5, "rock"),
    entry("lost", "nowhere", 6.0, "cabinet"),
    entry("slab", None, 1.0, "floor", box=[8.0, 3.0, 0.1]),
]


class World:
    """A folder with a scene, and the desks that are opened on it one after the other."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.assets = make_assets(folder / "assets")
        self.scene = write_scene(folder / "home.json", own(OBJECTS))
        self.bench: Workbench | None = None
        self.open()

    def open(self) -> SceneDesk:
        workspace = self.folder / "workspace"
        config = ServeConfig(workspace=workspace, predictor="geometric", scene=self.scene)
        self.bench = Workbench(config, Store(workspace), [])
        self.desk = self.bench.desk = SceneDesk(self.bench, self.scene, (self.assets,))
        wait(lambda: self.desk.scene is not None or self.desk.problem, "the scene is read")
        assert self.desk.problem is None
        self.settle()
        return self.desk

    def settle(self) -> None:
        desk = self.desk
        wait(
            lambda: not desk.busy and all(w.drawn for w in desk.wanted() if w.document.tree)
            and all(w.prepared or w.document.tree for w in desk.wanted()),
            "nothing is left to do",
        )  # fmt: skip

    def close(self) -> None:
        assert self.bench is not None
        self.bench.close()
        self.bench.store.close()


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    world = World(tmp_path_factory.mktemp("scene"))
    yield world
    world.close()


@pytest.fixture(scope="module")
def accepted(world: World) -> World:
    """The decision is on disk, the server dies at once: the next one carries it out."""
    desk = world.desk
    wait(lambda: desk.work("first") is not None, "the first is predicted")
    first = desk.work("first")
    assert first is not None
    world.close()
    store = Store(world.folder / "workspace")
    record = store.open_object(world.scene, None, "home")
    store.append(record.id, DecideObjects("accept", (first.id,), above=0.1), "ann", record.seq)
    store.close()
    desk = world.open()
    wait(lambda: not desk.accepting.waiting, "it is carried out")
    return world


def statuses(desk: SceneDesk) -> dict[str, str]:
    return {r.id: r.status for r in desk.rows()}


def test_objects_are_predicted_once_for_all_their_twins(world: World) -> None:
    desk = world.desk
    assert statuses(desk) == {
        "first": "predicted", "twin": "predicted", "small": "predicted", EVIL: "static",
        "lost": "missing", "slab": "static",
    }  # fmt: skip
    assert desk.twins("first") == ["first", "twin"] and desk.twins("small") == ["small"]
    assert desk.work("first") is desk.work("twin") is not desk.work("small")
    assert "nowhere" in desk.missing_reason(desk.items["lost"])
    work = desk.work("small")
    assert work is not None and work.document.tree is not None
    kinds = {j.type for j in work.document.tree.joints}
    assert kinds == {"revolute", "prismatic"}
    assert work.document.part_names[1] == "door" and work.document.category == "cabinet"


def test_drawn_parts_stand_where_the_object_stands(world: World) -> None:
    desk = world.desk
    work, item = desk.work("small"), desk.items["small"]
    assert work is not None and work.drawn is not None
    pose = desk.world_from_copy(item)
    assert pose is not None
    boxes = np.array([s.bounds for s in work.drawn.shapes.values()])
    middle = (boxes[:, 0].min(0) + boxes[:, 1].max(0)) / 2
    np.testing.assert_allclose(pose[:3, :3] @ middle + pose[:3, 3], [3.0, 0.5, 0.4], atol=1e-6)
    size = boxes[:, 1].max(0) - boxes[:, 0].min(0)
    np.testing.assert_allclose(size, [0.62 * 0.5, 0.5 * 0.6, 0.8 * 0.7], atol=1e-6)


def test_a_person_decides_what_is_articulable(world: World) -> None:
    desk = world.desk
    desk.set_articulable(EVIL, True, "ann")
    wait(lambda: statuses(desk)[EVIL] == "todo", "the rock is to do")
    work = wait(lambda: desk.work(EVIL), "its working copy")
    wait(lambda: work.prepared, "it was looked at")
    assert "cut it by clicks" in work.reason
    desk.do(cmd.Undo(), "ann")
    assert statuses(desk)[EVIL] == "static"
    with pytest.raises(CommandError, match="nowhere"):
        desk.set_articulable("lost", True, "ann")


def test_rejecting_and_taking_it_back(world: World) -> None:
    desk, small = world.desk, world.desk.work("small")
    assert small is not None
    desk.do(DecideObjects("reject", (small.id,), reason="axis"), "ann")
    assert statuses(desk)["small"] == "rejected"
    assert small.document.review.reason == "axis" and small.document.review.by == "ann"
    desk.do(cmd.Undo(), "ann")
    assert statuses(desk)["small"] == "predicted"
    assert desk.document.decided == ()


def test_what_was_decided_survives_the_end_of_the_server(accepted: World) -> None:
    desk = accepted.desk
    work = desk.work("first")
    assert work is not None
    assert not desk.accepting.why_refused(work), desk.accepting.why_refused(work)
    assert statuses(desk)["first"] == statuses(desk)["twin"] == "accepted"
    assert work.document.review.by == "ann" and work.document.saved is not None
    told = json.loads((Path(work.document.saved.folder) / "provenance.json").read_text())
    assert told["gate"] and told["review"]["by"] == "ann"


def test_the_saved_scene_loads_and_holds_what_was_accepted(accepted: World) -> None:
    mujoco = pytest.importorskip("mujoco")
    world, desk = accepted, accepted.desk
    desk.do(SetArticulable("small", False), "ann")
    desk.saving.save(False, "ann")
    wait(lambda: desk.document.saved, "the scene is saved")
    world.settle()
    assert desk.document.saved is not None
    out = Path(desk.document.saved.folder)
    said = {o["id"]: o for o in json.loads((out / "scene.json").read_text())["objects"]}
    assert {i: o["state"] for i, o in said.items()} == {
        "first": "accepted", "twin": "accepted", "small": "static", EVIL: "static",
        "lost": "missing", "slab": "plain",
    }  # fmt: skip
    assert said["first"]["urdf"] and not said["small"]["urdf"]
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    moving = [model.joint(i).name for i in range(model.njnt)]
    assert len(moving) == 4 and sum(n.startswith("first/") for n in moving) == 2
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    base = data.body("twin/link_0").xpos
    np.testing.assert_allclose(base, [1.5, 0.5, 0.4], atol=0.02)  # its box has a handle in front


def test_the_report_holds_everything_and_runs_nothing(accepted: World) -> None:
    done: list[Path] = []
    world = accepted
    world.desk.saving.report(done.append)
    wait(lambda: done, "the report")
    page = done[0].read_text(encoding="utf-8")
    assert "<script" not in page and "&lt;script&gt;" in page
    assert "src='http" not in page and page.count("data:image/png;base64") >= 3
    assert "accepted" in page and "ann" in page and "drawer" in page and "nowhere" in page
