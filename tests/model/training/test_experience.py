"""What accepted objects say about the joints of others, and when it takes over."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.core.articulated_object import ArticulatedObject, SegmentedObject
from model.core.errors import ConfigurationError, InputFileError
from model.core.geometry import about, affine, merged
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.data.procedural.generate import make
from model.data.registry import DatasetOptions
from model.evaluation.teaching import Parts, TeachConfig, accepted_example, checked, run
from model.io.assets.asset_folder import write_asset
from model.prediction.arti4urdf.predictor import Arti4UrdfPredictor, learned_hybrid
from model.prediction.experience import (
    Experience,
    ObjectExample,
    PartExample,
    Step,
    in_use,
    load_experience,
    part_name,
    record_of,
    save_experience,
)
from model.prediction.registry import load_predictor
from model.training import experience
from model.training.experience import learn, use, versions
from tests.builders import box, part

X, Y, Z = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """What *All parts* learns takes ten seconds an object; tests of the command learn it."""
    monkeypatch.setattr(experience, "with_masks", lambda example, obj: replace(example, masks=()))


def gadget(width: float = 1.0, names: bool = True, steps: int = 1) -> ArticulatedObject:
    """A desk whose two flat wings lean on a rail that no rule knows: the left one slides along the
    rail, the right one turns about its far edge; a knob is pushed and turned."""
    spans = {
        "link_0": ((-width / 2, -0.3, 0), (width / 2, 0.3, 0.4)),
        "link_1": ((-width * 5 / 12, -0.32, 0.05), (-width / 12, -0.3, 0.35)),
        "link_2": ((width / 12, -0.32, 0.05), (width * 5 / 12, -0.3, 0.35)),
        "link_3": ((-0.03, -0.38, 0.27), (0.03, -0.3, 0.33)),
    }
    called = ("desk", "wing", "wing", "thing") if names else (None,) * 4
    parts = tuple(
        part(link, box(*span), name=name)
        for (link, span), name in zip(spans.items(), called, strict=True)
    )
    edge = (width * 5 / 12, -0.31, 0.2)
    middle = (0.0, -0.34, 0.3)
    joints = (
        Joint("a", "prismatic", "link_0", "link_1", X, (0, 0, 0), 0.0, 0.1 * width),
        Joint("b", "revolute", "link_0", "link_2", Z, edge, 0.0, 0.7),
        Joint("c", "prismatic", "link_0", "helper_3", Y, middle, 0.0, 0.02),
        Joint("d", "revolute", "helper_3", "link_3", Y, middle, 0.0, 1.9),
    )
    if steps == 1:
        joints = (*joints[:2], replace(joints[3], parent="link_0"))
    links = (*spans, *(["helper_3"] if steps > 1 else []))
    return ArticulatedObject("gadget", parts, KinematicTree(links, joints), "gadget")


def width(joint: Joint) -> float:
    low, high = joint.motion_range
    return high - low


def taught(*accepted: ArticulatedObject) -> Experience:
    return Experience(tuple(accepted_example(o, f"o-{k}") for k, o in enumerate(accepted)))


def predicted(known: Experience, obj: ArticulatedObject) -> KinematicTree:
    parts = SegmentedObject(obj.name, obj.parts, obj.category)
    tree = learned_hybrid(known).predict(parts).tree
    assert tree is not None
    return tree


@pytest.mark.parametrize("names", [True, False])
def test_left_and_right_follow_their_own_examples_and_motions_may_be_composite(names: bool) -> None:
    known = taught(*(gadget(w, names, steps=2) for w in (0.9, 1.0, 1.15)))
    new = gadget(1.3, names, steps=2)
    tree = predicted(known, new)
    left, right = tree.joint_of["link_1"], tree.joint_of["link_2"]
    assert left.type == "prismatic" and abs(left.axis[0]) > 0.99
    assert width(left) == pytest.approx(0.13, abs=0.02)
    assert right.type == "revolute" and right.origin[0] == pytest.approx(1.3 * 5 / 12, abs=0.03)
    assert width(right) == pytest.approx(0.7, abs=0.05)
    turn = tree.joint_of["link_3"]
    push = tree.joint_of[turn.parent]
    assert (push.type, turn.type) == ("prismatic", "revolute") and abs(push.axis[1]) > 0.99


def test_an_object_that_faces_another_way_is_recognised() -> None:
    known = taught(*(gadget(w) for w in (0.9, 1.0, 1.15)))
    turned = gadget(1.05).moved(affine(about(2, np.pi / 2)))
    tree = predicted(known, turned)
    assert tree.joint_of["link_1"].type == "prismatic"
    assert abs(tree.joint_of["link_1"].axis[1]) > 0.99
    assert tree.joint_of["link_2"].type == "revolute"


def test_where_examples_disagree_the_alternatives_hold_both() -> None:
    def other(width: float) -> ArticulatedObject:
        obj = gadget(width)
        up = replace(obj.tree.joint_of["link_1"], axis=Z)
        return replace(obj, tree=obj.tree.with_joint(up))

    known = taught(gadget(0.9), gadget(1.0), other(1.05), other(1.15))
    new = gadget(1.1)
    found = learned_hybrid(known).predict(SegmentedObject("new", new.parts, new.category))
    axes = [np.abs(j.axis).round(1).tolist() for j in found.likely("link_1")[:2]]
    assert sorted(axes) == [list(Z), list(X)]
    assert found.confidence["link_1"] < 0.7


def test_an_object_that_a_person_chose_counts_though_its_kind_is_not_used() -> None:
    known = replace(taught(gadget(0.9), gadget(1.0)), unused=("gadget",))
    new = gadget(1.1)
    segmented = SegmentedObject("new", new.parts, new.category)
    chosen = learned_hybrid(known).with_example(gadget(1.05), "chosen")
    assert chosen is not None and chosen.experience is not None
    assert [o.source for o in chosen.experience.objects] == ["chosen"]
    found = [p.predict(segmented).tree for p in (learned_hybrid(known), chosen)]
    types = [tree.joint_of["link_1"].type for tree in found if tree is not None]
    assert types[0] != types[1] == "prismatic"
    own = load_predictor("without:network")
    assert isinstance(own, Arti4UrdfPredictor)
    taken = own.with_example(gadget(), "chosen")
    assert taken is not None and (taken.left_out, taken.name) == ("network", own.name)


def accepted(folder: Path, count: int, upper: float | None, name: str | None = "lid") -> list[Path]:
    """Laptops whose lids were all accepted with one range, or as they are predicted."""
    out = []
    for k in range(count):
        obj = make("Laptop", 5, k).object
        parts = tuple(replace(p, name=name if p.link != obj.tree.root else None) for p in obj.parts)
        tree = obj.tree
        if upper is not None:
            joints = tuple(replace(j, lower=0.0, upper=upper) for j in tree.joints)
            tree = replace(tree, joints=joints)
        else:
            segmented = SegmentedObject(obj.name, parts, obj.category)
            tree = load_predictor("hybrid").predict(segmented).tree or tree
        obj = replace(obj, parts=parts, tree=tree)
        out.append(folder / "assets" / f"laptop-{k}")
        write_asset(obj, out[-1], provenance={})
    return out


def test_what_was_accepted_takes_over_where_it_helps_and_can_be_taken_back(tmp_path: Path) -> None:
    assets = accepted(tmp_path, 4, 0.4)
    learned = learn(tmp_path, assets, jobs=1)
    assert learned.taken and learned.version == 1
    assert (learned.before.joints, learned.before.usable) == (4, 0), "no laptop opens so little"
    assert learned.after.usable == 4 and learned.kinds["laptop"].used
    assert record_of(tmp_path / "learned" / "1")["assets"] == [a.name for a in assets]
    folder = in_use(tmp_path)
    assert folder is not None
    obj = make("Laptop", 5, 9).object
    named = tuple(replace(p, name="Lid" if p.link != obj.tree.root else None) for p in obj.parts)
    new = SegmentedObject("new", named, obj.category)
    [joint] = load_predictor(f"learned:{folder}").predict(new).tree.joints  # type: ignore[union-attr]
    assert width(joint) == pytest.approx(0.4, abs=1e-3)
    found = load_predictor(f"learned:{folder}").predict(new)
    assert "Compared with 4 accepted objects" in found.notes[joint.child]
    assert found.backend.endswith("learned 1") and found.confidence[joint.child] > 0.6
    plain = load_predictor("hybrid").predict(new)
    assert plain.joint(joint.child).upper - plain.joint(joint.child).lower > 1  # type: ignore

    again = learn(tmp_path, assets[:3], ["laptop-3"], jobs=1)
    assert versions(tmp_path) == [1, 2] and again.left_out == ("laptop-3",)
    use(tmp_path, 1)
    assert in_use(tmp_path) == folder
    use(tmp_path, 0)
    assert in_use(tmp_path) is None
    with pytest.raises(ConfigurationError, match="no version 7; versions: 1, 2"):
        use(tmp_path, 7)


def test_nothing_takes_over_without_a_gain_or_enough_of_a_kind(tmp_path: Path) -> None:
    alike = learn(tmp_path, accepted(tmp_path, 3, None), jobs=1)
    assert alike.before.usable == alike.after.usable and not alike.taken
    assert versions(tmp_path) == [1] and in_use(tmp_path) is None, "it is kept, but not used"
    with pytest.raises(
        ConfigurationError, match="2 accepted objects have moving parts; it takes 3"
    ):
        learn(tmp_path / "b", accepted(tmp_path / "b", 2, 0.4), jobs=1)


def test_what_says_nothing_about_an_object_changes_nothing() -> None:
    obj = make("Oven", 11, 0).object
    segmented = SegmentedObject(obj.name, obj.parts, obj.category)
    plain = learned_hybrid(None).predict(segmented)
    assert plain.tree is not None
    step = Step("revolute", X, (0.0, 1.0, 0.0), upper=1.5)
    lid = PartExample("flap", 0, half=(0.1, 0.1, 0.01), steps=(step,))
    elsewhere = tuple(ObjectExample(k, "Table", (PartExample("base"), lid)) for k in "abc")
    unused = tuple(ObjectExample(k, "Oven", (PartExample("base"), lid)) for k in "abc")
    for known in (Experience(elsewhere), Experience(unused, ("oven",)), Experience()):
        found = learned_hybrid(known).predict(segmented)
        assert found.tree == plain.tree and found.confidence == plain.confidence
    sure, unsure = (Experience(unused, ("oven",), {"oven": (n, 24)}) for n in (24, 0))
    more, less = (learned_hybrid(known).predict(segmented) for known in (sure, unsure))
    assert less.confidence == plain.confidence
    for link, before in plain.confidence.items():  # 24 joints count for more than a belief's 16
        assert more.confidence[link] == pytest.approx(min(0.99, before * 0.4 + 0.6), abs=0.001)


def test_bench_teach_shows_what_examples_gain_and_leaves_out_those_that_cost(
    tmp_path: Path,
) -> None:
    for k in range(4):
        write_asset(gadget(0.9 + 0.1 * k), tmp_path / f"gadget_{k}", provenance={})
    rows = run(TeachConfig(DatasetOptions("urdf", tmp_path), "all", jobs=1))
    assert [r.names for r in rows] == [True, True, False, False]
    for alone, after in (rows[:2], rows[2:]):
        assert not alone.score.usable and alone.corrections > 0
        assert after.score.usable and after.corrections == 0
        assert alone.parts == after.parts == (3, 3, 3)
    known = Experience((ObjectExample("gadget_3", "gadget", ()),))
    assert checked(known, rows[:2], True) == replace(known, checked={"gadget": (3, 3)})
    swapped = [replace(row, examples=not row.examples) for row in rows[:2]]
    assert checked(known, swapped, True).unused == ("gadget",)
    for right, alike in ((False, ()), (True, ("gadget",))):  # no gain: used where none is right
        same = [replace(rows[right], examples=e) for e in (False, True)]
        assert checked(known, same, True).unused == alike


@pytest.mark.parametrize("how", ["clicks", "all"])
def test_bench_teach_finds_the_parts_itself(how: Parts, tmp_path: Path) -> None:
    """All parts takes what accepted objects had: the left wing is no part of these."""
    for k in range(3):
        obj = gadget(1.0 + 0.05 * k)
        desk, wing, *others = obj.parts
        assert desk.mesh is not None and wing.mesh is not None
        fused = replace(desk, mesh=merged([desk.mesh, wing.mesh]))
        tree = KinematicTree(("link_0", "link_2", "link_3"), obj.tree.joints[1:])
        obj = ArticulatedObject("gadget", (fused, *others), tree, "gadget")
        write_asset(obj, tmp_path / f"gadget_{k}", provenance={})
    rows = run(TeachConfig(DatasetOptions("urdf", tmp_path), "all", 2, jobs=1, parts=how))
    alone, after = (2, 2, 2) if how == "clicks" else (3, 2, 2), (2, 2, 2)
    assert [r.parts for r in rows] == [alone, after, alone, after]
    assert all(r.score.usable == (r.parts == after and r.examples) for r in rows)


def test_what_is_kept_is_read_again_and_damage_is_named(tmp_path: Path) -> None:
    path = tmp_path / "experience.json"
    known = taught(gadget(steps=2))
    save_experience(known, path)
    assert load_experience(path) == known
    path.write_text(json.dumps(json.loads(path.read_text()) | {"trust": {"gadget": 0.9}}))
    assert load_experience(path.rename(tmp_path / "earlier.json")) == known
    assert part_name("Bottom_lid-3") == "bottom lid" and part_name("F1 lid") == "f1 lid"
    for k, text in enumerate(("", "[]", '{"format": 9}', '{"format": 1, "objects": 3}')):
        other = tmp_path / f"{k}.json"
        other.write_text(text)
        with pytest.raises(InputFileError, match="holds no experience"):
            load_experience(other)


def test_the_first_format_s_named_joints_are_still_followed(tmp_path: Path) -> None:
    joint = {"name": "wing", "parent": "", "type": "prismatic", "axis": [0.0, 0.0, 1.0]}
    joint |= {"arm": [0.0, 0.0, 0.0], "lower": 0.0, "upper": 0.5}
    objects = [{"source": k, "category": "gadget", "joints": [joint]} for k in "abc"]
    path = tmp_path / "experience.json"
    path.write_text(json.dumps({"format": 1, "objects": objects, "trust": 0.9}))
    tree = predicted(load_experience(path), gadget())
    for link in ("link_1", "link_2"):
        assert tree.joint_of[link].type == "prismatic" and abs(tree.joint_of[link].axis[2]) > 0.99
        assert tree.joint_of[link].upper == pytest.approx(0.15, abs=0.01)
