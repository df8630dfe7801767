"""Objects that are known to be good or bad get exactly the findings that they should."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import GeometryError, KinematicsError
from model.core.geometry import Mesh, PointCloud
from model.core.joint import Joint
from model.core.progress import Cancelled
from model.validation.report import Severity
from model.validation.runner import validate
from tests.builders import box, linked, part, slide, two
from tests.model.validation.cabinets import DOOR, DRAWER, W, cabinet


def judge(obj: ArticulatedObject, **options):
    return validate(obj, physics=False, **options)


def mended(obj: ArticulatedObject, report, joint: str, kind: str) -> ArticulatedObject:
    """The object after the mend of that kind."""
    mend = next(m for m in report.of(joint).fixes if m.kind == kind)
    return replace(obj, tree=obj.tree.with_joint(mend.joint))


def test_a_good_cabinet_passes():
    report = judge(cabinet())
    assert report.severity == Severity.OK
    assert [j.severity for j in report.joints] == [Severity.OK, Severity.OK]
    assert all(not j.fixes for j in report.joints)
    assert report.of("door").message == "Moves freely over its range."


def test_a_door_that_opens_inward_is_broken_and_flipping_mends_it():
    x, y, z = DOOR.axis
    bad = cabinet(replace(DOOR, axis=(-x, -y, -z)))
    report = judge(bad)
    found = report.joints[0]
    assert (found.joint, found.severity) == ("door", Severity.ERROR)
    assert report.of("drawer").severity == Severity.OK
    assert "carcass 0" in found.message
    assert found.worst.where is not None and found.worst.q.keys() == {"door"}
    assert found.fixes[0].kind == "flip"
    assert found.fixes[0].joint == DOOR
    assert judge(mended(bad, report, "door", "flip")).severity == Severity.OK


def test_a_door_that_turns_both_ways_is_to_be_looked_at():
    """No board in the middle and no corner behind the hinge: it turns inward a little, freely."""
    front = replace(DOOR, origin=(-0.4, -W - 0.002, 0.3), lower=math.radians(-4))
    found = judge(cabinet(front)).of("door")
    assert found.severity == Severity.WARNING
    assert any("Opens both ways from the scanned pose (-4°" in f.message for f in found.findings)
    assert not any("both ways" in f.message for f in judge(cabinet()).of("door").findings)


def test_a_door_hinged_where_nothing_holds_it_is_broken_and_the_axis_can_be_shifted():
    """No board in the middle: hinged there, an open door hangs in the air."""
    frame = part(
        "link_0",
        box([-0.4, 0, 0], [0.4, 0.4, W]),
        box([-0.4, 0, 0.6 - W], [0.4, 0.4, 0.6]),
        box([-0.4, 0, 0], [-0.4 + W, 0.4, 0.6]),
        box([0.4 - W, 0, 0], [0.4, 0.4, 0.6]),
        box([-0.4, 0.4 - W, 0], [0.4, 0.4, 0.6]),
    )
    leaf = part("link_1", box([-0.4, -W - 0.002, 0.05], [-0.002, -0.002, 0.55]), name="door")
    hinge = replace(DOOR, axis=(0, 0, 1), origin=(-0.002, -0.1, 0.3), upper=1.6)
    bad = two(hinge, frame, leaf)
    report = judge(bad)
    found = report.of("door")
    assert found.severity == Severity.ERROR
    assert found.worst.kind == "detached"
    assert found.message.startswith("Comes off base")
    after = mended(bad, report, "door", "shift")
    assert abs(after.tree.by_name["door"].origin[0] + 0.4) < 0.03
    assert judge(after).severity == Severity.OK


def test_a_drawer_that_goes_through_the_back_is_broken():
    bad = cabinet(drawer=replace(DRAWER, axis=(0, 1, 0)))
    report = judge(bad)
    found = report.joints[0]
    assert (found.joint, found.severity) == ("drawer", Severity.ERROR)
    assert found.depth > 0.1
    assert found.worst.other == "link_0"
    assert judge(mended(bad, report, "drawer", "flip")).severity == Severity.OK


def test_a_door_that_opens_into_a_wall_has_its_limit_shortened():
    wall = box([-0.46, -0.8, 0], [-0.44, 0.4, 0.6])
    shelf = box([-0.46, 0, 0], [-0.4, 0.4, W])
    bad = cabinet(replace(DOOR, upper=math.pi), DRAWER, wall, shelf)
    report = judge(bad)
    found = report.of("door")
    assert found.severity == Severity.ERROR
    free = next(m for m in found.fixes if m.kind == "limits").joint
    assert free.lower == 0
    assert math.radians(75) < free.upper < math.radians(115)
    assert judge(mended(bad, report, "door", "limits")).severity == Severity.OK


@pytest.mark.parametrize("scanned", [False, True])
def test_of_a_scanned_drawer_the_unseen_rest_reaches_inside(scanned):
    """Its front alone was seen, from one side: as a cloud, or as the open mesh made of it."""
    x, z = np.meshgrid(np.linspace(0.0, 0.4, 60), np.linspace(0.0, 0.3, 50), indexing="ij")
    points = np.stack([x, np.full_like(x, -0.003), z], -1).reshape(-1, 3).astype(np.float32)
    plate = box([0.0, -0.003, 0.0], [0.4, 0.0, 0.3])
    plate.update_faces(plate.face_normals[:, 1] < -0.5)
    front = part("link_2", plate, name="drawer")
    if scanned:
        front = Part("link_2", cloud=PointCloud(points), name="drawer")

    def opened(upper: float):
        obj = cabinet(drawer=replace(DRAWER, upper=upper))
        return judge(replace(obj, parts=(*obj.parts[:2], front))).of("drawer")

    assert opened(0.3).severity == Severity.OK, opened(0.3).message
    assert opened(0.6).worst.kind == "detached", "further than the carcass is deep"


def test_a_drawer_that_falls_out_has_its_limit_shortened():
    bad = cabinet(drawer=replace(DRAWER, upper=0.7))
    report = judge(bad)
    found = report.of("drawer")
    assert (found.severity, found.worst.kind) == (Severity.ERROR, "detached")
    assert found.worst.q == {"drawer": pytest.approx(0.7)}
    assert found.message.startswith("Slides out of carcass")
    after = mended(bad, report, "drawer", "limits")
    assert 0.2 < after.tree.by_name["drawer"].upper < 0.45
    assert judge(after).severity == Severity.OK


def test_a_lid_that_is_lifted_off_is_fine():
    pot = part("link_0", box([0, 0, 0], [0.3, 0.3, 0.2]))
    lid = part("link_1", box([0, 0, 0.2], [0.3, 0.3, 0.22]), name="lid")
    report = judge(two(Joint("j", "prismatic", "link_0", "link_1", lower=0, upper=0.15), pot, lid))
    assert report.severity == Severity.OK
    assert report.of("j").message.startswith("Lifts off")


@pytest.mark.parametrize(
    ("front", "axis", "said"),
    [
        (0.01, (0, -1, 0), "Slides out of base"),
        (-0.02, (0, -1, 0), "Slides off base"),
        (0.01, (0, 0, -1), "Slides out of base"),
    ],
)
def test_what_leaves_level_or_downwards_is_not_lifted(front, axis, said):
    """A drawer's front in its hole, and one before it: a scan shows no more of a drawer."""
    sides = [box([0, 0, 0], [0.02, 0.4, 0.3]), box([0.58, 0, 0], [0.6, 0.4, 0.3])]
    panel = part("link_1", box([0.021, front, 0.01], [0.579, front + 0.018, 0.29]))
    slide = Joint("j", "prismatic", "link_0", "link_1", axis, lower=0, upper=0.5)
    assert judge(two(slide, part("link_0", *sides), panel)).of("j").message.startswith(said)


def kettle(rim: float) -> ArticulatedObject:
    """A pot with a lid that reaches ``rim`` metres into it, and goes up by 0.05."""
    pot = part(
        "link_0", box([0, 0, 0], [0.3, 0.3, 0.01]), box([0, 0, 0], [0.01, 0.3, 0.2]),
        box([0.29, 0, 0], [0.3, 0.3, 0.2]), box([0, 0, 0], [0.3, 0.01, 0.2]),
        box([0, 0.29, 0], [0.3, 0.3, 0.2]),
    )  # fmt: skip
    lid = part(
        "link_1", box([0, 0, 0.2], [0.3, 0.3, 0.21]),
        box([0.011, 0.011, 0.2 - rim], [0.289, 0.289, 0.2]), name="lid",
    )  # fmt: skip
    return two(Joint("j", "prismatic", "link_0", "link_1", lower=0, upper=0.05), pot, lid)


@pytest.mark.parametrize(("rim", "severity"), [(0.001, Severity.OK), (0.017, Severity.WARNING)])
def test_a_lid_with_a_rim_is_lifted_off_too(rim, severity):
    found = judge(kettle(rim)).of("j")
    assert found.severity == severity
    assert found.message.startswith("Lifts off base")


def test_a_floating_part_is_broken():
    base = part("link_0", box([0, 0, 0], [1, 1, 0.1]))
    above = part("link_1", box([0.4, 0.4, 0.5], [0.6, 0.6, 0.6]))
    joint = Joint("j", "revolute", "link_0", "link_1", origin=(0.5, 0.5, 0.5), lower=0, upper=1)
    report = judge(two(joint, base, above))
    found = report.of("j")
    assert (found.severity, found.worst.kind) == (Severity.ERROR, "floating")
    assert "400 mm gap to base" in found.message
    near = part("link_1", box([0.4, 0.4, 0.13], [0.6, 0.6, 0.2]))
    assert judge(two(joint, base, near)).of("j").severity == Severity.WARNING


def test_a_part_of_a_fixed_joint_that_floats_is_told_too():
    base = part("link_0", box([0, 0, 0], [1, 1, 0.1]))
    above = part("link_1", box([0.4, 0.4, 0.5], [0.6, 0.6, 0.6]))
    report = judge(two(Joint("glue", "fixed", "link_0", "link_1"), base, above))
    assert report.of("glue").severity == Severity.ERROR


def test_a_part_that_is_wedged_in_is_jammed():
    walls = part(
        "link_0", box([0, 0, 0], [0.1, 0.5, 0.5]), box([0.4, 0, 0], [0.5, 0.5, 0.5]),
        box([0, 0, -0.1], [0.5, 0.5, 0]),
    )  # fmt: skip
    plug = part("link_1", box([0.1, 0.1, 0], [0.4, 0.4, 0.3]))
    joint = Joint("j", "prismatic", "link_0", "link_1", (1, 0, 0), lower=-0.2, upper=0.2)
    found = judge(two(joint, walls, plug)).of("j")
    assert (found.severity, found.worst.kind) == (Severity.ERROR, "jammed")
    assert found.message == "Blocked at rest by base."


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_geometry_that_is_no_number_never_gets_as_far_as_the_gate(value):
    door = cabinet().parts[1]
    at = np.array(door.mesh.vertices)
    at[3, 1] = value
    with pytest.raises(GeometryError, match="1 of 8 rows are NaN or infinite"):
        replace(door, mesh=replace(door.mesh, vertices=at))
    with pytest.raises(KinematicsError, match="finite"):
        replace(DOOR, upper=value)


def test_a_part_that_is_a_single_point_is_broken_and_the_others_are_still_judged():
    obj = cabinet()
    door = Part("link_1", cloud=PointCloud(np.zeros((1, 3), np.float32)), name="door")
    report = validate(replace(obj, parts=(obj.parts[0], door, obj.parts[2])))
    assert report.of("door").severity == Severity.ERROR
    assert report.of("door").message == "The part is a single point."
    assert report.of("drawer").severity == Severity.OK
    assert report.physics is None


def test_empty_parts_and_an_object_of_nothing_else_get_a_verdict():
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    obj = cabinet()
    report = judge(replace(obj, parts=(Part("link_0", nothing), *obj.parts[1:])))
    assert {j.severity for j in report.joints} == {Severity.ERROR}
    report = judge(two(Joint("j", "continuous", "link_0", "link_1"), Part("link_0", nothing),
                       Part("link_1", cloud=PointCloud(np.zeros((0, 3), np.float32)))))  # fmt: skip
    assert report.of("j").severity == Severity.ERROR


@pytest.mark.parametrize(
    ("change", "severity", "word"),
    [
        ({"lower": 0.0, "upper": 0.0}, Severity.ERROR, "empty"),
        ({"lower": 0.0, "upper": 5.0}, Severity.ERROR, "Travels"),
        ({"lower": 0.05, "upper": 0.2}, Severity.WARNING, "outside"),
    ],
)
def test_limits_that_make_no_sense(change, severity, word):
    found = judge(cabinet(drawer=replace(DRAWER, **change))).of("drawer")
    assert any(f.kind == "limits" and word in f.message for f in found.findings)
    assert found.severity == severity or word == "Travels"


def test_an_empty_range_can_be_set_to_the_free_one():
    bad = cabinet(drawer=replace(DRAWER, upper=0.0))
    report = judge(bad)
    after = mended(bad, report, "drawer", "limits").tree.by_name["drawer"]
    assert after.lower == 0
    assert after.upper > 0.15


def test_a_knob_of_many_turns_is_looked_at():
    base = part("link_0", box([0, 0, 0], [0.3, 0.3, 0.1]))
    knob = part("link_1", box([0.1, 0.1, 0.1], [0.2, 0.2, 0.12]))
    joint = Joint("j", "revolute", "link_0", "link_1", origin=(0.15, 0.15, 0), lower=0, upper=19)
    found = judge(two(joint, base, knob)).of("j")
    assert found.severity == Severity.WARNING
    assert "Turns 3.0 times" in found.message


def buttons(count: int) -> ArticulatedObject:
    """A board with buttons in a row that all stand above it, and sink in front of it."""
    board = part("link_0", box([0, 0, -0.02], [0.02 * count, 0.05, 0]))
    parts, joints = [board], []
    for k in range(count):
        low = [0.02 * k + 0.004, 0.01, 0.0]
        parts.append(part(f"link_{k + 1}", box(low, [low[0] + 0.012, 0.03, 0.01])))
        joints.append(Joint(f"j{k}", "prismatic", "link_0", f"link_{k + 1}", lower=0, upper=0.004))
    return linked(joints, *parts)


def test_dozens_of_joints_are_all_judged():
    report = validate(buttons(36))  # three in each group that is driven together
    assert len(report.joints) == 36
    assert report.severity == Severity.OK
    assert report.physics is not None


def test_what_meets_only_together_is_told_of_both():
    left = part("link_1", box([-0.8, 0, 0], [-0.05, 0.02, 1]), name="leaf")
    right = part("link_2", box([0.05, 0, 0], [0.8, 0.02, 1]), name="leaf")
    rail = part("link_0", box([-1, -0.05, -0.1], [1, 0.05, 0]))
    obj = linked((slide("a", "link_1", 0.09), slide("b", "link_2", 0.09, -1)), rail, left, right)
    report = judge(obj)
    for name in ("a", "b"):
        found = report.of(name)
        kinds = [f.kind for f in found.findings]
        assert kinds == ["combination"]
        assert set(found.worst.q) == {"a", "b"}
        assert "Leaf 1 and leaf 2 collide" in found.message
    assert judge(obj).joints == report.joints


def test_a_drawer_behind_a_door_is_free_once_the_door_is_open():
    wide = part("link_1", box([-0.4, -W - 0.002, 0], [0.4, -0.002, 0.6]), name="door")
    obj = cabinet()
    inner = replace(obj.parts[2].mesh, vertices=obj.parts[2].mesh.vertices + [0, 0.03, 0])
    parts = (obj.parts[0], wide, Part("link_2", inner, name="drawer"))
    found = judge(replace(obj, parts=parts)).of("drawer")
    assert found.severity == Severity.OK
    assert found.message == "Free once door 1 is out of the way."


def test_the_report_is_plain_json_and_the_work_can_be_stopped():
    x, y, z = DOOR.axis
    bad = cabinet(replace(DOOR, axis=(-x, -y, -z)))
    data = json.loads(json.dumps(judge(bad).to_json(), allow_nan=False))
    assert data["verdict"] == "broken"
    assert data["joints"][0]["joint"] == "door"
    assert 0 < data["joints"][0]["depth_share"] < 1
    told: list[float] = []

    def stop(fraction: float, message: str) -> None:
        told.append(fraction)
        if len(told) == 3:
            raise Cancelled

    with pytest.raises(Cancelled):
        validate(bad, progress=stop)
    assert told == sorted(told)
