"""Reading a scene and its assets takes no longer than it may, and can be cancelled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from app.server import scene_tasks, scene_workspace
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.scene_tasks import Shape
from app.server.scene_workspace import SceneWorkspace
from app.server.workers import READ_CANCELLED
from sessions.store import Store
from tests.app.job_functions import reads_for_ever, shapes_without_end_of_rocks
from tests.builders import native_entry, wait_until
from tests.model.scenes.scenes_made import make_assets, own, write_scene


@pytest.fixture
def open_scene(tmp_path: Path) -> Iterator[Callable[[], SceneWorkspace]]:
    assets = make_assets(tmp_path / "assets")
    entries = [native_entry(asset, x) for x, asset in enumerate(("cab", "rock"))]
    scene = write_scene(tmp_path / "home.json", own(entries))
    made: list[AppState] = []

    def begin() -> SceneWorkspace:
        config = ServeConfig(workspace=tmp_path / "workspace", predictor="geometric", scene=scene)
        made.append(AppState(config, Store(config.workspace), []))
        return made[-1].open_scene(scene, (assets,))

    yield begin
    for app_state in made:
        app_state.close()


def test_a_scene_whose_reading_has_no_end_is_ended_with_its_name(open_scene, monkeypatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(scene_tasks, "read", reads_for_ever)
        patched.setattr(scene_workspace, "READ_SECONDS", 0.3)
        scene = open_scene()
    wait_until(lambda: scene.problem, "its time is up")
    assert (
        scene.problem.startswith("Reading home.json took more than") and ": join" in scene.problem
    )
    assert scene.can_try_again and not scene.busy


def test_a_scene_is_cancelled_and_read_again(open_scene, monkeypatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(scene_tasks, "read", reads_for_ever)
        scene = open_scene()
    wait_until(lambda: scene.busy, "it is being read")
    scene.cancel()
    wait_until(lambda: scene.problem, "it is cancelled")
    assert scene.problem == READ_CANCELLED and scene.scene is None
    scene.try_again()
    wait_until(lambda: scene.scene is not None, "it is read")
    assert scene.problem is None and not scene.can_try_again and set(scene.items) == {"cab", "rock"}


def test_an_asset_without_end_is_skipped_and_the_others_go_on(open_scene, monkeypatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(scene_tasks, "shapes", shapes_without_end_of_rocks)
        scene = open_scene()
        wait_until(lambda: "rock" in scene.busy.get("shapes", (0, ""))[1], "the rock is read")
        work = scene.work("rock")
        # A prediction reads it as well, where joints are edited: it waits.
        assert work is not None and not work.prepared
        scene.cancel()
        wait_until(lambda: len(scene.shapes) == 2 and "shapes" not in scene.busy, "both")
    assert reading_ended(scene) == READ_CANCELLED and work.prepared
    scene.try_again()
    wait_until(lambda: len(scene.shapes) == 2 and work.prepared and not scene.busy, "both again")
    assert all(isinstance(shape, Shape) for shape in scene.shapes.values())
    assert work.reason != READ_CANCELLED and not scene.can_try_again


def test_an_asset_that_takes_too_long_is_left_out_with_its_name(open_scene, monkeypatch) -> None:
    scene = open_scene()
    wait_until(lambda: len(scene.shapes) == 2 and not scene.busy, "all is read")
    monkeypatch.setattr(scene_tasks, "shapes", shapes_without_end_of_rocks)
    monkeypatch.setattr(scene_workspace, "READ_SECONDS", 10.0)
    scene.shapes = {}
    scene.go_on()
    wait_until(lambda: len(scene.shapes) == 2 and "shapes" not in scene.busy, "its time is up")
    assert reading_ended(scene).startswith("Reading rock.obj took more than")


def reading_ended(scene: SceneWorkspace) -> str:
    """Why the rock isn't there; the cabinet is."""
    shapes = {path.stem: shape for path, shape in scene.shapes.items()}
    assert isinstance(shapes["cab"], Shape) and scene.can_try_again
    assert scene.status(scene.items["rock"]) == "failed"
    assert scene.missing_reason(scene.items["rock"]) == shapes["rock"]
    return str(shapes["rock"])
