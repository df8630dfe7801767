"""Simulated scans, corruptions, folders and the demo objects."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from app.server.prompt_file import read_prompts
from model.core.errors import ConfigurationError
from model.core.files import static_assets
from model.data.folders import PartNetMobility
from model.data.procedural.corruption import MIXED, Corruption, corrupted, sometimes
from model.data.procedural.examples import EXAMPLES, write_examples
from model.data.procedural.generate import GenerateSettings, generate, make
from model.data.simulated.depth_camera import ScanSettings, View, simulate_scan
from model.io.open_asset import open_asset
from tests.model.demos import demo_truth, encoded_demo

FOLDER = static_assets() / "examples"


def test_a_scan_sees_the_near_side_only() -> None:
    obj = make("Refrigerator", 2).object
    settings = ScanSettings((View(0.0, 0.2),), 6000, outliers=0.01)
    scan = simulate_scan(obj, settings, np.random.default_rng(0))
    real = scan.part >= 0
    corners = np.concatenate([p.bounds for p in obj.parts])
    depth = np.ptp(corners[:, 1])
    assert 4000 < real.sum() <= 6000
    assert 0.005 < (~real).mean() < 0.02
    # The back wall faces away from the camera.
    behind = scan.cloud.points[real, 1] > corners[:, 1].max() - 0.1 * depth
    above = scan.cloud.points[real, 2] < corners[:, 2].max() - 0.03
    assert (behind & above).mean() < 0.05
    assert scan.cloud.colors is not None and scan.cloud.colors.std() > 5


def test_a_scan_says_which_points_hang_in_a_gap() -> None:
    obj = make("Refrigerator", 2).object
    quiet = {"depth_noise": 0.0, "outliers": 0.0, "misalignment": 0.0, "holes": 0}
    views = (View(0.4, 0.2),)
    scan = simulate_scan(obj, ScanSettings(views, 20_000, **quiet), np.random.default_rng(0))
    scene = o3d.t.geometry.RaycastingScene()
    for part in obj.parts:
        faces = part.mesh.faces.astype(np.uint32)
        scene.add_triangles(part.mesh.vertices.astype(np.float32), faces)
    off = scene.compute_distance(scan.cloud.points).numpy().copy()
    assert 0.001 < scan.smeared.mean() < 0.05
    assert off[~scan.smeared].max() < 1e-3
    assert np.median(off[scan.smeared]) > 1e-3
    clean = ScanSettings(views, 20_000, smear=0.0, **quiet)
    assert not simulate_scan(obj, clean, np.random.default_rng(0)).smeared.any()


def test_depth_noise_grows_with_distance() -> None:
    obj = make("Safe", 2).object
    body = obj.parts[0].bounds

    def spread(distance: float) -> float:
        views = (View(0.0, 0.0, distance),)
        quiet = {"outliers": 0.0, "misalignment": 0.0, "smear": 0.0, "holes": 0, "points": 4000}
        clean = simulate_scan(
            obj, ScanSettings(views, depth_noise=0.0, **quiet), np.random.default_rng(0)
        )
        noisy = simulate_scan(
            obj, ScanSettings(views, depth_noise=0.002, **quiet), np.random.default_rng(0)
        )
        low = min(len(clean.cloud), len(noisy.cloud))
        return float(noisy.cloud.points[:low, 1].std() - clean.cloud.points[:low, 1].std())

    assert np.ptp(body) > 0
    assert spread(4.0) > 2 * abs(spread(1.2)) > 0


def test_without_faults_the_truth_is_that_of_the_object() -> None:
    made = make("StorageFurniture", 4)
    truth = corrupted(made, Corruption(points=300, shuffle=False), np.random.default_rng(0))
    assert truth.object.tree == made.object.tree
    for part, original in zip(truth.object.parts, made.object.parts, strict=True):
        assert part.cloud is not None and len(part.cloud) == 300 and part.name == original.name
        assert (part.cloud.points >= original.bounds[0] - 1e-5).all()
        assert (part.cloud.points <= original.bounds[1] + 1e-5).all()


def test_shuffling_renames_links_but_keeps_the_mechanism() -> None:
    made = make("Chair", 4)
    truth = corrupted(made, Corruption(points=100, turn=True), np.random.default_rng(1)).object
    assert sorted(p.link for p in truth.parts) == sorted(p.link for p in made.object.parts)
    kinds = sorted(j.type for j in made.object.tree.joints)
    assert sorted(j.type for j in truth.tree.joints) == kinds
    assert [p.link for p in truth.parts] == [f"link_{i}" for i in range(len(truth.parts))]


def test_each_fault_does_what_it_says() -> None:
    made = make("StorageFurniture", 4)
    rng = np.random.default_rng(0)
    moving = sum(j.moves for j in made.object.tree.joints)
    split = corrupted(made, Corruption(points=300, split=1.0), rng).object
    assert any(j.type == "fixed" for j in split.tree.joints)
    assert sum(j.moves for j in split.tree.joints) == moving
    merged = corrupted(made, Corruption(points=300, merge=1.0), rng).object
    assert sum(j.moves for j in merged.tree.joints) == 1
    clean = corrupted(made, Corruption(points=300, shuffle=False), np.random.default_rng(3)).object
    noisy = corrupted(
        made, Corruption(points=300, shuffle=False, noise=0.05), np.random.default_rng(3)
    )
    diagonal = np.linalg.norm(np.ptp(np.concatenate([p.bounds for p in clean.parts]), axis=0))
    moved = noisy.object.parts[0].cloud.points - clean.parts[0].cloud.points  # type: ignore[union-attr]
    assert 0.04 < moved.std() / diagonal < 0.06
    seen = corrupted(made, Corruption(points=300, one_sided=True), rng).object
    assert seen.tree.root in {p.link for p in seen.parts}


@pytest.mark.parametrize("family", ["Bottle", "Chair", "Keyboard", "Oven", "Composite"])
def test_any_mix_of_faults_gives_parts_and_tree_that_agree(family: str) -> None:
    made = make(family, 9)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        truth = corrupted(made, sometimes(MIXED, rng) if seed else MIXED, rng)
        obj = truth.object
        assert {p.link for p in obj.parts} == {x for x in obj.tree.links if x.startswith("link_")}
        assert all(p.cloud is not None and len(p.cloud) >= 8 for p in obj.parts)
        assert any(j.moves for j in obj.tree.joints)
        assert all(p.name is None for p in truth.segmented(names=False).parts)


def test_bad_settings_are_named() -> None:
    with pytest.raises(ConfigurationError, match="outliers"):
        Corruption(outliers=2.0)
    with pytest.raises(ConfigurationError, match="view"):
        ScanSettings(())
    with pytest.raises(ConfigurationError, match=r"Teapot.*Kettle"):
        make("Teapot", 0)


def test_folders_read_back_as_they_were_made(tmp_path: Path) -> None:
    families = ("Bottle", "Oven", "Chair", "Composite")
    folders = generate(GenerateSettings(tmp_path, families, n=1, seed=3))
    data = PartNetMobility(tmp_path)
    front = np.eye(4)
    front[:3, :3] = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    assert sorted(f.name for f in folders) == list(data.ids())
    for name in data.ids():
        family, seed, index = name.rsplit("_", 2)
        read = data.load(name).object
        made = make(family, int(seed), int(index)).object.moved(front)
        assert read.category == family
        for a, b in zip(read.parts, made.parts, strict=True):
            assert (a.link, a.name) == (b.link, b.name)
            assert np.allclose(a.bounds, b.bounds, atol=1e-5)
        for joint in made.tree.joints:
            if not joint.child.startswith("link_"):
                continue
            again = read.tree.joint_of[joint.child]
            assert again.type == joint.type
            assert np.allclose(again.axis, joint.axis, atol=1e-6)
            assert np.allclose(again.origin, joint.origin, atol=1e-6)
            if joint.limited:
                assert np.allclose([again.lower, again.upper], [joint.lower, joint.upper])
        nodes = json.loads((tmp_path / name / "mobility_v2.json").read_text())
        assert {f"link_{n['id']}" for n in nodes} == {p.link for p in read.parts}
        assert sum(n["parent"] == -1 for n in nodes) == 1


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_demo_objects_have_a_truth_and_clicks_that_fit(name: str) -> None:
    path = next(FOLDER.glob(f"{name}.[gp]l[by]"))
    asset = open_asset(path)
    truth = json.loads((FOLDER / "truth" / f"{name}.json").read_text())
    labels = np.concatenate([np.full(n, part) for part, n in truth["runs"]])
    assert len(labels) == asset.element_count
    assert set(np.unique(labels)) - {-1} == {p["id"] for p in truth["parts"]}
    low, high = asset.bounds
    assert 0.1 < np.linalg.norm(high - low) < 3 and high[2] > 0
    prompts = json.loads((FOLDER / f"{name}.prompts.json").read_text())
    centers = asset.element_centers
    from scipy.spatial import KDTree

    tree = KDTree(centers[labels >= 0]) if asset.mesh is None else None
    for click in prompts["clicks"]:
        assert (np.asarray(click["position"]) >= low - 1e-3).all()
        assert (np.asarray(click["position"]) <= high + 1e-3).all()
        if tree is not None:
            near = labels[labels >= 0][tree.query(click["position"], k=7)[1]]
            assert np.bincount(near).argmax() == click["part"], f"{name}: click {click}"
    assert {p["id"] for p in prompts["parts"]} <= {p["id"] for p in truth["parts"]}
    assert len(prompts["clicks"]) >= len(prompts["parts"])


@pytest.mark.parametrize("name", ["cabinet", "kettle"])
def test_clicks_of_demo_meshes_cut_them_exactly(name: str) -> None:
    session, (labels, _) = encoded_demo(name), demo_truth(name)
    assert session.asset.mesh is not None
    file = read_prompts(FOLDER / f"{name}.prompts.json")
    found = session.segment(file.prompts).labels
    areas = session.asset.mesh.face_areas
    assert areas[found != labels].sum() < 1e-3 * areas.sum()


def test_demo_objects_are_made_again_by_the_command(tmp_path: Path) -> None:
    for path in write_examples(tmp_path, names=("laptop",)):
        again, shipped = open_asset(path), open_asset(FOLDER / path.name)
        assert again.element_count == shipped.element_count
        assert np.allclose(again.element_centers, shipped.element_centers, atol=1e-5)
        truth = f"truth/{path.stem}.json"
        assert json.loads((tmp_path / truth).read_text()) == json.loads(
            (FOLDER / truth).read_text()
        )
    assert sum(p.stat().st_size for p in FOLDER.rglob("*") if p.is_file()) < 12e6
