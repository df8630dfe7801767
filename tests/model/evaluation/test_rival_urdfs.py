"""URDFs of other systems, made as their public code writes them: scored, and opened."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from model.core.errors import InputFileError
from model.core.geometry import Mesh
from model.data.registry import DatasetOptions
from model.evaluation.report import Report
from model.evaluation.run import EvaluationConfig, evaluate
from model.io.open_asset import open_asset
from tests.builders import box, spans
from tests.model.evaluation.test_predictions import cabinet, write

PARTS = {p.link: p.mesh for p in cabinet().parts}
"""link_0 body, 1 door, 2 knob, 3 drawer, 4 shelf (fixed)."""
HINGE, KNOB = np.array([0, 0, 0.8]), np.array([-0.04, 0.92, 0.72])
INERTIAL = '<inertial><mass value="1.0"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'  # noqa: E501


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("truth")
    write(cabinet(), root / "cab")
    return root


def scored(data: Path, folder: Path) -> Report:
    config = EvaluationConfig(DatasetOptions("urdf", data), predictions=folder, jobs=1)
    return evaluate(config)


def mesh_file(path: Path, mesh: Mesh | None, move: Callable = lambda v: v) -> None:
    assert mesh is not None
    path.parent.mkdir(parents=True, exist_ok=True)
    vertices = move(np.asarray(mesh.vertices, float))
    trimesh.Trimesh(vertices, np.asarray(mesh.faces), process=False).export(path)


def joint(
    kind: str, parent: str, child: str, xyz: Any = (0, 0, 0), axis: Any = (1, 0, 0), low=0, high=0.0
) -> str:
    x, a = (" ".join(f"{v:.6f}" for v in np.asarray(w, float)) for w in (xyz, axis))
    return (
        f'<joint name="{parent}_{child}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{x}" rpy="0 0 0"/><axis xyz="{a}"/>'
        f'<limit lower="{low:.6f}" upper="{high:.6f}" effort="1000" velocity="100"/></joint>'
    )


def link(name: str, file: str, more: str = "") -> str:
    shape = f'<geometry><mesh filename="{file}"{more}/></geometry>'
    return (
        f'<link name="{name}"><visual><origin xyz="0 0 0" rpy="0 0 0"/>{shape}</visual>'
        f"<collision>{shape}</collision>{INERTIAL}</link>"
    )


def urdf(path: Path, *body: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'<?xml version="1.0"?>\n<robot name="model">{"".join(body)}</robot>')
    return path


def particulate(folder: Path) -> Path:
    """``particulate/export_utils.py``: within a unit box, every link about its joint; a part whose
    parent is gone hangs on nothing."""
    low, high = (np.array(v) for v in ((-0.06, 0, 0), (0.6, 1.0, 1.2)))

    def unit(v: np.ndarray) -> np.ndarray:
        return (v - (low + high) / 2) / 1.2

    home = folder / "cab/urdf_20260101_120000"
    at = {1: unit(HINGE), 2: unit(KNOB), 3: unit(np.asarray(PARTS["link_3"].vertices)).mean(0)}
    for i in range(5):
        origin = at.get(i, np.zeros(3))
        mesh_file(
            home / f"meshes/part_{i}.obj", PARTS[f"link_{i}"], lambda v, o=origin: unit(v) - o
        )
    links = [link(f"link_{i}", f"./meshes/part_{i}.obj") for i in range(5)]
    door = joint("revolute", "link_0", "link_1", at[1], (0, 0, -1), 0, 1.6)
    knob = joint("revolute", "link_1", "link_2", at[2] - at[1], (1, 0, 0), -3.14, 3.14)
    drawer = joint("prismatic", "link_0", "link_3", at[3], (-1, 0, 0), 0, 0.4 / 1.2)
    return urdf(home / "model.urdf", *links, door, knob, drawer)


def articulate_anything(folder: Path) -> Path:
    """``articulate_anything``: absolute paths of meshes, a base and a helper without geometry, and
    links called after what they are."""
    far = "/home/user/articulate-anything/datasets/partnet-mobility-v0/dataset/cab/textured_objs"
    turn = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    names = ("body", "door", "knob", "drawer", "shelf")
    for i in range(5):
        path = folder / f"cab/textured_objs/original-{i}.obj"
        mesh_file(path, PARTS[f"link_{i}"], lambda v: v @ turn.T)
    bolts = (("base", "base_helper", 0), ("base_helper", "body", math.pi / 2), ("body", "shelf", 0))
    fixed = "".join(
        f'<joint type="fixed" name="{a}_to_{b}"><parent link="{a}"/><child link="{b}"/>'
        f'<origin xyz="0 0 0" rpy="{r} 0 0"/></joint>'
        for a, b, r in bolts
    )
    moving = [
        joint("revolute", "body", "door", (0, 0, 0), turn @ [0, 0, -1], 0, 1.6),
        joint("continuous", "door", "knob", turn @ KNOB, turn @ [1, 0, 0], -3, 3),
        joint("prismatic", "body", "drawer", (0, 0, 0), turn @ [-1, 0, 0], 0, 0.4),
    ]
    moved = ' <visual ><origin xyz="{}"/>'.format(" ".join(map(str, (-(turn @ KNOB)).tolist())))
    links = [link(n, f"{far}/original-{i}.obj") for i, n in enumerate(names)]
    links[2] = links[2].replace('<visual><origin xyz="0 0 0" rpy="0 0 0"/>', moved)
    bases = '<link name="base"/><link name="base_helper"/>'
    return urdf(folder / "cab/mobility.urdf", bases, *links, fixed, *moving)


def urdf_anything(folder: Path) -> Path:
    """``scripts/reconstruct_urdf.py``: clouds as OBJ files without faces, ``pred`` beside ``gt``,
    and a base link without geometry."""
    home = folder / "cab/pred"
    rng = np.random.default_rng(0)
    at = {1: HINGE, 2: KNOB}
    for i in range(5):
        mesh = PARTS[f"link_{i}"]
        assert mesh is not None
        solid = trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False)
        points = trimesh.sample.sample_surface(solid, 3000, seed=rng)[0] - at.get(i, 0)
        (home / "meshes").mkdir(parents=True, exist_ok=True)
        trimesh.points.PointCloud(points).export(home / f"meshes/link_{i}.obj")
    urdf(folder / "cab/gt/mobility.urdf", '<link name="base"/>')
    links = [link(f"link_{i}", f"meshes/link_{i}.obj") for i in range(5)]
    fixed = [joint("fixed", "base", f"link_{i}") for i in (0, 4)]
    door = joint("revolute", "link_0", "link_1", HINGE, (0, 0, -1), 0, 1.6)
    knob = joint("continuous", "link_1", "link_2", KNOB - HINGE)
    drawer = joint("prismatic", "link_0", "link_3", axis=(-1, 0, 0), high=0.4)
    return urdf(home / "mobility.urdf", '<link name="base"/>', *links, *fixed, door, knob, drawer)


def urdformer(folder: Path) -> Path:
    """``utils.py``: write_urdfs, unit meshes of its own that are stretched, in ``../meshes``."""
    unit = box([0, 0, 0], [1, 1, 1])
    walls = spans("0 0 0 1 1 .02  0 0 .98 1 1 1  0 0 0 1 .02 1  0 .98 0 1 1 1  .97 0 0 1 1 1")
    open_box = trimesh.util.concatenate([box(*corners) for corners in walls])
    home = folder.parent / "meshes"
    (home / "parts").mkdir(parents=True, exist_ok=True)
    open_box.export(home / "cabinet.obj")
    for name in ("doorL", "drawer", "knob"):
        unit.export(home / f"parts/{name}.obj")
    (folder.parent / "package.xml").write_text("<package/>")
    return urdf(
        folder / "cab.urdf",
        link("base_link", "../meshes/cabinet.obj", ' scale="0.6 1.0 1.2"'),
        link("doorL0", "../meshes/parts/doorL.obj", ' scale="0.02 1.0 0.8"'),
        link("drawer1", "../meshes/parts/drawer.obj", ' scale="0.02 1.0 0.38"'),
        link("knob2", "../meshes/parts/knob.obj", ' scale="0.04 0.04 0.04"'),
        joint("revolute", "base_link", "doorL0", (-0.02, 0, 0.4), (0, 0, -1), 0, 1.57),
        joint("prismatic", "base_link", "drawer1", (-0.02, 0, 0), (-1, 0, 0), 0, 0.4),
        joint("fixed", "doorL0", "knob2", (-0.04, 0.9, 0.3), (0, 0, 1), 0, 1.57),
    )


def anymesh(folder: Path) -> Path:
    """``joint_estimation.py`` and ``postprocess_segmentation.py``: mobility.json, mesh_parts."""
    home = folder / "cab"
    names = ("base", "door@0", "knob@0", "drawer@0")
    for i, name in enumerate(names):
        mesh_file(home / f"mesh_parts/{name}.glb", PARTS[f"link_{i}"])
    mesh_file(home / "mesh_normalized.glb", PARTS["link_0"])
    joints = (
        ("base", "revolute", HINGE.tolist(), [0, 0, -2.0]),
        ("door@0", "continuous", KNOB.tolist(), [1, 0, 0]),
        ("base", "prismatic", [0, 0, 0], [-1, 0, 0]),
    )
    parts = [{"id": 3, "parent": None, "joint": "fixed", "name": "base", "jointData": {}}]
    for i, (parent, kind, origin, direction) in enumerate(joints):
        axis = {"axis": {"origin": origin, "direction": direction}}
        said = {"parent": parent, "joint": kind, "name": names[i + 1], "jointData": axis}
        parts.insert(i, {"id": i, **said})
    (home / "mobility.json").write_text(json.dumps(parts))
    return home


def simart(folder: Path) -> Path:
    """As its paper has it: a URDF with a mesh a part, Y up; no code is public."""
    turn = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    for i in range(5):
        mesh_file(folder / f"cab/part_{i}.obj", PARTS[f"link_{i}"], lambda v: v @ turn.T)
    shift = turn @ KNOB
    knob = link("part_2", "part_2.obj").replace(
        'xyz="0 0 0"', 'xyz="{} {} {}"'.format(*(-shift)), 1
    )
    links = [link(f"part_{i}", f"part_{i}.obj") for i in range(5)]
    links[2] = knob
    return urdf(
        folder / "cab/object.urdf",
        *links,
        joint("revolute", "part_0", "part_1", (0, 0, 0), turn @ [0, 0, -1], 0, 1.6),
        joint("continuous", "part_1", "part_2", shift, turn @ [1, 0, 0]),
        joint("prismatic", "part_0", "part_3", axis=turn @ [-1, 0, 0], high=0.4),
        joint("fixed", "part_0", "part_4"),
    )


WHOLE = {f.__name__: f for f in (particulate, articulate_anything, urdf_anything, simart)}
"""These tell all of the cabinet, so nothing may be lost."""


@pytest.mark.parametrize("name", WHOLE)
def test_a_right_answer_is_right_whatever_its_frame_and_files(
    name: str, data: Path, tmp_path: Path
) -> None:
    WHOLE[name](tmp_path / "out")
    report = scored(data, tmp_path / "out")
    (score,) = report.scores
    assert not score.problem
    for key in ("tc", "usable_joints", "mao_f1", "parent"):
        assert report.summary[key] == pytest.approx(1.0), key
    assert report.summary["apd"] < 1e-3 and report.summary["opd_line"] < 1e-3


def test_primitive_meshes_are_matched_where_they_fit(data: Path, tmp_path: Path) -> None:
    urdformer(tmp_path / "urdformer/output")
    report = scored(data, tmp_path / "urdformer/output")
    (score,) = report.scores
    found = {j.child: j for j in score.joints}
    assert not score.problem and found["link_1"].type_right and found["link_1"].apd < 1e-6
    assert found["link_2"].type == "missing", "it joined the knob to its door"


def test_anymesh_tells_no_ranges(data: Path, tmp_path: Path) -> None:
    anymesh(tmp_path / "out")
    report = scored(data, tmp_path / "out")
    (score,) = report.scores
    assert not score.problem and report.summary["tc"] == 1.0
    assert report.summary["apd"] < 1e-6 and report.summary["opd_line"] < 1e-6
    assert report.summary["range_right"] < 1.0


MAKERS = {**WHOLE, "urdformer": lambda folder: urdformer(folder / "output"), "anymesh": anymesh}


@pytest.mark.parametrize("name", MAKERS)
def test_the_same_files_open_with_their_parts_and_joints(name: str, tmp_path: Path) -> None:
    made = MAKERS[name](tmp_path / "out")
    if name == "particulate":
        text = made.read_text()
        with pytest.raises(InputFileError, match=r"2 roots.*join what stands apart"):
            open_asset(made)
        bolt = joint("fixed", "link_0", "link_4")
        made.write_text(text.replace("</robot>", f"{bolt}</robot>"))
    asset = open_asset(made)
    assert asset.tree is not None and asset.element_part is not None
    moving = [j.type for j in asset.tree.joints if j.moves]
    assert len(moving) == (2 if name == "urdformer" else 3)
    if name == "articulate_anything":
        assert any("another machine" in w for w in asset.warnings)
    if name == "anymesh":
        assert asset.name == "cab" and set(asset.part_names) >= {"door@0"}


def test_a_broken_mobility_json_is_told(tmp_path: Path) -> None:
    home = anymesh(tmp_path)
    for text in ('[{"id": 0}]', '[{"name": "a"}, {"name": "a"}]', "[", '{"name": 1}'):
        (home / "mobility.json").write_text(text)
        with pytest.raises(InputFileError, match=r"mobility\.json.*list of parts"):
            open_asset(home)
    entry = {"id": 0, "parent": "nobody", "joint": "hinge", "name": "door@0", "jointData": {}}
    (home / "mobility.json").write_text(json.dumps([entry]))
    with pytest.raises(InputFileError, match="nobody"):
        open_asset(home)


def test_absolute_paths_never_leave_the_folder(tmp_path: Path) -> None:
    (tmp_path / "secret.obj").write_text("v 0 0 0\n")
    path = urdf(tmp_path / "in/a.urdf", link("a", str(tmp_path / "secret.obj")))
    with pytest.raises(InputFileError, match="absolute path"):
        open_asset(path)
