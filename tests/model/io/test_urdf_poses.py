"""Other readers move the links of a URDF that we wrote as ``pose`` does."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
import pytest
import yourdfpy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from model.core.articulated_object import ArticulatedObject, Inertial, Part
from model.core.geometry import Mesh
from model.core.joint import JOINT_TYPES, Joint, Mimic
from model.core.tree import KinematicTree
from model.io.urdf.writer import link_origins, read_urdf_model, to_urdf_text

TETRAHEDRON = Mesh(
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]) * 0.1,
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)
UNIT = Inertial(1.0, np.array([0.1, 0.2, 0.3]), np.diag([1.0, 1.0, 1.0]))
number = st.floats(-2.0, 2.0).map(lambda v: round(v, 9))
vector = st.tuples(number, number, number)


@st.composite
def objects(draw: st.DrawFn) -> ArticulatedObject:
    """Random trees: chains and bushes, every type, limits, mimics of mimics, odd names."""
    count = draw(st.integers(1, 7))
    odd = st.sampled_from(["base", 'wheel "left" & <right>', "Tür", "a b", "x'y", "90°"])
    links = [draw(odd)] + [f"link_{i}" for i in range(1, count)]
    joints: list[Joint] = []
    for i in range(1, count):
        chain = draw(st.booleans())
        parent = links[i - 1] if chain else links[draw(st.integers(0, i - 1))]
        type_ = draw(st.sampled_from(JOINT_TYPES))
        axis = draw(vector.filter(lambda v: np.linalg.norm(v) > 0.1))
        lower, upper = sorted(draw(st.tuples(number, number)))
        moving = [j.name for j in joints if j.moves]
        mimic = None
        if type_ != "fixed" and moving and draw(st.integers(0, 3)) == 0:
            mimic = Mimic(draw(st.sampled_from(moving)), draw(number), draw(number))
        origin = draw(vector)
        joints.append(
            Joint(f"j{i} <&>", type_, parent, links[i], axis, origin, lower, upper, mimic)
        )
    order = draw(st.permutations(joints))
    parts = tuple(Part(link, TETRAHEDRON, name="door") for link in links[1:])
    return ArticulatedObject("a & b", parts, KinematicTree(tuple(links), tuple(order)))


def expected(obj: ArticulatedObject, q: dict[str, float]) -> dict[str, np.ndarray]:
    """``object_from_link`` by the definition in ``urdf``."""
    out = {}
    for link, posed_from_rest in obj.pose(q).items():
        rest = np.eye(4)
        rest[:3, 3] = link_origins(obj.tree)[link]
        out[link] = posed_from_rest @ rest
    return out


def random_q(obj: ArticulatedObject, rng: np.random.Generator) -> dict[str, float]:
    free = [j for j in obj.tree.joints if j.moves and j.mimic is None]
    return {j.name: float(rng.uniform(-3, 3)) for j in free}


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(obj=objects(), seed=st.integers(0, 2**16))
def test_yourdfpy_and_mujoco_agree_with_pose(tmp_path_factory, obj, seed):
    logging.getLogger("yourdfpy.urdf").setLevel(logging.ERROR)
    path = tmp_path_factory.mktemp("urdf") / "object.urdf"
    inertials = dict.fromkeys(obj.tree.links, UNIT)
    path.write_text(to_urdf_text(obj, inertials=inertials, mujoco_visuals=False))
    robot = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    assert robot.validate()
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    for _ in range(3):
        q = random_q(obj, rng)
        poses = expected(obj, q)
        robot.update_cfg(q)
        for name, value in obj.tree.joint_values(q).items():
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        for link, object_from_link in poses.items():
            seen = robot.get_transform(link, obj.tree.root)
            np.testing.assert_allclose(seen, object_from_link, atol=1e-6)
            body = data.body(link)
            np.testing.assert_allclose(body.xpos, object_from_link[:3, 3], atol=1e-6)
            np.testing.assert_allclose(body.xmat.reshape(3, 3), object_from_link[:3, :3], atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(obj=objects())
def test_reading_back_gives_the_same_tree(tmp_path_factory, obj):
    path = tmp_path_factory.mktemp("urdf") / "object.urdf"
    files = {p.link: [f"meshes/{p.link}.obj"] for p in obj.parts}
    path.write_text(to_urdf_text(obj, files))
    model = read_urdf_model(path)
    assert model.notes == ()
    assert model.name == obj.name
    assert model.tree.links == obj.tree.order
    assert {v.link: v.name for v in model.visuals} == {p.link: "door" for p in obj.parts}
    for visual in model.visuals:
        np.testing.assert_allclose(visual.object_from_geometry, np.eye(4), atol=1e-12)
    for joint in model.tree.joints:
        before = obj.tree.by_name[joint.name]
        assert (joint.type, joint.parent, joint.child) == (before.type, before.parent, before.child)
        assert (joint.lower, joint.upper) == (before.lower, before.upper)
        np.testing.assert_allclose(joint.origin, before.origin, atol=1e-12)
        if joint.moves:
            np.testing.assert_allclose(joint.axis, before.axis, atol=1e-12)
    q = random_q(obj, np.random.default_rng(0))
    after = model.tree.pose(q)
    for link, pose in obj.pose(q).items():
        np.testing.assert_allclose(after[link], pose, atol=1e-9)


def test_links_come_before_the_joints_that_use_them():
    tree = KinematicTree(("b", "a"), (Joint("j", "revolute", "a", "b", lower=0, upper=1),))
    text = to_urdf_text(ArticulatedObject("x", (), tree))
    places = [text.index(s) for s in ('<link name="a"', '<link name="b"', '<joint name="j"')]
    assert places == sorted(places)
    assert "inertial" not in text and "collision" not in text and "mujoco" not in text


def test_a_continuous_joint_has_no_range():
    tree = KinematicTree(("a", "b"), (Joint("j", "continuous", "a", "b"),))
    text = to_urdf_text(ArticulatedObject("x", (), tree))
    assert "lower" not in text and "upper" not in text and "effort" in text


@pytest.mark.parametrize("name", ["a\x00b", "a\x1bb"])
def test_a_name_that_xml_cannot_hold(name):
    from model.core.errors import ArtiworldError

    with pytest.raises(ArtiworldError, match="XML"):
        to_urdf_text(ArticulatedObject(name, (), KinematicTree(("a",))))
