"""Part names in files: the rule, and that all formats and re-opening follow it."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from pxr import Usd

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import Mesh
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree
from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import load_object, read_provenance, reload_check
from model.io.export.registry import EXPORTERS, export
from model.io.file_names import FileNames
from model.io.open_asset import open_asset

AXIS = (0.0, 0.0, 1.0)


def box(link: str, name: str | None, shift: float = 0.0) -> Part:
    mesh = trimesh.creation.box((0.2, 0.2, 0.2)).apply_translation([shift, 0, 0])
    return Part(link, Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)), name=name)


def two_parts(name: str | None, number: int = 1) -> ArticulatedObject:
    link = f"link_{number}"
    hinge = Joint(f"joint_{link}", "revolute", "link_0", link, AXIS, lower=0, upper=1)
    parts = (box("link_0", None), box(link, name, 0.3))
    return ArticulatedObject("o", parts, KinematicTree(("link_0", link), (hinge,)))


def chair() -> ArticulatedObject:
    """A seat that turns and rises (a helper between), a knob, two doors, one without a name."""
    door = Joint("joint_link_3", "revolute", "link_0", "link_3", AXIS, lower=0, upper=1)
    joints = (
        Joint("joint_helper_1", "prismatic", "link_0", "helper_1", AXIS, lower=0, upper=0.1),
        Joint("joint_link_1", "continuous", "helper_1", "link_1", AXIS),
        Joint("joint_link_2", "revolute", "link_1", "link_2", AXIS, lower=0, upper=1),
        replace(door, mimic=Mimic("joint_link_2")),
        replace(door, name="shoulder_pan", child="link_4"),
        Joint("joint_link_7", "prismatic", "link_0", "link_7", AXIS, lower=0, upper=0.1),
    )
    links = ("link_0", "helper_1", "link_1", "link_2", "link_3", "link_4", "link_7")
    names = {1: "Seat", 2: "knob", 3: "door", 4: "door", 7: None}
    parts = [box("link_0", None), *(box(f"link_{i}", n, 0.3 * i) for i, n in names.items())]
    return ArticulatedObject("chair", tuple(parts), KinematicTree(links, joints))


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("door", "door_2"),
        ("Drawer  Door", "drawer_door_2"),
        ("Tür", "tur_2"),
        ("Straße/../etc", "strasse_etc_2"),
        ("door 2", "door_2"),
        ("door 3", "door_3_2"),
        ("2nd shelf", "part_2nd_shelf_2"),
        ("base", "base_2"),
        ("link", "link_2"),
        ("門", "link_2"),
        ("<&>", "link_2"),
        (None, "link_2"),
        ("x" * 300, f"{'x' * 60}_2"),
    ],
)
def test_a_part_is_called_as_on_the_screen(name: str | None, written: str) -> None:
    names = FileNames.of(two_parts(name, 2))
    assert names.links == {"link_0": "base", "link_2": written}
    assert names.joints == {"joint_link_2": f"{written}_hinge"}


def test_joints_and_helpers_are_called_after_the_part_that_they_move() -> None:
    names = FileNames.of(chair())
    links = "base helper_seat_1 seat_1 knob_2 door_3 door_4 link_7"
    assert names.links == dict(zip(chair().tree.links, links.split(), strict=True))
    joints = "seat_1_lift seat_1_swivel knob_2_turn door_3_hinge link_7_slide"
    old = [f"joint_{k}" for k in ("helper_1", "link_1", "link_2", "link_3", "link_7")]
    assert names.joints == dict(zip(old, joints.split(), strict=True))
    named = names.object(chair())
    assert named.tree.by_name["door_3_hinge"].mimic == Mimic("knob_2_turn")
    assert "shoulder_pan" in named.tree.by_name, "a file's own joint keeps its name"


@given(st.lists(st.one_of(st.none(), st.text(max_size=12)), min_size=1, max_size=6))
def test_any_names_give_different_identifiers(names: list[str | None]) -> None:
    links = [f"link_{i}" for i in range(len(names) + 1)]
    joints = tuple(
        Joint(f"joint_{k}", "revolute", "link_0", k, AXIS, lower=0, upper=1) for k in links[1:]
    )
    parts = tuple(box(k, n) for k, n in zip(links, ["base", *names], strict=True))
    obj = ArticulatedObject("o", parts, KinematicTree(tuple(links), joints))
    found = FileNames.of(obj)
    written = [*found.links.values(), *found.joints.values()]
    assert len({w.lower() for w in written}) == len(written) == 2 * len(names) + 1
    assert all(re.fullmatch(r"[a-z_][a-z0-9_]*", w) for w in written)
    again = FileNames.of(found.object(obj))
    assert all(new == old for new, old in again.links.items())
    assert all(new == old for new, old in again.joints.items())


@pytest.fixture(scope="module")
def asset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_asset(chair(), tmp_path_factory.mktemp("a") / "chair", provenance={}).folder


def names_in(format: str, files: tuple[Path, ...]) -> str:
    """All text of an export in which a link may be called."""
    if format == "usd":
        stage = Usd.Stage.Open(str(files[0]))
        return "\n".join(str(prim.GetPath()) for prim in stage.Traverse())
    if format == "glb":
        return files[0].read_bytes()[20:].decode("utf-8", "ignore")
    return "\n".join(f.read_text() for f in files if f.suffix in (".urdf", ".xml", ".sdf"))


@pytest.mark.parametrize("format", EXPORTERS.built_in)
def test_every_format_calls_them_so(asset: Path, tmp_path: Path, format: str) -> None:
    text = names_in(format, export(asset, format, tmp_path))
    for name in ("base", "seat_1", "helper_seat_1", "knob_2_turn", "door_3", "door_4"):
        assert re.search(rf"\b{name}\b", text), name
    assert not re.search(r"\b(joint_link_|link_[0-4]\b|helper_\d)", text)


def test_the_saved_asset_leads_back_to_the_session(asset: Path) -> None:
    assert reload_check(asset) == []
    tree = (asset / "tree.json").read_text()
    assert "door_3_hinge" in tree and "link_3" not in tree
    assert (asset / "meshes" / "door_4.obj").is_file()
    kept = read_provenance(asset)["asset"]["names"]
    assert kept["links"]["door_3"] == "link_3"
    assert kept["joints"]["seat_1_swivel"] == "joint_link_1"
    assert FileNames.stored({"names": kept}).tree(chair().tree) == load_object(asset).tree
    assert FileNames.stored({}).tree(chair().tree) == chair().tree, "of an earlier version"


@pytest.mark.parametrize("format", ["saved", "urdf", "mjcf"])
def test_a_file_of_ours_opens_with_the_numbers_and_names_of_before(
    asset: Path, tmp_path: Path, format: str
) -> None:
    path = asset
    if format != "saved":
        path = export(asset, format, tmp_path)[0]
        (tmp_path / "artiworld.json").write_text(json.dumps({"format": format}))
    opened = open_asset(path)
    assert opened.tree is not None
    assert opened.element_part is not None
    assert {1, 2, 3, 4, 7} <= set(np.unique(opened.element_part).tolist())
    names = [name.lower() for name in opened.part_names]
    assert names[1:5] == ["seat", "knob", "door", "door"] and not names[7]
    assert opened.tree.joint_of["link_3"].name == "door_3_hinge"
    # Saved again under another name: the part's new name, and the joint's.
    parts = [
        box(f"link_{i}", "lid" if i == 3 else name or None, 0.3 * i)
        for i, name in enumerate(opened.part_names)
        if i in (0, 1, 2, 3, 4, 7)
    ]
    again = FileNames.of(ArticulatedObject("chair", tuple(parts), opened.tree))
    assert again.links["link_3"] == "lid_3" and again.joints["door_3_hinge"] == "lid_3_hinge"
    assert again.links["link_1"] == "seat_1"


def test_names_that_are_taken_get_a_number() -> None:
    obj = two_parts("door", 1)
    tree = KinematicTree(
        (*obj.tree.links, "door_1"),
        (*obj.tree.joints, Joint("door_1_hinge", "fixed", "link_0", "door_1")),
    )
    clash = replace(obj, parts=(*obj.parts, box("door_1", None)), tree=tree)
    names = FileNames.of(clash)
    assert names.links["link_1"] == "door_1_2"
    assert len({*names.object(clash).tree.links}) == 3
