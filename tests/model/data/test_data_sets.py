"""PhysXNet, URDF and MJCF folders, procedural objects, and splits behind one protocol."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from model.core.errors import ConfigurationError, InputFileError
from model.data.registry import (
    Dataset,
    DatasetOptions,
    dataset_names,
    in_test,
    is_held_out,
    open_dataset,
    select,
)


def obj_file(path: Path, size: tuple[float, ...], at: tuple[float, ...]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh = trimesh.creation.box(extents=size)
    mesh.apply_translation(at)
    path.write_text(trimesh.exchange.obj.export_obj(mesh))


# --- PhysXNet


@pytest.fixture
def physxnet(tmp_path: Path) -> Path:
    root = tmp_path / "physxnet"
    objs = root / "partseg" / "12" / "objs"
    for label, at in enumerate(((0, 0, 0), (0, 0, 0.3), (0.4, 0, 0), (0, 0.4, 0), (0, 0, -0.4))):
        obj_file(objs / f"{label}.obj", (1.0, 0.4, 0.2) if label == 0 else (0.1, 0.1, 0.1), at)
    document = {
        "object_name": "thing",
        "category": "Cabinet",
        "dimension": "80*10*25",
        "parts": [{"label": i, "name": n} for i, n in enumerate(("body", "door", "knob", "cap"))],
        "group_info": {
            "0": [0],
            "1": [[1], "0", [0, 1, 0, 0.5, 0, 0.1, 0, 0.5], "C"],
            "2": [[2], "1", [0, 0, 1, 0.4, 0, 0, -1, 1], "C"],
            "3": [[3], "0", [0, 1, 0, 0, 0.4, 0, -0.5, 0.5, 0, 1, 0, 0, 0, 0, 0, 0.2], "CB"],
            "4": [[4], "0", [], "A"],
        },
    }
    (root / "finaljson").mkdir()
    (root / "finaljson" / "12.json").write_text(json.dumps(document))
    return root


def test_physxnet_is_turned_scaled_and_chained(physxnet: Path) -> None:
    data = open_dataset(DatasetOptions("physxnet", physxnet))
    assert data.ids() == ("12",) and data.category("12") == "Cabinet"
    truth = data.load("12")
    tree, parts = truth.object.tree, {p.link: p for p in truth.object.parts}
    assert {p.name for p in parts.values()} == {"body", "door", "knob", "cap"}
    assert any("free" in n for n in truth.notes)  # the fifth part is the body's
    scale = 0.8  # its longest side is 80 cm
    assert np.ptp(parts["link_0"].bounds[:, 0]) == pytest.approx(scale * 1.0)
    door = tree.joint_of["link_1"]
    assert (door.type, door.parent) == ("revolute", "link_0")
    assert door.axis == pytest.approx((0, 0, 1))  # Y up in the file
    assert door.origin == pytest.approx((scale * 0.5, scale * -0.1, 0))
    assert (door.lower, door.upper) == pytest.approx((0, 0.5 * math.pi))
    assert (tree.joint_of["link_2"].type, tree.joint_of["link_2"].parent) == (
        "continuous",
        "link_1",
    )
    slide = tree.joint_of["link_3"]
    turn = tree.joint_of[slide.parent]
    assert (turn.type, slide.type, turn.parent) == ("revolute", "prismatic", "link_0")
    assert slide.upper == pytest.approx(scale * 0.2)


@pytest.mark.parametrize(
    ("group", "said"),
    [
        ([[1], "0", [0, 1], "C"], "numbers"),
        ([[1], "0", [], "Z"], "'Z'"),
        ([[1], "9", [], "A"], "'9'"),
        ([[1], "0"], r"group_info\['1'\]"),
        ([[1], "0", [0, 0, 0, 0, 0, 0, 0, 1], "B"], "zero"),
        ([[1], "1", [], "A"], "itself|both|cycle|root"),
        ([[77], "0", [], "A"], r"77\.obj"),
    ],
)
def test_a_wrong_group_is_named(physxnet: Path, group: object, said: str) -> None:
    path = physxnet / "finaljson" / "12.json"
    document = json.loads(path.read_text())
    document["group_info"] = {"0": [0], "1": group}
    path.write_text(json.dumps(document))
    with pytest.raises(InputFileError, match=said):
        open_dataset(DatasetOptions("physxnet", physxnet)).load("12")


# --- URDF and MJCF

LINK = '<link name="{0}"><visual><geometry><box size="{1}"/></geometry></visual></link>'
URDF = f"""<robot name="r">{LINK.format("body", "1 1 1")}{LINK.format("lid", "1 1 0.1")}
{LINK.format("grip", "0.1 0.1 0.1")}
<joint name="hinge" type="revolute"><parent link="body"/><child link="lid"/>
<axis xyz="1 0 0"/><limit lower="0" upper="1"/></joint>
<joint name="glue" type="fixed"><parent link="lid"/><child link="grip"/></joint></robot>"""


def test_a_folder_of_urdfs(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "any.urdf").write_text(URDF)
    description = {"category": "Box", "names": {"lid": "lid", "nobody": "x"}}
    (tmp_path / "a" / "object.json").write_text(json.dumps(description))
    (tmp_path / "b.urdf").write_text(URDF)
    (tmp_path / "c").mkdir()
    for name in ("one", "two"):
        (tmp_path / "c" / f"{name}.urdf").write_text(URDF)
    data = open_dataset(DatasetOptions("urdf", tmp_path))
    assert data.ids() == ("a", "b", "c.one", "c.two")
    truth = data.load("a")
    assert truth.object.category == data.category("a") == "Box"
    assert [(p.link, p.name) for p in truth.object.parts] == [
        ("link_body", None),
        ("link_lid", "lid"),
    ]
    assert any("merged" in n for n in truth.notes)
    assert data.category("b") is None
    with pytest.raises(InputFileError, match="a, b"):
        data.load("z")


MJCF = """<mujoco><compiler angle="degree"/><worldbody><body name="case" pos="0 0 1">
<geom type="box" size="0.5 0.5 0.5" contype="0" conaffinity="0"/>
<geom type="sphere" size="9" group="3"/>
<body name="drawer" pos="0 -0.5 0"><joint type="slide" axis="0 -2 0" range="0 0.4"/>
<geom type="box" size="0.4 0.02 0.2" contype="0" conaffinity="0"/>
<body name="knob"><joint name="turn" type="hinge" axis="0 1 0" pos="0.1 0 0" range="-90 90"/>
<joint name="pull" type="slide" axis="0 -1 0" range="0 0.01"/>
<geom type="cylinder" size="0.03 0.02" contype="0" conaffinity="0"/></body></body>
</body></worldbody></mujoco>"""


def test_mjcf_through_mujoco(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "cupboard.xml").write_text(MJCF)
    truth = open_dataset(DatasetOptions("mjcf", tmp_path)).load("cupboard")
    tree, parts = truth.object.tree, {p.link: p for p in truth.object.parts}
    assert set(parts) == {"link_case", "link_drawer", "link_knob"}
    assert parts["link_case"].bounds == pytest.approx(
        np.array([[-0.5, -0.5, 0.5], [0.5, 0.5, 1.5]]), abs=1e-6
    )  # the sphere collides and isn't seen
    drawer = tree.joint_of["link_drawer"]
    assert (drawer.type, drawer.parent, drawer.upper) == ("prismatic", "link_case", 0.4)
    assert drawer.axis == pytest.approx((0, -1, 0))
    pull = tree.joint_of["link_knob"]
    turn = tree.joint_of[pull.parent]
    assert (turn.type, pull.type, turn.parent) == ("revolute", "prismatic", "link_drawer")
    assert turn.origin == pytest.approx((0.1, -0.5, 1.0))
    assert turn.upper == pytest.approx(math.pi / 2)
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody><body>")
    with pytest.raises(InputFileError, match=r"broken\.xml"):
        open_dataset(DatasetOptions("mjcf", tmp_path)).load("broken")


def test_real_mjcf_files(shared_data: Path) -> None:
    pytest.importorskip("mujoco")
    data = open_dataset(DatasetOptions("mjcf", shared_data / "articulated_free" / "libero"))
    truth = data.load("microwave").object
    door = next(j for j in truth.tree.joints if j.moves)
    assert (door.type, len(truth.parts)) == ("revolute", 2)
    assert abs(door.axis[2]) == pytest.approx(1.0)


# --- Procedural objects


def test_made_objects_are_those_that_generate_writes(tmp_path: Path) -> None:
    from model.data.procedural.generate import GenerateSettings, generate

    generate(GenerateSettings(tmp_path, ("Safe", "Laptop"), n=1, seed=4))
    written = open_dataset(DatasetOptions("procedural", tmp_path))
    made = open_dataset(DatasetOptions("procedural", None, seed=4, families=("Safe", "Laptop")))
    assert written.ids() == made.ids() == ("Laptop_4_0", "Safe_4_0")
    for object_id in made.ids():
        a, b = made.load(object_id).object, written.load(object_id).object
        assert made.category(object_id) == written.category(object_id) == a.category
        for one, other in zip(a.parts, b.parts, strict=True):
            assert one.bounds == pytest.approx(other.bounds, abs=1e-5)
        for joint in a.tree.joints:
            if joint.child.startswith("link_"):
                again = b.tree.joint_of[joint.child]
                assert joint.axis == pytest.approx(again.axis, abs=1e-6)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (DatasetOptions("nothing"), "partnet-mobility"),
        (DatasetOptions("urdf"), "--root"),
        (DatasetOptions("procedural", n=0), "1 or more"),
        (DatasetOptions("procedural", families=("Spaceship",)), "Spaceship"),
        (DatasetOptions("procedural", seed=-1), "seed"),
    ],
)
def test_what_cannot_be_opened_is_said(options: DatasetOptions, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        open_dataset(options)


@pytest.mark.parametrize("name", dataset_names())
def test_an_empty_or_missing_folder_is_named(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="no such folder"):
        open_dataset(DatasetOptions(name, tmp_path / "nowhere"))
    with pytest.raises(InputFileError):
        open_dataset(DatasetOptions(name, tmp_path)).ids()


# --- Splits


class Listed:
    """Names and categories, nothing to load."""

    name = "listed"

    def __init__(self, objects: dict[str, str | None]) -> None:
        self.objects = objects

    def ids(self) -> tuple[str, ...]:
        return tuple(self.objects)

    def category(self, object_id: str) -> str | None:
        return self.objects[object_id]

    def load(self, object_id: str):
        raise AssertionError("a split reads no geometry")


LISTED = Listed({"1": "Oven", "2": "Display", "3": "Pliers", "4": "Door", "5": None, "6": "Door"})


def test_the_papers_categories_are_held_out() -> None:
    assert isinstance(LISTED, Dataset)
    assert select(LISTED, "held-out") == ("1", "2", "3")
    assert select(LISTED, "known") == ("4", "5", "6")
    assert all(map(is_held_out, ("display", "Suitcase", "plier", "Pliers", "Kettle", "oven")))
    assert not is_held_out("Ovenproof") and not is_held_out(None)


def test_a_split_by_category_and_by_seed() -> None:
    assert select(LISTED, "category:door,OVEN") == ("1", "4", "6")
    many = Listed({str(i): None for i in range(400)})
    test, train = select(many, "test:0.25", seed=3), select(many, "train:0.25", seed=3)
    assert sorted(test + train, key=int) == list(many.ids()) and 70 < len(test) < 130
    assert test != select(many, "test:0.25", seed=4)
    fewer = Listed({i: None for i in many.ids()[::2]})
    assert set(select(fewer, "test:0.25", seed=3)) == set(test) & set(fewer.ids())
    assert in_test(test[0], 3, 0.25)


@pytest.mark.parametrize("split", ["nothing", "test:2", "test:x", "category:", "category:Spoon"])
def test_a_split_that_cannot_be(split: str) -> None:
    with pytest.raises(ConfigurationError):
        select(LISTED, split)
