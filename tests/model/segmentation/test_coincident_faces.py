"""Meshes that hold each of their faces twice, once for either side."""

import json
from dataclasses import replace

import numpy as np
import pytest

from model.core.asset import Asset
from model.core.files import static_assets
from model.core.geometry import Mesh
from model.geometry.topology import coincident_faces
from model.io.open_asset import open_asset
from model.segmentation.all_parts import propose_parts
from model.segmentation.default import DefaultSegmenter, DefaultSession
from model.segmentation.nodes import nodes_of_asset
from model.segmentation.prompts import Click, Prompts, Region
from tests.builders import blocks

EXAMPLES = static_assets() / "examples"


def doubled(mesh: Mesh) -> Mesh:
    """``mesh`` with every face turned round as well, behind all others."""
    return replace(
        mesh,
        faces=np.concatenate([mesh.faces, mesh.faces[:, ::-1]]),
        face_material=np.tile(mesh.face_material, 2),
    )


@pytest.fixture(scope="module")
def cabinet() -> DefaultSession:
    mesh = open_asset(EXAMPLES / "cabinet.glb").mesh
    assert mesh is not None
    return DefaultSegmenter().encode(Asset("cabinet", mesh=doubled(mesh)))


def clicks() -> tuple[Click, ...]:
    said = json.loads((EXAMPLES / "cabinet.prompts.json").read_text())["clicks"]
    return tuple(Click(tuple(c["position"]), c["part"], c["positive"]) for c in said)


def test_the_first_of_faces_with_the_same_corners() -> None:
    box, _ = blocks(((0, 0, 0), (1, 1, 1)))
    assert coincident_faces(box) is None
    found = coincident_faces(doubled(box))
    assert found is not None
    assert found.tolist() == [*range(12), *range(12)]


def test_a_surface_that_is_there_twice_is_sampled_once() -> None:
    box, _ = blocks(((0, 0, 0), (1, 1, 1)))
    once, twice = (nodes_of_asset(Asset("box", mesh=m)) for m in (box, doubled(box)))
    assert np.array_equal(once.points, twice.points)
    label = (once.points[:, 2] > 0.5).astype(np.int16)
    assert np.array_equal(
        twice.elements.to_elements(label), np.tile(once.elements.to_elements(label), 2)
    )
    assert twice.elements.elements_of(np.arange(len(twice.points))).tolist() == list(range(24))


def test_both_sides_of_a_face_are_in_one_part(cabinet: DefaultSession) -> None:
    half = cabinet.asset.element_count // 2
    door, *others = clicks()
    at = cabinet.segment(Prompts((door,))).labels
    element = int(np.flatnonzero(at[half:] == door.part)[0]) + half
    answers = [
        (door,),
        (door, *others),
        (door, replace(door, positive=False)),
        (door, replace(others[0], element=element), replace(door, positive=False, element=element)),
        (*others, Region(door.part, np.arange(half, half + 5), True)),
        (door, Region(door.part, np.arange(half, half + 40), False)),
    ]
    for items in answers:
        labels = cabinet.segment(Prompts(items)).labels
        assert np.array_equal(labels[:half], labels[half:])
        last = items[-1]
        said = labels[last.elements] if isinstance(last, Region) else labels[[last.element or 0]]
        if isinstance(last, Region) or last.element is not None:
            assert ((said == last.part) == last.positive).all()
    for mask in cabinet.candidates(Prompts((door,)), door.part):
        assert np.array_equal(mask[:half], mask[half:])
    labels = propose_parts(cabinet).labels
    assert labels.any()
    assert np.array_equal(labels[:half], labels[half:])


def test_the_parts_are_those_of_the_mesh_with_each_face_once(cabinet: DefaultSession) -> None:
    asset = open_asset(EXAMPLES / "cabinet.glb")
    once = DefaultSegmenter().encode(asset).segment(Prompts(clicks())).labels
    twice = cabinet.segment(Prompts(clicks())).labels
    assert set(once.tolist()) == {0, 1, 2, 3, 4, 5}
    assert (once == twice[: len(once)]).mean() > 0.99


def test_very_many_copies_of_a_face_cost_no_more_than_other_faces() -> None:
    """So many that each of them with each of its nodes would be gigabytes."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]], np.float64)
    faces = np.array([[0, 1, 2]] * 200_000 + [[1, 3, 2]])
    asset = Asset("copies", mesh=Mesh(corners, faces, np.zeros(len(faces), np.int32)))
    elements = nodes_of_asset(asset).elements
    assert elements.vote_element.nbytes < 50e6
    labels = np.zeros(elements.node_count, np.int16)
    labels[elements.vote_node[elements.vote_element == 0]] = 3
    assert (elements.to_elements(labels) == [3] * 200_000 + [0]).all()
    session = DefaultSegmenter().encode(asset)
    found = session.segment(Prompts((Click((0.2, 0.2, 0.0), 1), Click((0.9, 0.9, 0.4), 2)))).labels
    assert (found == [1] * 200_000 + [2]).all()
