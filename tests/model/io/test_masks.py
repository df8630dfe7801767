"""Masks of other systems, on files made as their public code writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from model.core.asset import Asset
from model.core.errors import InputFileError
from model.io.masks import read_masks, with_masks
from model.io.open_asset import open_asset
from tests.builders import cabinet_cloud, cabinet_mesh, ply_head

CABINET = cabinet_mesh(2)
"""A body (0), two doors (1, 2) with a knob each; +z up, 0.8 m high."""
SEEN = np.abs(CABINET.asset.element_centers[:, 1]) > 1e-6
"""Faces aside the doors' backs and the body behind them, which touch: nearest is either."""
KINDS = {0: "", 1: "left door", 2: "right door"}


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """The cabinet as an OBJ, Y up, as people have it."""
    path = tmp_path / "cabinet.obj"
    y_up(trimesh_of()).export(path)
    return path


def trimesh_of(times: int = 2) -> trimesh.Trimesh:
    mesh = cabinet_mesh(times).asset.mesh
    assert mesh is not None
    return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False)


def y_up(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.vertices = mesh.vertices[:, [0, 2, 1]] * [1, 1, -1]
    return mesh


def normalised(mesh: Any) -> Any:
    """As networks take it: centred, within a unit box."""
    low, high = mesh.bounds
    mesh.vertices = (mesh.vertices - (low + high) / 2) / (high - low).max()
    return mesh


def parts_of(scan: Path, masks: Path) -> tuple[Asset, list[str]]:
    asset = with_masks(open_asset(scan), masks)
    assert asset.element_part is not None
    return asset, list(asset.part_names)


def agrees(asset: Asset, truth: np.ndarray, least: float = 1.0) -> bool:
    """Whether parts are the true ones, whatever their numbers; the base is 0."""
    part = asset.element_part
    assert part is not None
    if least < 1.0:
        part, truth = part[SEEN], truth[SEEN]
    shares = []
    for label in np.unique(truth):
        found = np.bincount(part[truth == label])
        shares.append(found.max() / found.sum())
        assert (found.argmax() == 0) == (label == 0)
    assert len(np.unique(part)) == len(np.unique(truth))
    return min(shares) >= least


# --- the files of the systems that the documents name


def partslip(folder: Path, part_names: dict[str, tuple[int, ...]]) -> Path:
    """``src/utils.py``: save_colored_pc, one ASCII cloud a part name, all points in each, centred
    and within a unit ball."""
    cloud = cabinet_cloud(6000)
    xyz = cloud.asset.cloud.points.astype(float)  # type: ignore[union-attr]
    xyz = xyz - xyz.mean(axis=0)
    xyz /= np.linalg.norm(xyz, axis=1).max()
    rng = np.random.default_rng(3)
    (folder / "instance_seg").mkdir(parents=True)
    for name, labels in part_names.items():
        rgb = np.zeros((len(xyz), 3))
        for label in labels:
            rgb[cloud.labels == label] = rng.random(3)
        rgb = (rgb * 255).astype(np.uint8)
        head = ply_head(len(xyz), "float x y z", "uchar red green blue")
        rows = [
            " ".join([*(f"{v:f}" for v in p), *map(str, c)]) for p, c in zip(xyz, rgb, strict=True)
        ]
        (folder / "instance_seg" / f"{name}.ply").write_text(head + "\n".join(rows) + "\n")
    return folder


def test_partslip_instances_with_names_on_another_resolution(scan: Path, tmp_path: Path) -> None:
    folder = partslip(tmp_path / "result_ps++/Cabinet/1", {"door": (1, 2), "handle": ()})
    asset, names = parts_of(scan, folder)
    assert names == ["", "door", "door"] and agrees(asset, CABINET.labels, 0.9)
    direct, _ = parts_of(scan, folder / "instance_seg")
    assert np.array_equal(direct.element_part, asset.element_part)


def test_partfield_kmeans_of_a_normalised_mesh(scan: Path, tmp_path: Path) -> None:
    """``run_part_clustering.py``: (F, 1) float64 in cluster_out/, the coloured mesh in ply/."""
    labels = cabinet_mesh(1).labels
    for name in ("cluster_out", "ply"):
        (tmp_path / "clustering" / name).mkdir(parents=True)
    np.save(tmp_path / "clustering/cluster_out/cab_0_03.npy", labels[:, None].astype(np.float64))
    mesh = normalised(y_up(trimesh_of(1)))
    mesh.visual.face_colors = np.array([[31, 119, 180, 255]] * len(mesh.faces))
    mesh.export(tmp_path / "clustering/ply/cab_0_03.ply")
    asset, _ = parts_of(scan, tmp_path / "clustering/cluster_out/cab_0_03.npy")
    assert agrees(asset, CABINET.labels, 0.95)


def test_sampart3d_labels_of_the_faces(scan: Path, tmp_path: Path) -> None:
    """``pointcept/engines/eval.py``: mesh_<scale>.npy with an int a face of the given mesh."""
    (tmp_path / "results/last").mkdir(parents=True)
    np.save(tmp_path / "results/last/mesh_1.0.npy", np.array([7, 0, 3])[CABINET.labels])
    asset, _ = parts_of(scan, tmp_path / "results/last/mesh_1.0.npy")
    assert agrees(asset, CABINET.labels)
    assert asset.element_part[CABINET.labels == 1].max() == 1, "parts follow the labels' order"


def test_p3_sam_face_ids_of_its_cleaned_mesh(scan: Path, tmp_path: Path) -> None:
    """``P3-SAM/demo/auto_mask.py``: save_mesh, with -1 and -2 for faces without a part."""
    labels = cabinet_mesh(1).labels.astype(np.int64) + 4
    labels[[-1, -2]] = -1, -2
    np.save(tmp_path / "auto_mask_mesh_final_face_ids.npy", labels)
    mesh = y_up(trimesh_of(1))
    mesh.visual.face_colors = np.array([[200, 30, 30, 255]] * len(mesh.faces))
    mesh.export(tmp_path / "auto_mask_mesh_final.ply")
    asset, _ = parts_of(scan, tmp_path / "auto_mask_mesh_final_face_ids.npy")
    assert agrees(asset, CABINET.labels, 0.9)


def test_particulate_results_for_evaluation(scan: Path, tmp_path: Path) -> None:
    """``infer.py --eval``: pred.npz beside pred.obj, the input mesh."""
    (tmp_path / "eval").mkdir()
    y_up(trimesh_of(1)).export(tmp_path / "eval/pred.obj")
    np.savez(
        tmp_path / "eval/pred.npz", face_part_ids=cabinet_mesh(1).labels,
        motion_hierarchy=[(0, 1), (0, 2)], is_part_revolute=np.array([False, True, True]),
        is_part_prismatic=np.zeros(3, bool), revolute_plucker=np.zeros((3, 6)),
        revolute_range=np.zeros((3, 2)), prismatic_axis=np.zeros((3, 3)),
        prismatic_range=np.zeros((3, 2)),
    )  # fmt: skip
    asset, _ = parts_of(scan, tmp_path / "eval/pred.npz")
    assert agrees(asset, CABINET.labels, 0.95)


# --- plain forms


def test_an_archive_with_instances_kinds_and_names(scan: Path, tmp_path: Path) -> None:
    cloud = cabinet_cloud(5000)
    np.savez(
        tmp_path / "m.npz", points=cloud.asset.cloud.points,  # type: ignore[union-attr]
        instance=np.where(cloud.labels == 0, -1, cloud.labels + 10),
        semantic=np.where(cloud.labels == 0, -1, 1), names=np.array(["drawer", "door"]),
    )  # fmt: skip
    asset, names = parts_of(scan, tmp_path / "m.npz")
    assert names == ["", "door", "door"] and agrees(asset, CABINET.labels, 0.9)


@pytest.mark.parametrize("element", ["vertex", "face"])
def test_a_property_of_a_ply(element: str, scan: Path, tmp_path: Path) -> None:
    mesh = y_up(trimesh_of())
    part = "int part_id"
    fields = ["float x y z", *[part] * (element == "vertex")]
    head = ply_head(
        len(mesh.vertices), *fields, faces=len(mesh.faces), more=part if element == "face" else ""
    )
    label = [[p] for p in CABINET.labels] if element == "face" else [[]] * len(mesh.faces)
    of_vertex = np.repeat(CABINET.labels, 3)  # no two faces share one
    more = [[p] for p in of_vertex] if element == "vertex" else [[]] * len(mesh.vertices)
    rows = [" ".join(map(str, [*v, *m])) for v, m in zip(mesh.vertices, more, strict=True)]
    rows += [" ".join(map(str, [3, *f, *m])) for f, m in zip(mesh.faces, label, strict=True)]
    path = tmp_path / "labelled.ply"
    path.write_text(head + "\n".join(rows) + "\n")
    asset, _ = parts_of(scan, path)
    assert agrees(asset, CABINET.labels, 0.95)


@pytest.mark.parametrize("form", ["folder", "glb"])
def test_a_mesh_for_each_part(form: str, scan: Path, tmp_path: Path) -> None:
    whole = trimesh_of()
    pieces = {KINDS[p] or "mesh_0": whole.submesh([np.flatnonzero(CABINET.labels == p)])[0]
              for p in range(3)}  # fmt: skip
    if form == "folder":
        masks = tmp_path / "pieces"
        masks.mkdir()
        for name, piece in pieces.items():
            piece.export(masks / f"{name}.ply")
    else:
        masks = tmp_path / "pieces.glb"
        scene = trimesh.Scene()
        for name, piece in pieces.items():
            scene.add_geometry(y_up(piece), node_name=name, geom_name=name)
        scene.export(masks)
    asset, names = parts_of(scan, masks)
    assert sorted(names) == ["", "left door", "right door"] and not names[0]
    assert agrees(asset, CABINET.labels, 0.95)


def test_parts_alone_leave_the_rest_to_the_base(scan: Path, tmp_path: Path) -> None:
    door = trimesh_of().submesh([np.flatnonzero(CABINET.labels == 1)])[0]
    (tmp_path / "found").mkdir()
    door.export(tmp_path / "found/door.ply")
    asset, names = parts_of(scan, tmp_path / "found")
    assert names == ["", "door"]
    assert agrees(asset, np.where(CABINET.labels == 1, 1, 0), 0.95)


def test_labels_of_a_cloud(tmp_path: Path) -> None:
    cloud = cabinet_cloud(3000)
    np.save(tmp_path / "m.npy", cloud.labels)
    asset = with_masks(cloud.asset, tmp_path / "m.npy")
    assert agrees(asset, cloud.labels)


# --- what is wrong is told


def broken(tmp_path: Path, labels: Any, name: str = "m.npy") -> Path:
    np.save(tmp_path / name, labels)
    return tmp_path / name


@pytest.mark.parametrize(
    ("labels", "told"),
    [
        (np.zeros(0, int), "its array is empty"),
        (np.array([0.0, np.nan, 1.0]), "nan at element 1"),
        (np.array([0, 1, -4]), "-4 at element 2"),
        (np.array([0, 1, -2]), "-2 at element 2"),
        (np.array([0.0, 0.5]), "0.5 at element 1"),
        (np.zeros((4, 3)), r"shape \(4, 3\)"),
        (np.array(["door", "body"]), "shape"),
        (np.array([{"a": 1}], object), "pickled objects aren't read"),
    ],
)
def test_wrong_labels_are_told_with_the_file(labels: Any, told: str, tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=rf"m\.npy.*{told}.*(whole number|give an \.npy)"):
        read_masks(broken(tmp_path, labels))


def test_a_wrong_length_says_both_counts(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"m\.npy.*7 labels for 960 faces.*m\.ply"):
        with_masks(CABINET.asset, broken(tmp_path, np.arange(7)))


def test_one_label_and_masks_of_another_object_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="cuts cabinet into 1 part; two to 1000 are needed"):
        with_masks(CABINET.asset, broken(tmp_path, np.zeros(960, int)))
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.export(tmp_path / "ball.ply")
    masks = broken(tmp_path, np.arange(len(ball.faces)) % 3, "ball.npy")
    with pytest.raises(InputFileError, match="isn't that of cabinet"):
        with_masks(CABINET.asset, masks)


@pytest.mark.parametrize("name", ["none.npz", "m.txt", "m.ply", "m.glb", "empty"])
def test_files_without_masks_say_what_would_be_right(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if name == "none.npz":
        np.savez(path, features=np.zeros((3, 8)))
    elif name == "empty":
        path.mkdir()
    elif name == "m.txt":
        path.write_text("0 1 2")
    else:
        trimesh.creation.box().export(path)
    with pytest.raises(InputFileError, match=name):
        read_masks(path)
    path.rmdir() if path.is_dir() else path.write_bytes(b"")
    with pytest.raises(InputFileError, match=name):
        read_masks(path)
