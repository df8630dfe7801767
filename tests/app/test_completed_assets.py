"""A scan's asset is completed where that is asked for, and can be had again without it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.server import part_tasks, tasks
from app.server.display_tasks import open_asset
from app.server.export_tasks import ExportTask, export_one
from app.server.part_tasks import PartSource, articulated_object, prepare_asset
from app.server.tasks import ReadOptions
from model.core.geometry import merged_clouds
from model.core.memory import LruCache
from model.geometry.completion import OPENING, SURFACE, THICKNESS, TRAY
from model.io.assets.asset_folder import publish, write_draft
from model.io.assets.reader import load_object, read_provenance, reload_check
from model.io.write import write_cloud
from model.physics.simulation_values import PhysicsSettings, physics_of
from tests.scanned_cabinet import cabinet

SCAN = cabinet(600)
TREE = SCAN.tree


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> PartSource:
    folder = tmp_path_factory.mktemp("cabinet")
    clouds = [p.cloud for p in SCAN.parts if p.cloud is not None]
    write_cloud(merged_clouds(clouds), folder / "cabinet.ply")
    workspace = folder / "workspace"
    opened = open_asset(folder / "cabinet.ply", workspace, ReadOptions())
    labels = np.repeat(np.arange(3, dtype=np.int16), [len(c) for c in clouds])
    reference = tasks.arrays_of(workspace).put(labels)
    names = {1: "drawer", 2: "door"}
    return PartSource(opened.folder, workspace, reference, names, SCAN.category, "cabinet", True)


@pytest.fixture(scope="module")
def asset(source: PartSource) -> Path:
    return publish(prepare_asset(source, TREE), source.workspace / "assets" / "a", {}).folder


def test_an_accepted_scan_is_completed_and_marked(source, asset):
    kept = read_provenance(asset)["asset"]
    assert kept["completed"] == {
        "base": [SURFACE, OPENING],
        "drawer_1": [THICKNESS, TRAY],
        "door_2": [THICKNESS],
    }
    assert reload_check(asset) == []
    for part, before in zip(load_object(asset).parts, SCAN.parts, strict=True):
        assert part.cloud is not None and before.cloud is not None
        np.testing.assert_allclose(part.cloud.points, before.cloud.points, atol=1e-6)
        assert list(part.completed) == kept["completed"][part.link]


def test_its_drawer_and_its_door_open_in_mujoco_without_contact(asset):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(asset / "object.urdf"))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    data = mujoco.MjData(model)
    for joint in TREE.joints:
        for share in (0.0, 0.1, 0.5, 1.0):
            mujoco.mj_resetData(model, data)
            data.qpos[model.joint(joint.name).qposadr[0]] = share * joint.motion_range[1]
            mujoco.mj_forward(model, data)
            deep = [c.dist for c in data.contact[: data.ncon] if c.dist < -1e-3]
            assert not deep, (joint.name, share)
    data.qpos[model.joint("pull").qposadr[0]] = -0.3  # through the back
    mujoco.mj_forward(model, data)
    assert any(c.dist < -1e-3 for c in data.contact[: data.ncon])


def test_other_workers_have_it_from_the_cache(source, asset, monkeypatch):
    here = {p.link: p for p in articulated_object(source, TREE).parts}
    with monkeypatch.context() as patch:
        patch.setattr(part_tasks, "completed_objects", LruCache(1))
        patch.setattr(part_tasks, "complete", None)
        for part in articulated_object(source, TREE).parts:
            mesh, wanted = part.mesh, here[part.link].mesh
            assert mesh is not None and wanted is not None
            np.testing.assert_array_equal(mesh.vertices, wanted.vertices)
            assert part.completed == here[part.link].completed


def test_without_it_the_files_are_those_of_the_points_alone(source, asset, tmp_path):
    plain = replace(source, complete=False)
    folder = tmp_path / "plain"
    obj = articulated_object(plain, TREE)
    assert all(p.mesh is None for p in obj.parts)
    physics = physics_of(obj, store=source.workspace / "collision")
    write_draft(obj, folder, original=tasks.asset_of(source.folder), physics=physics)
    wanted = read_provenance(folder)["asset"]
    # Accepted again over the completed one, which is gone.
    again = publish(prepare_asset(plain, TREE), asset.with_name("b"), {}).folder
    kept = read_provenance(again)["asset"]
    assert "completed" not in kept and kept["parts"] == wanted["parts"]
    # Shapes of the cache are rounded, and so are the affordances in the tree, found on them.
    files, before = (
        {k: v for k, v in e["files"].items() if "collision/" not in k and k != "tree.json"}
        for e in (kept, wanted)
    )
    assert files == before and kept["files"].keys() == wanted["files"].keys()


def test_an_export_takes_it_away_or_adds_it(source, asset, tmp_path):
    def exported(complete: bool | None, of: Path) -> dict:
        folder = tmp_path / f"{of.name}-{complete}"
        settings = PhysicsSettings(collision=None)
        task = ExportTask(of, (("urdf", folder),), settings, None, False, complete)
        export_one(task)
        parts = {p.link: p.mesh for p in load_object(folder / "object.urdf").parts}
        return {link: len(m.faces) for link, m in parts.items() if m is not None}

    as_saved, bare = exported(None, asset), exported(False, asset)
    assert as_saved["drawer_1"] != bare["drawer_1"]
    plain = publish(
        prepare_asset(replace(source, complete=False), TREE), tmp_path / "plain", {}
    ).folder
    assert exported(None, plain) == bare
    assert exported(True, plain).keys() == as_saved.keys()
    assert exported(True, plain)["drawer_1"] == pytest.approx(as_saved["drawer_1"], rel=0.1)
