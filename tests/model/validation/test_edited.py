"""Judging again after one joint was edited: as from scratch, without doing all of it again."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from model.core import codec
from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint
from model.core.memory import LruCache
from model.kinematics import penetration
from model.physics.collision import build, narrow_phase
from model.validation import physics
from model.validation.runner import validate
from tests.model.demos import demo_object


def edits_of(joint: Joint) -> list[Joint]:
    """What a person may change of a joint."""
    x, y, z = joint.axis
    out = [
        replace(joint, axis=(-x, -y, -z)),
        replace(joint, origin=tuple(v + 0.02 for v in joint.origin)),
        replace(joint, give_way=True),
        replace(joint, type="fixed", lower=None, upper=None),
    ]
    if joint.limited:
        assert joint.lower is not None and joint.upper is not None
        out = [
            replace(joint, upper=0.9 * joint.upper),
            replace(joint, upper=1.6 * joint.upper),
            replace(joint, lower=joint.lower - 0.2 * (joint.upper - joint.lower)),
            *out,
        ]
    return out


def said(obj: ArticulatedObject, store: Path) -> Any:
    report = validate(obj, store=store)
    return codec.write(replace(report, seconds=0.0))


def forget() -> None:
    """As in a process that has judged nothing yet; what is known of parts goes with them."""
    caches: list[LruCache[Any, Any]] = [build.recent_objects, build.recent_parts]
    caches += [narrow_phase.recent_depths, physics.recent_drives]
    for cache in caches:
        cache.clear()


@pytest.mark.parametrize("name", ["cabinet", "laptop"])
def test_what_is_said_after_an_edit_is_what_is_said_from_scratch(name: str, tmp_path: Path) -> None:
    obj, store = demo_object(name), tmp_path / "store"
    forget()
    first = said(obj, store)
    shutil.copytree(store, tmp_path / "first")
    # One edit of each kind, of one joint after the other.
    moving = [j for j in obj.tree.joints if j.moves]
    kinds = range(len(edits_of(moving[0])))
    edited = [edits_of(moving[k % len(moving)]) for k in kinds]
    trees = [obj.tree.with_joint(edits[k]) for k, edits in zip(kinds, edited, strict=True)]
    told = [said(replace(obj, tree=tree), store) for tree in trees]
    assert said(obj, store) == first
    for k, (tree, expected) in enumerate(zip(trees, told, strict=True)):
        forget()
        alone = shutil.copytree(tmp_path / "first", tmp_path / f"alone {k}")
        assert said(replace(demo_object(name), tree=tree), alone) == expected


def test_only_what_an_edited_joint_has_a_say_in_is_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    obj = demo_object("cabinet")
    forget()
    said(obj, tmp_path)
    joint = next(j for j in obj.tree.joints if j.moves)
    moved = set(obj.tree.descendants(joint.child))
    swept: list[set[str]] = []
    driven: list[list[int]] = []
    sweep, drive = penetration.sweep_penetrations, physics.Simulation.drive

    def sweeping(part: Any, target: Any, *more: Any) -> Any:
        swept.append({part.link, target.link})
        return sweep(part, target, *more)

    def driving(run: physics.Simulation, group: list[int], *more: Any) -> bool:
        driven.append(group)
        return drive(run, group, *more)

    monkeypatch.setattr(penetration, "sweep_penetrations", sweeping)
    monkeypatch.setattr(physics.Simulation, "drive", driving)
    assert joint.upper is not None
    shorter = obj.tree.with_joint(replace(joint, upper=0.9 * joint.upper))
    said(replace(obj, tree=shorter), tmp_path)
    assert swept and all(pair & moved for pair in swept)
    place = [j.name for j in obj.tree.joints if j.moves].index(joint.name)
    assert driven and all(group == [place] for group in driven)
