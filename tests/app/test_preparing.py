"""Preparing a scan: proposals, commands, undo, replay, and the way back to the source."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.open_object import OpenObject
from app.server.prepare_tasks import Marks
from model.core.files import static_assets
from model.geometry.cleaning import CLUTTER, OUTLIER, SUPPORT
from model.geometry.units import unusual_height
from model.io.open_asset import open_asset
from model.segmentation.prompts import Click
from sessions.commands import AddClick, LeaveOut, Prepare, Redo, Undo
from sessions.document import SOURCE_FRAME, Document, ObjectFrame
from sessions.provenance import provenance
from sessions.state import Context, SessionState, replay
from sessions.store import Store
from sessions.tool_commands import Placed
from tests.builders import wait_until
from tests.raw_scans import raw_scan, saved_along_another_axis

ALL = Marks((SUPPORT, CLUTTER, OUTLIER))


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[[Path], OpenObject]]:
    made: list[AppState] = []

    def begin(path: Path) -> OpenObject:
        workspace = tmp_path / "workspace"
        made.append(AppState(ServeConfig(workspace=workspace), Store(workspace), [path]))
        obj = made[-1].object(made[-1].queue.records()[0].id)
        proposed(obj)
        return obj

    yield begin
    for app_state in made:
        app_state.close()


def proposed(obj: OpenObject) -> Any:
    wait_until(lambda: obj.asset and "open" not in obj.jobs, "it is read")
    obj.preparing.propose_for_step()
    return wait_until(lambda: obj.preparing.current, "a proposal")


def prepared(obj: OpenObject, marks: Marks = ALL, metres: float | None = None) -> None:
    done: list[bool] = []
    frame = obj.preparing.current.object_from_asset  # type: ignore[union-attr]
    obj.preparing.apply(frame, marks, "level", "ann", lambda: done.append(True), metres=metres)
    wait_until(lambda: done, "it is prepared")
    wait_until(lambda: obj.asset and "open" not in obj.jobs, "it is read again")


def test_a_raw_scan_is_noticed_levelled_and_cleaned(opened, tmp_path: Path) -> None:
    frame = raw_scan(tmp_path / "oven.ply", seed=3, every=5)
    obj = opened(tmp_path / "oven.ply")
    up = frame[:3, 2] / np.linalg.norm(frame[:3, 2])
    assert obj.preparing.tilt == pytest.approx(np.arccos(up[2]), abs=np.radians(1))
    assert set(obj.preparing.noticed()) == {SUPPORT}
    prepared(obj)
    assert obj.asset.element_count == pytest.approx(44_088, rel=0.02)
    assert 0 <= obj.asset.bounds[0, 2] < 0.1 * obj.asset.diagonal
    # A prepared scan isn't asked about again, and stays as a person levelled it.
    assert proposed(obj).up == (0.0, 0.0, 1.0)
    assert not obj.preparing.tilt


def test_apply_finds_its_copy_read_and_encoded(opened, tmp_path: Path) -> None:
    raw_scan(tmp_path / "oven.ply", seed=3, every=5)
    obj = opened(tmp_path / "oven.ply")

    def copies() -> set[Path]:
        return set((obj.services.workspace / "cache").glob("[!.]*/"))

    wait_until(lambda: len(copies()) == 2, "the copy that Apply makes")
    before = copies()
    prepared(obj)
    assert copies() == before
    assert obj.asset.folder in before and obj.document.left_out.count


def test_what_apply_makes_light_is_encoded_where_its_clicks_are_answered(
    opened, tmp_path: Path
) -> None:
    path = tmp_path / "oven.ply"
    raw_scan(path, seed=3, every=2)
    cloud = trimesh.load(path)
    away = np.random.default_rng(0).uniform(*cloud.bounds, (6_000, 3)) * 1.2
    trimesh.PointCloud(np.vstack([cloud.vertices, away])).export(path)
    obj = opened(path)
    assert obj.asset.heavy and obj.preparing.tilt
    lane = obj.services.workers.lanes.reserve(obj, heavy=False)
    wait_until(lambda: lane.segmentation.busy, "its cleaned copy is encoded there")
    assert lane is not obj.lane
    prepared(obj)
    assert obj.lane is lane and not obj.asset.heavy


def test_provenance_leads_from_the_file_to_the_asset_and_back(opened, tmp_path: Path) -> None:
    raw_scan(tmp_path / "oven.ply", seed=4, every=5)
    obj = opened(tmp_path / "oven.ply")
    prepared(obj, metres=0.01)
    obj.preparing.turn(np.diag([2.0, 2.0, 2.0, 1.0]), "twice as large", "ann")
    wait_until(lambda: obj.asset and "open" not in obj.jobs, "it is read again")
    asset = obj.need_asset()
    source = asset.source
    record = provenance(obj.state, obj.services.store.history(obj.record.id), source)
    object_from_source = np.array(record["object_from_source"])
    numbers = open_asset(tmp_path / "oven.ply", up_axis="z").element_centers
    kept = np.ones(len(numbers), bool)
    kept[obj.services.store.get_array(obj.document.left_out.elements)] = False
    there = numbers[kept] @ object_from_source[:3, :3].T + object_from_source[:3, 3]
    shown = there[asset.element]
    size = np.ptp(shown, axis=0).max()
    np.testing.assert_allclose(shown, asset.display_points, atol=1e-5 * size)


def test_an_extracted_object_leads_back_to_its_scan() -> None:
    who = Context("ann", "now")
    doc = Placed("room.ply", "e" * 64, "a" * 64, (1.0, 2.0, 0.5)).edit(Document(), who)
    turned = SOURCE_FRAME.then(
        ObjectFrame((0.1, 0.0, 0.3), (0.6, 0.0, 0.8, 0.0), 2.0).object_from_read
    )
    doc = Prepare(1.0, turned, LeaveOut(None), "level").edit(doc, who)
    record = provenance(SessionState(doc), [], None)
    out = np.array(record["scan_from_object"]) @ np.array(record["object_from_source"])
    expected = np.eye(4)
    expected[:3, 3] = (1.0, 2.0, 0.5)
    np.testing.assert_allclose(out, expected, atol=1e-12)


def test_undo_redo_and_replay_give_the_same_state(opened, tmp_path: Path) -> None:
    raw_scan(tmp_path / "oven.ply", seed=5, every=5)
    obj = opened(tmp_path / "oven.ply")
    prepared(obj)
    first = obj.document
    obj.do(AddClick(Click((0.0, 0.0, 0.0), 1)), "ann")
    obj.preparing.turn(np.diag([1.0, -1.0, -1.0, 1.0]), "flip upside down", "ann")
    assert not obj.document.prompts  # elements lie elsewhere now
    obj.do(Undo(), "ann")
    assert len(obj.document.prompts) == 1
    obj.do(Undo(), "ann")
    obj.do(Undo(), "ann")
    assert obj.document.frame == SOURCE_FRAME and obj.document.left_out is None
    obj.do(Redo(), "ann")
    assert obj.document.frame == first.frame
    entries = list(obj.services.store.history(obj.record.id))
    again = replay((e.seq, e.command, Context(e.who, e.at)) for e in entries)
    assert again.present == obj.document


@pytest.mark.parametrize("name", ["oven_scan.ply", "cabinet.glb", "laptop.glb"])
def test_upright_clean_objects_are_not_called_tilted(opened, name: str) -> None:
    obj = opened(static_assets() / "examples" / name)
    assert not obj.preparing.tilt and not obj.preparing.doubtful
    assert not obj.preparing.noticed()


@pytest.mark.parametrize(
    ("name", "suffix"),
    [("kettle", ".ply"), ("kettle", ".obj"), ("kettle", ".glb"), ("refrigerator_scan", ".ply")],
)
def test_a_file_of_another_up_axis_is_told(opened, tmp_path: Path, name: str, suffix: str) -> None:
    """PLY is read z-up and saved y-up here, OBJ and GLB the other way round."""
    found = next((static_assets() / "examples").glob(f"{name}.*"))
    path = saved_along_another_axis(open_asset(found), tmp_path / f"{name}{suffix}")
    obj = opened(path)
    assert obj.preparing.doubtful or obj.preparing.tilt
    prepared(obj, Marks())
    top = obj.asset.display_centers[:, 2]
    expected = open_asset(found).element_centers[:, 2]
    assert np.ptp(top) == pytest.approx(np.ptp(expected), rel=0.02)
    middle = (expected.mean() - expected.min()) / np.ptp(expected)
    assert (top.mean() - top.min()) / np.ptp(top) == pytest.approx(float(middle), abs=0.1)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_an_upright_mesh_is_not_asked_about_in_any_format(
    opened, tmp_path: Path, suffix: str
) -> None:
    kettle = open_asset(static_assets() / "examples" / "kettle.glb")
    obj = opened(saved_along_another_axis(kettle, tmp_path / f"kettle{suffix}", turn=np.eye(3)))
    assert not obj.preparing.tilt and not obj.preparing.doubtful


def test_heights_far_from_the_usual_ones_are_told() -> None:
    odd = unusual_height("Refrigerator", 0.4)
    assert odd is not None and (odd.low, odd.high) == (1.5, 1.9) and 1.5 < odd.proposed < 1.9
    assert unusual_height("refrigerator", 1.7) is None
    assert unusual_height("Sculpture", 40.0) is None and unusual_height(None, 1.0) is None


def test_kinds_box_and_confidence_mark_elements() -> None:
    points = np.array([[0.0, 0, 0], [2, 0, 0], [0, 0, 0], [0, 0, 0]])
    kinds = np.array([0, 0, SUPPORT, 0], np.int8)
    confidence = np.array([0.9, 0.9, 0.9, 0.1], np.float32)
    marks = Marks((SUPPORT,), ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)), 0.5)
    assert marks.of(points, kinds, confidence).tolist() == [False, True, True, True]
    assert not Marks().of(points, kinds, confidence).any()
