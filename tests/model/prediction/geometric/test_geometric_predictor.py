"""The predictor's contract: odd input, locked joints, order, scale, cancellation."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from model.core.articulated_object import ArticulatedObject, Part, SegmentedObject
from model.core.geometry import Mesh, PointCloud
from model.core.joint import Joint
from model.core.progress import Cancelled
from model.core.tree import KinematicTree
from model.data.procedural.generate import make
from model.data.registry import GroundTruth
from model.evaluation.joint_metrics import axis_angle
from model.evaluation.run import Corruption, corrupt
from model.prediction.geometric.mechanisms import BUILDERS
from model.prediction.geometric.predictor import GeometricPredictor
from model.prediction.registry import Predictor, load_predictor
from tests.builders import box, part
from tests.model.prediction.geometric.archetypes import THINGS, cabinet
from tests.model.validation.cabinets import cabinet as wooden_cabinet

PREDICTOR = GeometricPredictor()


def cube(link: str, center=(0.0, 0.0, 0.0), size=1.0, name: str | None = None) -> Part:
    m = trimesh.creation.box(extents=np.full(3, size) if np.isscalar(size) else size)
    vertices = np.asarray(m.vertices) + center
    return Part(link, Mesh(vertices, np.asarray(m.faces, np.int32)), name=name)


def cloud(link: str, points) -> Part:
    return Part(link, cloud=PointCloud(np.asarray(points, np.float32)))


def check(obj: SegmentedObject) -> ArticulatedObject:
    prediction = PREDICTOR.predict(obj)
    assert prediction.tree is not None, prediction.problems
    assert {p.link for p in obj.parts} <= set(prediction.tree.links)
    for link in {p.link for p in obj.parts} - {prediction.tree.root}:
        assert 0.0 <= prediction.confidence[link] <= 1.0
        assert prediction.notes[link]
    return ArticulatedObject(obj.name, obj.parts, prediction.tree, obj.category)


def test_is_a_predictor() -> None:
    assert isinstance(PREDICTOR, Predictor)
    assert PREDICTOR.name == "geometric"


ODD = {
    "one part": [cube("link_0")],
    "two of the same place": [cube("link_0"), cube("link_1")],
    "three points": [cube("link_0"), cloud("link_1", [(0, 0, 1), (0.1, 0, 1), (0, 0.1, 1)])],
    "one point": [cube("link_0"), cloud("link_1", [(0, 0, 1)])],
    "all one point": [cloud("link_0", [(1, 1, 1)]), cloud("link_1", [(1, 1, 1)])],
    "far apart": [cube("link_0"), cube("link_1", (50, 0, 0)), cube("link_2", (0, 80, 0))],
    "a line": [cube("link_0"), cloud("link_1", np.outer(np.arange(30), (0.1, 0.0, 0.0)))],
    "a plane": [
        cube("link_0"),
        cloud("link_1", np.random.default_rng(0).random((99, 3)) * (1, 1, 0)),
    ],
    "no area": [
        cube("link_0"),
        Part("link_1", Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))),
    ],
    "tiny and huge": [cube("link_0", size=1e-6), cube("link_1", size=1e4)],
    "odd names": [cube("link_0", name="???"), cube("thing", (0, 0, 1), name="Üñï 7")],
}  # fmt: skip


@pytest.mark.parametrize("case", ODD)
def test_odd_input_gets_a_prediction(case: str) -> None:
    check(SegmentedObject(case, tuple(ODD[case])))


def test_a_part_without_contact_is_reported() -> None:
    prediction = PREDICTOR.predict(SegmentedObject("apart", tuple(ODD["far apart"])))
    assert any("isn't in contact" in p for p in prediction.problems)


def test_a_mechanism_without_any_joint_leaves_the_part_fixed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cup = cube("link_1", (0, 0, 0.6), (0.2, 0.2, 0.2), "door")
    monkeypatch.setitem(BUILDERS, "hinge", lambda context: [])
    made = check(SegmentedObject("odd", (cube("link_0"), cup)))
    assert made.tree.joint_of["link_1"].type == "fixed"


def test_two_hundred_parts_in_bounded_time() -> None:
    rng = np.random.default_rng(0)
    parts = [cube("link_base", size=(4, 4, 1))]
    parts += [
        cube(f"link_{i}", (*rng.uniform(-1.9, 1.9, 2), 0.52), size=(0.1, 0.1, 0.05))
        for i in range(199)
    ]
    start = time.process_time()
    obj = check(SegmentedObject("many", tuple(parts)))
    assert time.process_time() - start < 30
    assert obj.tree.root == "link_base"


def test_the_order_of_the_parts_has_no_effect() -> None:
    answers = []
    for seed in (None, 1, 2):
        order = None if seed is None else np.random.default_rng(seed)
        tree = PREDICTOR.predict(cabinet().segmented(order=order)).tree
        assert tree is not None
        answers.append({j.child: (j.type, j.parent, j.axis, j.origin) for j in tree.joints})
    assert answers[0] == answers[1] == answers[2]


def test_the_same_twice() -> None:
    a, b = (PREDICTOR.predict(cabinet().segmented(names=False)) for _ in range(2))
    assert a.tree == b.tree and a.confidence == b.confidence and a.notes == b.notes


@pytest.mark.parametrize("scale", [0.001, 100.0])
def test_scale_and_position_have_no_effect(scale: float) -> None:
    obj = cabinet().segmented()
    shift = np.array([3.0, -2.0, 1.0]) * scale
    parts = tuple(
        Part(p.link, Mesh(p.mesh.vertices * scale + shift, p.mesh.faces), name=p.name)
        for p in obj.parts
        if p.mesh is not None
    )
    here = PREDICTOR.predict(obj).tree
    there = PREDICTOR.predict(SegmentedObject("moved", parts, obj.category)).tree
    assert here is not None and there is not None
    for a in here.joints:
        b = there.joint_of[a.child]
        assert (a.type, a.parent) == (b.type, b.parent)
        assert np.allclose(a.axis, b.axis, atol=1e-6)
        assert np.allclose(np.asarray(a.origin) * scale + shift, b.origin, atol=1e-6 * scale)
        if a.type == "prismatic":
            assert a.upper is not None and np.isclose(a.upper * scale, b.upper)


def test_locked_joints_come_out_unchanged() -> None:
    locked = Joint(
        "mine", "prismatic", "link_drawer", "link_left", (0, 1, 0), (0.1, 0.2, 0.3), -0.1, 0.4
    )
    prediction = PREDICTOR.predict(cabinet().segmented(), locked=(locked,))
    assert prediction.tree is not None
    assert prediction.tree.joint_of["link_left"] == locked
    assert prediction.confidence["link_left"] == 1.0
    assert prediction.tree.joint_of["link_drawer"].type == "prismatic"


def test_a_locked_joint_may_turn_the_tree_over() -> None:
    """A locked joint makes the base a child of the door, so that another part is the root."""
    locked = Joint("mine", "revolute", "link_left", "link_base", (0, 0, 1), (0, 0, 0), 0.0, 1.0)
    prediction = PREDICTOR.predict(cabinet().segmented(), locked=(locked,))
    assert prediction.tree is not None
    assert prediction.tree.joint_of["link_base"] == locked
    assert prediction.tree.root != "link_base"


def test_a_locked_screw_keeps_its_helper() -> None:
    """Both joints of a compound motion are locked; the helper link stays."""
    slide = Joint("up", "prismatic", "link_base", "helper_lid", (0, 0, 1), (0, 0, 0), 0.0, 0.1)
    spin = Joint("turn", "continuous", "helper_lid", "link_lid", (0, 0, 1), (0, 0, 0))
    prediction = PREDICTOR.predict(THINGS["kettle"]().segmented(), locked=(slide, spin))
    assert prediction.tree is not None, prediction.problems
    assert prediction.tree.joint_of["link_lid"] == spin
    assert prediction.tree.joint_of["helper_lid"] == slide


def board(link: str, low, high, name: str | None = None) -> Part:
    return part(link, box(low, high), name=name)


def two_doors(gap: float, name: str | None = "door", seam: float = 0.0) -> SegmentedObject:
    """Two leaves side by side, ``gap`` before a body of 1 x 0.4 x 0.8 m."""
    front = -gap - 0.02
    parts = (
        board("link_0", (-0.5, 0, 0), (0.5, 0.4, 0.8), "body"),
        board("link_1", (-0.5, front, 0), (seam - 0.002, -gap, 0.8), name),
        board("link_2", (seam + 0.002, front, 0), (0.5, -gap, 0.8), name),
    )
    return SegmentedObject("two doors", parts)


@pytest.mark.parametrize("predictor", ["geometric", "hybrid"])
@pytest.mark.parametrize("gap", [0.003, 0.04, 0.08])
def test_shut_doors_side_by_side_hang_on_the_body_and_start_at_zero(
    gap: float, predictor: str
) -> None:
    for obj in (two_doors(gap), two_doors(gap, None), two_doors(gap, seam=-0.15)):
        tree = load_predictor(predictor).predict(obj).tree
        assert tree is not None
        for link, side in (("link_1", -0.5), ("link_2", 0.5)):
            joint = tree.joint_of[link]
            assert (joint.parent, joint.type, joint.lower) == ("link_0", "revolute", 0.0)
            assert abs(joint.axis[2]) > 0.99
            assert joint.origin[0] == pytest.approx(side, abs=0.02)


@pytest.mark.parametrize("hung", ["door", "body"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_door_turns_about_its_barrels(side: float, hung: str) -> None:
    """The barrels in front of one edge are the only cue."""
    place = np.array((side * 0.295, -0.026, 0.0))
    knuckles = [
        trimesh.creation.cylinder(0.006, 0.06, sections=16).apply_translation(place + (0, 0, z))
        for z in (0.12, 0.68)
    ]
    panels = {
        "body": box((-0.3, 0, 0), (0.3, 0.4, 0.8)),
        "door": box((-0.298, -0.02, 0.002), (0.298, -0.001, 0.798)),
    }
    parts = tuple(
        part(f"link_{k}", panel, *(knuckles if name == hung else ()), name=name)
        for k, (name, panel) in enumerate(panels.items())
    )
    tree = PREDICTOR.predict(SegmentedObject("door", parts)).tree
    assert tree is not None
    joint = tree.joint_of["link_1"]
    assert abs(joint.axis[2]) > 0.999
    np.testing.assert_allclose(joint.origin[:2], place[:2], atol=0.001)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("turned", ["upright", "level"])
def test_a_door_ajar_turns_about_its_nearer_edge(side: float, turned: str) -> None:
    """An angle of four degrees is the only cue."""
    half = np.array((0.298, 0.01, 0.298))
    axis = np.array((0, 0, 1.0) if turned == "upright" else (1.0, 0, 0))
    hinge = np.array(
        (side * half[0], -0.001, 0.3) if axis[2] else (0, -0.001, 0.3 + side * half[2])
    )
    sense = side if axis[2] else -side
    panel = trimesh.creation.box(2 * half).apply_translation((0, -0.011, 0.3))
    panel.apply_transform(
        trimesh.transformations.rotation_matrix(sense * np.deg2rad(4), axis, hinge)
    )
    # Open to its front, as a cupboard is.
    body = trimesh.util.concatenate(
        [
            trimesh.creation.box((0.6, 0.02, 0.6)).apply_translation((0, 0.4, 0.3)),
            *(
                trimesh.creation.box((0.02, 0.4, 0.6)).apply_translation((x, 0.2, 0.3))
                for x in (-0.29, 0.29)
            ),
            *(
                trimesh.creation.box((0.56, 0.4, 0.02)).apply_translation((0, 0.2, z))
                for z in (0.01, 0.59)
            ),
        ]
    )
    parts = tuple(
        Part(link, Mesh(np.asarray(m.vertices), np.asarray(m.faces, np.int32)), name=name)
        for link, m, name in (("link_0", body, "body"), ("link_1", panel, "door"))
    )
    tree = PREDICTOR.predict(SegmentedObject("cupboard", parts)).tree
    assert tree is not None
    joint = tree.joint_of["link_1"]
    assert abs(joint.axis @ axis) > 0.999
    off = np.subtract(joint.origin, hinge)
    assert np.linalg.norm(off - axis * (off @ axis)) < 0.03


def test_the_far_leaf_of_a_folding_door_hangs_on_the_near_one() -> None:
    parts = (
        board("link_0", (-0.1, -0.1, 0), (0, 0.1, 2.2), "frame"),
        board("link_1", (0.002, -0.015, 0.05), (0.5, 0.015, 2.1), "door"),
        board("link_2", (0.504, -0.015, 0.05), (1.0, 0.015, 2.1), "door"),
    )
    tree = PREDICTOR.predict(SegmentedObject("folding", parts)).tree
    assert tree is not None
    assert tree.joint_of["link_1"].parent == "link_0"
    assert tree.joint_of["link_2"].parent == "link_1"


def test_a_door_that_was_scanned_open_shuts_too() -> None:
    body = board("link_0", (-0.5, 0, 0), (0.5, 0.4, 0.8), "body")
    open_door = board("link_1", (0.48, -0.96, 0), (0.5, -0.004, 0.8), "door")
    joint = PREDICTOR.predict(SegmentedObject("open", (body, open_door))).tree.joint_of["link_1"]
    assert joint.type == "revolute"
    assert min(joint.lower, -joint.upper) < -1.0


def test_progress_and_cancel() -> None:
    seen: list[float] = []
    PREDICTOR.predict(cabinet().segmented(), progress=lambda f, m: seen.append(f))
    assert seen == sorted(seen) and seen[-1] == 1.0 and len(seen) >= 4

    def stop(fraction: float, message: str) -> None:
        if fraction > 0.3:
            raise Cancelled

    with pytest.raises(Cancelled):
        PREDICTOR.predict(cabinet().segmented(), progress=stop)


@pytest.mark.parametrize("name", ["cabinet", "oven", "washer", "microwave", "pedal_bin"])
def test_one_sided_noisy_scans(name: str) -> None:
    """As seen from the front and above, with noise: types and axes stay right."""
    thing = THINGS[name]()
    obj = thing.segmented()
    links = tuple(p.link for p in obj.parts)
    joints = tuple(Joint(k, "fixed", "link_base", k) for k in links if k != "link_base")
    truth = ArticulatedObject(name, obj.parts, KinematicTree(links, joints), obj.category)
    rng = np.random.default_rng(3)
    seen = corrupt(GroundTruth(name, truth), Corruption(scan=True, noise=0.002), rng)
    prediction = PREDICTOR.predict(seen.segmented())
    assert prediction.tree is not None
    for key, true in thing.truth.items():
        joint = prediction.tree.joint_of[f"link_{key}"]
        assert joint.type == true.type, key
        assert axis_angle(joint.axis, true.axis) < 0.2, key


@pytest.mark.parametrize("seed", [0, 16])
def test_a_backrest_leans_back_a_little(seed: int) -> None:
    """It grazes the seat by less than the sweep's tolerance, which would allow 156°."""
    truth = make("Chair", seed)
    (rest,) = [p.link for p in truth.object.parts if p.name == "backrest"]
    segmented = SegmentedObject("chair", truth.object.parts, truth.object.category)
    joint = PREDICTOR.predict(segmented).joint(rest)
    expected = truth.object.tree.joint_of[rest]
    assert joint is not None and joint.type == expected.type == "revolute"
    assert np.dot(joint.axis, expected.axis) > 0.99, "back, not onto the seat"
    assert joint.lower == 0.0 and joint.upper == pytest.approx(expected.upper, abs=0.2)


def test_a_lever_under_a_seat_turns_normal_to_itself() -> None:
    """The centre of the seat is no cue for the axis of its lever."""
    seat = trimesh.util.concatenate(
        [
            trimesh.creation.box(bounds=[[-0.3, -0.23, 0.419], [0.3, 0.23, 0.48]]),
            trimesh.creation.box(bounds=[[-0.3, -0.2, 0.48], [-0.25, 0.2, 0.67]]),
            trimesh.creation.box(bounds=[[0.25, -0.2, 0.48], [0.3, 0.2, 0.67]]),
        ]
    )
    lever = trimesh.creation.box(bounds=[[0.09, -0.096, 0.408], [0.22, -0.084, 0.419]])
    parts = tuple(
        Part(f"link_{i}", Mesh(m.vertices, m.faces.astype(np.int32)), name=name)
        for i, (m, name) in enumerate(((seat, "seat"), (lever, "lever")))
    )
    found = GeometricPredictor().predict(SegmentedObject("chair", parts, "Chair")).joint("link_1")
    assert found is not None and found.rotates
    assert abs(found.axis[1]) > 0.99


@pytest.mark.parametrize("name", ["geometric", "hybrid"])
@pytest.mark.parametrize("seed", [1, 3])
def test_a_lever_under_a_seat_is_held_at_its_inner_end(name: str, seed: int) -> None:
    """Both of its ends are equally near to the seat."""
    truth = make("Chair", seed)
    (lever,) = [p.link for p in truth.object.parts if p.name == "lever"]
    segmented = SegmentedObject("chair", truth.object.parts, truth.object.category)
    found = load_predictor(name).predict(segmented).joint(lever)
    expected = truth.object.tree.joint_of[lever]
    assert found is not None and found.rotates
    assert np.allclose(found.origin, expected.origin, atol=0.02)


@pytest.mark.parametrize("part, expected", [("link_2", "prismatic"), ("link_1", "revolute")])
def test_the_shape_decides_between_the_words_of_a_name(part: str, expected: str) -> None:
    """People call a drawer's front a "drawer door"."""
    obj = wooden_cabinet()
    parts = tuple(replace(p, name="drawer door" if p.link == part else None) for p in obj.parts)
    tree = PREDICTOR.predict(SegmentedObject("cabinet", parts)).tree
    assert tree is not None and tree.joint_of[part].type == expected
