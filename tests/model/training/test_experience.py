"""What accepted objects say about the joints of others, and when it takes over."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.core.articulated_object import SegmentedObject
from model.core.errors import ConfigurationError, InputFileError
from model.data.procedural.generate import make
from model.io.assets.asset_folder import write_asset
from model.prediction.arti4urdf.predictor import learned_hybrid
from model.prediction.experience import (
    Experience,
    JointExample,
    Motions,
    ObjectExample,
    in_use,
    load_experience,
    part_name,
    record_of,
    save_experience,
)
from model.prediction.registry import load_predictor
from model.training.experience import learn, use, versions

X, Y, Z = np.eye(3).tolist()


def flap(source: str, axis: list[float], arm: list[float], upper: float = 1.5) -> ObjectExample:
    joint = JointExample("flap", "lid", "revolute", tuple(axis), tuple(arm), 0.0, upper)
    return ObjectExample(source, "Box", (joint,))


def candidates(name: str | None = "Flap 2") -> Motions:
    """A hinge at either side, one along the front, and a drawer."""
    return Motions(
        name, np.array([X, X, Y, Y]), np.array([[0, -1, 0], [0, 1, 0], [1, 0, 0], [0, 0, 0]]),
        np.array([True, True, True, False]),
    )  # fmt: skip


def test_accepted_parts_of_the_same_name_tell_motion_type_parent_and_range() -> None:
    known = Experience((flap("a", X, [0, 1, 0]), flap("b", X, [0, 0.9, 0.1])))
    found = known.recall("Box", {7: candidates()})[7]
    assert found.agreeing.tolist() == [0, 2, 0, 0]
    assert found.agreed(found.types) == "revolute" and found.agreed(found.parents) == "lid"
    assert found.range_about(np.array(X)) == (0.0, 1.5)
    assert found.range_about(-np.array(X)) == (-1.5, 0.0), "the other way round"
    assert found.range_about(np.array(Y)) is None
    one = Experience(known.objects[:1]).recall("Box", {0: candidates()})[0]
    assert one.agreed(one.types) is None, "one is not enough for type, limits or parent"
    assert known.without("a").objects == known.objects[1:]


def test_other_names_and_categories_are_not_touched_and_limits_must_agree() -> None:
    known = Experience((flap("a", X, [0, 1, 0]), flap("b", X, [0, 1, 0], 3.0)))
    assert not known.recall("Table", {0: candidates()}) and not known.recall(
        None, {0: candidates()}
    )
    assert not known.recall("Box", {0: candidates("door"), 1: candidates(None)})
    assert known.recall("Box", {0: candidates()})[0].range_about(np.array(X)) is None
    assert part_name("Bottom_lid-3") == "bottom lid" and part_name("F1 lid") == "f1 lid"


def test_an_accepted_object_may_face_another_way() -> None:
    turned = Experience((flap("a", Y, [-1, 0, 0]), flap("b", Y, [-1, 0, 0])))
    found = turned.recall("Box", {0: candidates()})[0]
    assert found.agreeing.max() == 2
    assert found.range_about(np.array(X)) == (-1.5, 0.0)


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
        elif name is not None:
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
    assert learned.after.usable == 4
    assert record_of(tmp_path / "learned" / "1")["assets"] == [a.name for a in assets]
    folder = in_use(tmp_path)
    assert folder is not None
    obj = make("Laptop", 5, 9).object
    named = tuple(replace(p, name="Lid" if p.link != obj.tree.root else None) for p in obj.parts)
    new = SegmentedObject("new", named, obj.category)
    [joint] = load_predictor(f"learned:{folder}").predict(new).tree.joints  # type: ignore[union-attr]
    assert joint.upper - joint.lower == pytest.approx(0.4, abs=1e-3)
    found = load_predictor(f"learned:{folder}").predict(new)
    assert "Compared with 4 accepted objects" in found.notes[joint.child]
    assert found.backend.endswith("learned 1") and found.confidence[joint.child] > 0.8
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


def test_nothing_takes_over_without_a_gain_or_names(tmp_path: Path) -> None:
    alike = learn(tmp_path, accepted(tmp_path, 3, None), jobs=1)
    assert alike.before.usable == alike.after.usable and not alike.taken
    assert versions(tmp_path) == [1] and in_use(tmp_path) is None, "it is kept, but not used"
    with pytest.raises(
        ConfigurationError, match="0 accepted objects have a category and named parts"
    ):
        learn(tmp_path / "b", accepted(tmp_path / "b", 3, None, None), jobs=1)


def test_what_says_nothing_about_an_object_changes_nothing() -> None:
    obj = make("Oven", 11, 0).object
    segmented = SegmentedObject(obj.name, obj.parts, obj.category)
    plain = learned_hybrid(None).predict(segmented)
    assert plain.tree is not None
    lids = tuple(replace(flap(k, X, [0, 1, 0]), category="Oven") for k in "ab")
    elsewhere = tuple(
        ObjectExample(k, "Table", (JointExample("door", "", "fixed"),)) for k in "abc"
    )
    for known in (lids, elsewhere, ()):
        found = learned_hybrid(Experience(known, 0.9)).predict(segmented)
        assert found.tree == plain.tree and found.confidence == plain.confidence
    doors = tuple(ObjectExample(k, "Oven", (JointExample("door", "", "fixed"),)) for k in "abc")
    fixed = learned_hybrid(Experience(doors, 0.9)).predict(segmented).tree
    assert fixed is not None
    named = {p.link for p in obj.parts if p.name == "door"}
    assert named and all(fixed.joint_of[link].type == "fixed" for link in named)


def test_what_is_kept_is_read_again_and_damage_is_named(tmp_path: Path) -> None:
    path = tmp_path / "experience.json"
    known = Experience((flap("a", X, [0, 1, 0]),), 0.9)
    save_experience(known, path)
    assert load_experience(path) == known
    for k, text in enumerate(("", "[]", '{"format": 9}', '{"format": 1, "objects": 3}')):
        other = tmp_path / f"{k}.json"
        other.write_text(text)
        with pytest.raises(InputFileError, match="holds no experience"):
            load_experience(other)
