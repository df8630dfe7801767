"""Procedural objects: closed solids, sensible sizes, and joints that move without collision."""

from dataclasses import replace

import numpy as np
import pytest

from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint
from model.data.procedural.families import FAMILIES, HELD_OUT
from model.data.procedural.generate import COMPOSITE, family_names, make
from model.data.procedural.grammar import at_rest
from model.geometry.topology import weld
from model.kinematics.sweep import sweep_joint

PRESSED = ("button", "key", "switch")
"""What is pushed sinks into the part that carries it, as it does in PartNet-Mobility."""


def same(a: ArticulatedObject, b: ArticulatedObject) -> bool:
    return a.tree == b.tree and all(
        np.array_equal(p.mesh.vertices, q.mesh.vertices)  # type: ignore[union-attr]
        for p, q in zip(a.parts, b.parts, strict=True)
    )


def test_the_46_categories_are_there_and_the_held_out_ones_are_among_them() -> None:
    assert len(FAMILIES) == 46
    assert set(HELD_OUT) <= set(FAMILIES)


@pytest.mark.parametrize("family", family_names())
def test_an_object_is_well_made(family: str) -> None:
    for index in range(3):
        made = make(family, 7, index)
        obj = made.object
        assert made.category == family
        low, high = np.concatenate([p.bounds for p in obj.parts]).min(0), None
        high = np.concatenate([p.bounds for p in obj.parts]).max(0)
        assert low[2] > -0.06, f"{family} {index} reaches below the floor: {low[2]}"
        assert 0.01 < np.linalg.norm(high - low) < 4.0
        assert any(j.moves for j in obj.tree.joints)
        assert {j.child for j in obj.tree.joints} | {obj.tree.root} == set(obj.tree.links)
        for part in obj.parts:
            assert part.name and part.mesh is not None
            assert len(made.pieces[part.link]) == len(part.mesh.faces)
            assert made.pieces[part.link].max() + 1 == len(made.piece_names[part.link])
        for joint in obj.tree.joints:
            if joint.limited:
                assert joint.lower is not None and joint.upper is not None
                assert joint.lower <= 1e-9 <= joint.upper + 2e-9, f"{joint.name}: 0 is not within"
                assert joint.upper - joint.lower > 1e-4


@pytest.mark.parametrize("family", family_names())
def test_solids_are_closed_and_look_outward(family: str) -> None:
    made = make(family, 11)
    for part in made.object.parts:
        assert part.mesh is not None
        pieces = made.pieces[part.link]
        for number, name in enumerate(made.piece_names[part.link]):
            solid = part.mesh.take_faces(pieces == number)
            ids = weld(solid)[solid.faces]
            ids = ids[(ids != np.roll(ids, 1, axis=1)).all(axis=1)]
            ahead = np.stack([ids, np.roll(ids, -1, axis=1)], -1).reshape(-1, 2)
            # Every edge is passed as often one way as the other.
            key, back = ahead @ [1 << 20, 1], ahead @ [1, 1 << 20]
            assert np.array_equal(np.sort(key), np.sort(back)), f"{part.name}/{name} is open"
            assert np.einsum("ij,ij->", solid.triangles.mean(1), solid.face_cross) > 0


def test_the_same_seed_gives_the_same_object_and_another_gives_another() -> None:
    for family in ("StorageFurniture", "Lamp", COMPOSITE):
        assert same(make(family, 3, 1).object, make(family, 3, 1).object)
        assert not same(make(family, 3, 1).object, make(family, 3, 2).object)


@pytest.mark.parametrize("family", family_names())
def test_joints_move_without_penetration(family: str) -> None:
    obj = make(family, 5).object
    name = {p.link: p.name for p in obj.parts}
    seen: dict[str | None, int] = {}
    for joint in obj.tree.joints:
        kind = name.get(joint.child)
        seen[kind] = seen.get(kind, 0) + 1
        if not joint.moves or kind in PRESSED or seen[kind] > 3:
            continue
        depth, other = worst(obj, joint)
        if depth > 0 and other is not None and other in obj.tree.joint_of:
            # A rack comes out once the door is open, a seat goes up once the lid does.
            first = obj.tree.joint_of[other]
            depth, other = worst(*opened(obj, joint, first))
        assert depth == 0, f"{family}: {kind} runs {1000 * depth:.1f} mm into {name.get(other)}"


def worst(obj: ArticulatedObject, joint: Joint) -> tuple[float, str | None]:
    """Deepest penetration beyond 4 thousandths of the diagonal (3 mm at least), and of what."""
    found = sweep_joint(obj, joint, samples=9, points=500)
    corners = np.concatenate([p.bounds for p in obj.parts])
    limit = max(0.003, 0.004 * float(np.linalg.norm(np.ptp(corners, axis=0))))
    k = int(np.argmax(found.depth))
    return (float(found.depth[k]), found.others[k]) if found.depth[k] > limit else (0.0, None)


def opened(obj: ArticulatedObject, joint: Joint, first: Joint) -> tuple[ArticulatedObject, Joint]:
    moved = at_rest(obj, {first.name: first.upper or 0.0})
    return moved, moved.tree.by_name[joint.name]


def test_a_rest_pose_is_what_the_joints_say() -> None:
    made = make("Door", 1)
    obj = made.object
    joint = next(j for j in obj.tree.joints if j.type == "revolute")
    assert joint.upper is not None and joint.lower is not None
    half = 0.5 * (joint.lower + joint.upper)
    moved = at_rest(obj, {joint.name: half})
    back = at_rest(moved, {joint.name: -half})
    for a, b in zip(obj.parts, back.parts, strict=True):
        assert a.mesh is not None and b.mesh is not None
        assert np.allclose(a.mesh.vertices, b.mesh.vertices, atol=1e-9)
    again = moved.tree.by_name[joint.name]
    assert np.isclose(again.upper - again.lower, joint.upper - joint.lower)  # type: ignore[operator]
    same = {name: getattr(joint, name) for name in ("axis", "origin", "lower", "upper")}
    assert replace(back.tree.by_name[joint.name], **same) == joint
