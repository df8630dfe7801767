"""Places where a robot takes hold: found from geometry, written, and read again."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from model.core.articulated_object import Affordance
from model.core.errors import GeometryError, InputFileError
from model.core.joint import motion
from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import TREE, load_object, reading_notes
from model.io.export.formats import losses_of
from model.io.export.mjcf import MjcfExporter
from model.io.export.usd import UsdExporter
from model.physics import affordances
from model.physics.affordances import DEPTH, find_affordances, opened_range, tool_pose
from model.physics.simulation_values import Physics, physics_of
from tests.builders import box
from tests.model.validation.cabinets import DOOR, DRAWER, cabinet
from tests.model.validation.handles import with_handles

GRASP = Affordance("door", "link_1", "grasp", (0.1, 0, 0), (0, -1, 0), (1, 0, 0), 0.02)


@pytest.fixture(scope="module")
def furniture():
    obj = with_handles(cabinet())
    return obj, physics_of(obj)


def best(found, joint: str) -> Affordance:
    return next(a for a in found if a.joint == joint)


def test_handles_are_found_far_from_the_hinge_and_before_the_front(furniture):
    obj, physics = furniture
    found = find_affordances(obj, physics.collision)
    for joint in (DOOR, DRAWER):
        place = best(found, joint.name)
        assert place.link == joint.child and place.kind in ("grasp", "hook")
        in_object = np.add(place.center, joint.origin)
        assert in_object[1] < -0.03  # the bar stands 4 cm before the front
        assert abs(np.dot(place.normal, place.closing)) < 1e-6
    assert best(found, "door").center[0] > 0.3  # of 0.4 m


def test_nothing_is_found_where_no_hand_fits():
    above = box([0.002, -0.022, 0.304], [0.4, 0.4, 0.6])  # leaves slits of some mm about the front
    obj = cabinet(DOOR, DRAWER, above)
    found = find_affordances(obj, physics_of(obj).collision)
    assert not [a for a in found if a.joint == "drawer"]
    assert find_affordances(obj, {}) == ()


def test_a_search_that_fails_costs_its_joint_alone(monkeypatch, tmp_path: Path):
    obj = with_handles(cabinet())
    physics = physics_of(obj)

    def failing(joint, q):
        if joint.name == DOOR.name:
            raise ValueError("a fault of ours")
        return motion(joint, q)

    monkeypatch.setattr(affordances, "motion", failing)
    remarks: list[str] = []
    found = find_affordances(obj, physics.collision, remarks=remarks)
    assert {a.joint for a in found} == {DRAWER.name}
    (remark,) = remarks
    assert remark.startswith("door: the search for affordances failed (ValueError: a fault of ours")
    assert remark in losses_of("usd", obj, physics)
    folder = saved(obj, physics, tmp_path)
    assert remark in reading_notes(folder, load_object(folder))


def test_the_tool_stands_where_the_affordance_says():
    pose = tool_pose(GRASP)
    assert np.allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3)) and np.linalg.det(pose) > 0
    assert np.allclose(pose[:3, 3], [0.1, DEPTH, 0])
    assert np.allclose(pose[:3, 2], [0, 1, 0]) and np.allclose(pose[:3, 0], [1, 0, 0])


def test_the_way_of_a_joint_leads_to_its_farther_limit():
    assert opened_range(DOOR) == DOOR.upper
    assert opened_range(replace(DOOR, lower=-2.0, upper=0.1)) == -2.0


def same(ours: tuple[Affordance, ...], theirs: tuple[Affordance, ...]) -> bool:
    def key(a: Affordance) -> tuple:
        return a.joint, a.link, a.kind

    def values(a: Affordance) -> list[float]:
        return [*a.center, *a.normal, *a.closing, a.width]

    if [key(a) for a in ours] != [key(a) for a in theirs]:
        return False
    return np.allclose([values(a) for a in ours], [values(a) for a in theirs], atol=1e-5)


@pytest.mark.parametrize("exporter", [MjcfExporter(), UsdExporter()], ids=["mjcf", "usd"])
def test_exports_say_the_same(furniture, exporter, tmp_path: Path):
    obj, physics = furniture
    ours = find_affordances(obj, physics.collision)
    path = exporter.export(obj, tmp_path, physics=physics)[0]
    theirs = load_object(path).affordances
    assert len(ours) > 1

    def order(a: Affordance) -> tuple:
        return a.joint, a.kind, np.round(a.center, 4).tolist()

    assert same(tuple(sorted(ours, key=order)), tuple(sorted(theirs, key=order)))


def test_every_extent_in_usd_is_what_its_prim_takes(furniture, tmp_path: Path):
    usd, geom = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdGeom")
    obj, physics = furniture
    path = UsdExporter().export(obj, tmp_path, physics=physics)[0]
    stage, kinds = usd.Stage.Open(str(path)), set()
    for prim in stage.Traverse():
        said = geom.Boundable(prim).GetExtentAttr()
        if said and said.HasAuthoredValue():
            kinds.add(prim.GetTypeName())
            right = geom.Boundable.ComputeExtentFromPlugins(
                geom.Boundable(prim), usd.TimeCode.Default()
            )
            np.testing.assert_allclose(np.array(said.Get()), np.array(right), atol=1e-6)
    assert {"Mesh", "BasisCurves"} <= kinds


def test_usd_holds_grasp_vectors_that_cross_the_handle(furniture, tmp_path: Path):
    usd = pytest.importorskip("pxr.Usd")
    obj, physics = furniture
    path = UsdExporter().export(obj, tmp_path, physics=physics)[0]
    stage = usd.Stage.Open(str(path))
    curves = [p for p in stage.Traverse() if p.GetTypeName() == "BasisCurves"]
    lines = [p for p in curves if p.GetName().startswith("grasp_identifier")]
    assert lines
    for line in lines:
        start, end = np.asarray(line.GetAttribute("points").Get())
        width = line.GetAttribute("artiworld:affordance:width").Get()
        assert np.linalg.norm(end - start) > width > 0


def saved(obj, physics: Physics, folder: Path) -> Path:
    write_asset(obj, folder, provenance={}, physics=physics)
    return folder


def test_a_saved_asset_keeps_them_beside_its_joints(furniture, tmp_path: Path):
    obj, physics = furniture
    again = load_object(saved(obj, physics, tmp_path / "cabinet"))
    kept = find_affordances(again, {})
    assert kept == again.affordances and {a.joint for a in kept} >= {"door", "drawer"}
    # What is said is not looked for anew.
    moved = replace(again, affordances=(replace(best(kept, "door"), width=0.05),))
    assert best(find_affordances(moved, physics.collision), "door").width == 0.05


def test_an_asset_of_an_earlier_version_opens(furniture, tmp_path: Path):
    folder = saved(*furniture, tmp_path / "cabinet")
    tree = json.loads((folder / TREE).read_text())
    for node in tree["children"]:
        del node["affordances"]
    (folder / TREE).write_text(json.dumps(tree))
    assert load_object(folder).affordances == ()
    (folder / TREE).unlink()
    assert load_object(folder).affordances == ()


def test_a_wrong_entry_names_the_file(furniture, tmp_path: Path):
    folder = saved(*furniture, tmp_path / "cabinet")
    tree = json.loads((folder / TREE).read_text())
    tree["children"][0]["affordances"][0]["normal"] = [0, 0, 3]
    (folder / TREE).write_text(json.dumps(tree))
    with pytest.raises(InputFileError, match=r"tree\.json.*normal must have length 1"):
        load_object(folder)


@pytest.mark.parametrize(
    "wrong",
    [{"kind": "pull"}, {"normal": (0, 0, 2)}, {"center": (0, 0, float("nan"))}, {"width": -0.1}],
)
def test_values_that_are_none_are_refused(wrong):
    with pytest.raises(GeometryError, match="'door'"):
        replace(GRASP, **wrong)


def test_affordances_of_other_joints_are_left_out(furniture):
    obj, _ = furniture
    odd = replace(obj, affordances=(replace(GRASP, joint="gone"), GRASP))
    assert find_affordances(odd, {}) == (GRASP,)
