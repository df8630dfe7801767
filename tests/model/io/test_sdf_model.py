"""SDF files of one model are opened as articulated objects."""

import math
from pathlib import Path

import numpy as np
import pytest

from model.core.composite_joints import Composite, composite_of
from model.core.errors import InputFileError
from model.io.export.registry import load_exporter, write_object
from model.io.model_files import files_named_by, find_assets, is_model, read_model
from model.io.open_asset import open_asset
from model.physics.simulation_values import plain_physics
from tests.model.io.test_exporters import make_object


def test_an_export_is_found_and_names_its_files(tmp_path) -> None:
    obj = make_object()
    path = write_object(obj, load_exporter("sdf"), tmp_path / "a", physics=plain_physics(obj))[0]
    assert find_assets([tmp_path]) == [tmp_path / "a"]
    assert open_asset(tmp_path / "a").tree is not None
    assert all(p.is_file() for p in files_named_by(path)) and len(files_named_by(path)) > 4


BOX = "<visual name='v'><geometry><box><size>{}</size></box></geometry></visual>"


def written(path: Path, body: str, version: str = "1.9") -> Path:
    path.write_text(f"<sdf version='{version}'><model name='m'>{body}</model></sdf>")
    return path


def test_poses_are_relative_to_what_they_say(tmp_path) -> None:
    body = f"""
        <frame name='shelf' attached_to='body'><pose>0 0 1 0 0 0</pose></frame>
        <link name='body'><pose degrees='true'>0 0 0.5 0 0 90</pose>{BOX.format("1 2 1")}</link>
        <link name='door'><pose relative_to='shelf' rotation_format='quat_xyzw'>
          1 0 0 0 0 0 1</pose>{BOX.format("0.1 2 1")}</link>
        <link name='knob'><pose relative_to='hinge'>0 0.2 0 0 0 0</pose>
          {BOX.format(".1 .1 .1")}</link>
        <joint name='to_world' type='fixed'><parent>world</parent><child>body</child></joint>
        <joint name='hinge' type='revolute'><pose>0 1 0 0 0 0</pose>
          <parent>body</parent><child>door</child>
          <axis><xyz expressed_in='__model__'>1 0 0</xyz>
            <limit><lower>-0.5</lower><upper>1.5</upper><effort>-1</effort></limit>
            <dynamics><damping>0.3</damping></dynamics></axis></joint>
        <joint name='turn' type='revolute'><parent>door</parent><child>knob</child>
          <axis><xyz>0 1 0</xyz><mimic joint='hinge'><multiplier>2</multiplier>
            <offset>1</offset><reference>0.25</reference></mimic></axis></joint>
    """
    model = read_model(written(tmp_path / "a.sdf", body))
    assert model.notes == () and model.tree.root == "body"
    hinge, turn = model.tree.by_name["hinge"], model.tree.by_name["turn"]
    # The body is turned by 90°: its x is the model's y.
    np.testing.assert_allclose(hinge.origin, (-1, 1, 1.5), atol=1e-9)
    np.testing.assert_allclose(hinge.axis, (1, 0, 0), atol=1e-9)
    assert (hinge.lower, hinge.upper) == (-0.5, 1.5)
    dynamics = model.declared.dynamics["hinge"]
    assert dynamics.damping == 0.3 and dynamics.effort is None
    np.testing.assert_allclose(turn.axis, (-1, 0, 0), atol=1e-9)
    assert turn.type == "continuous" and turn.mimic is not None
    assert (turn.mimic.multiplier, turn.mimic.offset) == (2.0, 0.5)
    bounds = {p.link: p.bounds.mean(axis=0) for p in model.load().parts}
    np.testing.assert_allclose(bounds["body"], (0, 0, 0.5), atol=1e-9)
    np.testing.assert_allclose(bounds["door"], (0, 1, 1.5), atol=1e-9)
    np.testing.assert_allclose(bounds["knob"], (-1.2, 1, 1.5), atol=1e-9)


def test_axes_of_old_versions_are_the_models(tmp_path) -> None:
    body = (
        f"<link name='a'>{BOX.format('1 1 1')}</link>"
        f"<link name='b'><pose>0 0 0 0 0 1.5707963267948966</pose>{BOX.format('1 1 1')}</link>"
        "<joint name='j' type='prismatic'><parent>a</parent><child>b</child>"
        "<axis><xyz>1 0 0</xyz><limit><lower>0</lower><upper>1</upper></limit></axis></joint>"
    )
    for version, axis in (("1.4", (1, 0, 0)), ("1.6", (0, 1, 0)), ("1.12", (0, 1, 0))):
        model = read_model(written(tmp_path / "a.sdf", body, version))
        np.testing.assert_allclose(model.tree.by_name["j"].axis, axis, atol=1e-9)


def test_what_is_not_read_is_told(tmp_path) -> None:
    body = f"""
        <link name='a'>{BOX.format("1 1 1")}<glow>1</glow></link>
        <link name='b'>{BOX.format("1 1 1")}
          <visual name='p'><geometry><plane/></geometry></visual></link>
        <link name='c'>{BOX.format("1 1 1")}</link>
        <joint name='odd' type='gearbox'><parent>a</parent><child>b</child></joint>
        <joint name='free' type='prismatic'><parent>a</parent><child>c</child>
          <axis><xyz>1 0 0</xyz></axis></joint>
        <model name='inner'/>
    """
    notes = " | ".join(read_model(written(tmp_path / "a.sdf", body)).notes)
    for words in (
        "joint 'odd': gearbox joints are not supported",
        "a visual of <plane> is not read",
        "has no limits: it slides from 0 to 0 m",
    ):
        assert words in notes
    assert "<glow> in <link> (1)" in notes


JOINT = "<joint name='j' type='revolute'><parent>b</parent><child>a</child>{}</joint>"


@pytest.mark.parametrize(
    ("a", "b", "axis", "says"),
    [
        (" relative_to='b'>1 0 0 0 0 0", " relative_to='a'>1 0 0 0 0 0", "", "hang on each other"),
        (" relative_to='x'>0 0 0 0 0 0", ">", "", "'x', which is no frame"),
        (">0 0 nan 0 0 0", ">", "", "needs 6 finite numbers"),
        (">", ">", "<axis><xyz>1 x 0</xyz></axis>", "axis is '1 x 0'; numbers are needed"),
    ],
)
def test_what_cannot_be_resolved_is_refused(tmp_path, a, b, axis, says) -> None:
    poses = (f"<pose{said}</pose>" * (said != ">") for said in (a, b))
    links = "<link name='a'>{}</link><link name='b'>{}</link>".format(*poses)
    path = written(tmp_path / "a.sdf", links + JOINT.format(axis))
    assert is_model(path)
    with pytest.raises(InputFileError, match=says):
        read_model(path)


MOVING = """<joint name='j' type='{}'><parent>a</parent><child>b</child>{}</joint>"""
AXIS = "<axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>3</upper></limit></axis>"
OTHER_AXIS = AXIS.replace("axis", "axis2").replace("0 1 0", "1 0 0")


@pytest.mark.parametrize(
    ("kind", "said", "motion"),
    [
        ("screw", f"{AXIS}<screw_thread_pitch>0.02</screw_thread_pitch>", Composite("screw", 0.02)),
        ("screw", f"{AXIS}<thread_pitch>-100</thread_pitch>", Composite("screw", math.pi / 50)),
        ("ball", "", Composite("ball")),
        ("universal", AXIS + OTHER_AXIS, Composite("universal")),
    ],
)
def test_joints_of_several_motions_become_chains(tmp_path, kind, said, motion) -> None:
    links = "".join(f"<link name='{n}'>{BOX.format('1 1 1')}</link>" for n in "ab")
    model = read_model(written(tmp_path / "a.sdf", links + MOVING.format(kind, said)))
    assert not any("became fixed" in note for note in model.notes)
    found = composite_of(model.tree, "b", lambda link: link in "ab")
    assert (found.kind, found.pitch) == (motion.kind, pytest.approx(motion.pitch))
    own = model.tree.by_name["j"]
    if kind == "screw":
        assert (own.axis, own.lower, own.upper) == ((0, 1, 0), -1, 3)
        turn = model.tree.pose({"j": math.pi})["b"]
        np.testing.assert_allclose(turn[:3, 3], (0, motion.pitch / 2, 0), atol=1e-9)
    if kind == "universal":
        assert [j.axis for j in model.tree.joints] == [(0, 1, 0), (1, 0, 0)]


def test_a_screw_without_an_axis_is_refused_by_name(tmp_path) -> None:
    links = "".join(f"<link name='{n}'>{BOX.format('1 1 1')}</link>" for n in "ab")
    axis = AXIS.replace("0 1 0", "0 0 0") + "<screw_thread_pitch>1</screw_thread_pitch>"
    path = written(tmp_path / "a.sdf", links + MOVING.format("screw", axis))
    with pytest.raises(InputFileError, match=r"a\.sdf: joint 'j': axis must not be zero"):
        read_model(path)


def test_worlds_are_scenes(tmp_path) -> None:
    path = tmp_path / "w.sdf"
    path.write_text("<sdf version='1.9'><world name='w'><model name='m'/></world></sdf>")
    assert not is_model(path)
    with pytest.raises(InputFileError, match="holds a world"):
        open_asset(path)
