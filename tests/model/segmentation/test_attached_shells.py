"""What nobody clicks goes with what it is fastened to: handles, hinges and drawers' trays."""

import json

import numpy as np
import pytest

from model.core.asset import Asset
from model.core.geometry import Mesh
from model.data.simulated.primitives import block
from model.geometry.topology import connected_shells
from model.segmentation.all_parts import propose_parts
from model.segmentation.default import DefaultSegmenter, DefaultSession
from model.segmentation.facets import contacts_of
from model.segmentation.labels import find_attached_shells
from model.segmentation.mask_tools import hover
from model.segmentation.prompts import Click, Prompts, Region
from tests.builders import blocks, mesh_of, subdivide
from tests.model.demos import EXAMPLES, demo_truth, encoded_demo

FRONT, TRAY, CARCASS = 0, 1, slice(2, 7)


def cabinet(gap: float = 0.004, *, behind: float = 0.0) -> tuple[Mesh, np.ndarray]:
    """A front, its tray with ``gap`` metres to the carcass on both sides, five panels.

    ``behind`` is how far the tray stands behind the front.
    """
    inner = 0.38
    return blocks(
        ((-0.4, -0.02, 0.02), (0.4, 0.0, 0.38)),
        ((-inner + gap, behind, 0.06), (inner - gap, 0.4, 0.3)),
        ((-0.4, 0.002, 0), (-inner, 0.5, 0.4)),
        ((inner, 0.002, 0), (0.4, 0.5, 0.4)),
        ((-0.4, 0.002, -0.02), (0.4, 0.5, 0.0)),
        ((-0.4, 0.002, 0.4), (0.4, 0.5, 0.42)),
        ((-0.4, 0.5, -0.02), (0.4, 0.52, 0.42)),
    )


def pulled(mesh: Mesh, of: np.ndarray, *parts: int) -> list[int]:
    """The part of each box, when ``parts`` are the first ones' and the rest is the base."""
    labels = np.zeros(len(of), np.int16)
    for box, part in enumerate(parts):
        labels[of == box] = part
    none = np.zeros(0, np.int32)
    out = find_attached_shells(mesh, none, none).attach(labels, ())
    found = [set(out[of == box].tolist()) for box in range(of.max() + 1)]
    assert all(len(one) == 1 for one in found)
    return [one.pop() for one in found]


def test_a_tray_goes_with_its_front() -> None:
    assert pulled(*cabinet(), 1) == [1, 1, 0, 0, 0, 0, 0]


@pytest.mark.parametrize("gap, behind", [(0.0, 0.0), (0.004, 0.003)])
def test_a_tray_stays_where_it_touches_the_carcass_or_not_the_front(
    gap: float, behind: float
) -> None:
    assert pulled(*cabinet(gap, behind=behind), 1) == [1, 0, 0, 0, 0, 0, 0]


def test_the_carcass_does_not_go_with_a_door_that_touches_it() -> None:
    mesh, of = cabinet()
    vertices = mesh.vertices + np.where(of.repeat(3) == FRONT, 0.002, 0.0)[:, None] * [0, 1, 0]
    assert pulled(Mesh(vertices, mesh.faces), of, 1)[CARCASS] == [0] * 5


def test_what_lies_under_a_lid_stays() -> None:
    """Only upright fronts pull something: a seat or a lid lies on what carries it."""
    mesh, of = cabinet()
    turned = mesh.vertices[:, [0, 2, 1]] * np.float32([1, 1, -1])
    assert pulled(Mesh(turned, mesh.faces), of, 1)[TRAY] == 0


def test_a_tray_that_is_said_to_be_the_base_stays() -> None:
    mesh, of = cabinet()
    session = DefaultSegmenter().encode(Asset("drawer", mesh))
    front = Region(1, np.flatnonzero(of == FRONT))
    assert set(session.segment(Prompts((front,))).labels[of == TRAY]) == {1}
    face = int(np.flatnonzero(of == TRAY)[0])
    labels = session.segment(
        Prompts((front, Click(mesh.triangles[face].mean(0), 0, True, face)))
    ).labels
    assert set(labels[of == TRAY]) == {0}


@pytest.mark.parametrize("gap, touched", [(0.004, {FRONT}), (0.0, {FRONT, 2, 3})])
def test_contacts_are_exact(gap: float, touched: set[int]) -> None:
    mesh, of = cabinet(gap)
    a, b = contacts_of(mesh, np.asarray(connected_shells(mesh)), of == TRAY)
    assert set(of[a]) == {TRAY} and set(of[b]) == touched


@pytest.fixture(scope="module")
def bundled() -> tuple[DefaultSession, np.ndarray, dict[int, str]]:
    """The bundled cabinet, its faces' true parts, and what they are."""
    labels, truth = demo_truth("cabinet")
    return encoded_demo("cabinet"), labels, {p["id"]: p["name"] for p in truth["parts"] if p["id"]}


def test_one_click_takes_each_part_of_the_bundled_cabinet(
    bundled: tuple[DefaultSession, np.ndarray, dict[int, str]],
) -> None:
    """Fronts, handles, hinges and trays, and nothing of the partition 5 mm beside the trays."""
    session, labels, parts = bundled
    center, clicks = session.asset.element_centers, []
    for part, name in parts.items():
        level = -0.24 if name == "drawer" else -0.232  # a door's panel is set back
        front = (labels == part) & (np.abs(center[:, 1] - level) < 5e-4)
        spot = int(np.flatnonzero(front)[0])
        clicks.append(Click(center[spot], part, True, spot))
    found = session.segment(Prompts(tuple(clicks))).labels
    assert sorted(set(parts.values())) == ["door", "drawer"]
    assert (found == labels).all()


def test_a_click_on_a_handle_takes_what_it_moves(
    bundled: tuple[DefaultSession, np.ndarray, dict[int, str]],
) -> None:
    """Bar or post; Tab shows it alone, and dots show beforehand what the click will take."""
    session, labels, parts = bundled
    mesh = session.asset.mesh
    assert mesh is not None and session.finisher.attached is not None
    shell, center = np.asarray(connected_shells(mesh)), session.asset.element_centers
    clicked = set()
    for number in np.unique(shell):
        own = shell == number
        if center[own][:, 1].max() > -0.25:
            continue  # no handle before a front
        spot = int(np.flatnonzero(own)[0])
        part = int(labels[spot])
        prompts = Prompts((Click(center[spot], part, True, spot),))
        assert (session.segment(prompts).labels == np.where(labels == part, part, 0)).all()
        assert any(mask.sum() <= 3 * own.sum() for mask in session.candidates(prompts, part))
        shown = hover(session, center[spot], spot)
        assert mesh.face_areas[shown].sum() > 10 * mesh.face_areas[own].sum()
        clicked.add(part)
    assert clicked == set(parts), "each has a handle"


def test_a_key_beside_others_is_no_handle() -> None:
    """Long keys and flush bars stand out too little, and round knobs are as long as wide."""
    deck = block((0, 0, 0), (1, 1, 0.1))
    sizes = ((0.1, 0.015, 0.008), (0.03, 0.03, 0.03), (0.1, 0.015, 0.03))
    for size, bar in zip(sizes, (False, False, True), strict=True):
        low = np.array((0.2, 0.2, 0.1))
        boxes = [deck, block(low, low + size), block((0.7, 0.7, 0.1), (0.72, 0.72, 0.12))]
        mesh = mesh_of(10 * np.concatenate(boxes))
        none = np.zeros(0, np.int32)
        face = find_attached_shells(mesh, none, none).mount(len(deck))
        assert (face is not None) == bar, size
        assert face is None or face < len(deck)
    assert find_attached_shells(mesh, none, none).mount(0) is None, "the deck itself"


def test_a_proposal_has_whole_drawers(
    bundled: tuple[DefaultSession, np.ndarray, dict[int, str]],
) -> None:
    """No tray is a part of its own, and handles go with what they are mounted on."""
    session, labels, parts = bundled
    assert session.asset.mesh is not None
    area = session.asset.mesh.face_areas
    found = propose_parts(session).labels
    for part in parts:
        own = labels == part
        overlap = [
            area[own & (found == p)].sum() / area[own | (found == p)].sum()
            for p in np.unique(found[own])
        ]
        assert max(overlap) > 0.999
    assert found.max() == len(parts)


def test_a_mesh_of_one_shell_has_no_attached_shells() -> None:
    triangles = subdivide(block((0, 0, 0), (1, 0.5, 0.3)), 3)
    session = DefaultSegmenter().encode(Asset("block", mesh_of(triangles)))
    assert len(propose_parts(session).labels) == len(triangles)
    labels = session.segment(Prompts((Click(triangles[0].mean(0), 1, True, 0),))).labels
    assert labels[0] == 1 and hover(session, triangles[0].mean(0), 0)[0]


def test_a_first_click_never_means_the_whole_object(
    bundled: tuple[DefaultSession, np.ndarray, dict[int, str]],
) -> None:
    """Wherever it lands, and what is shown under the pointer is what the click takes."""
    session, _, _ = bundled
    assert session.asset.mesh is not None
    area = session.asset.mesh.face_areas
    center = session.asset.element_centers
    demo = json.loads((EXAMPLES / "cabinet.prompts.json").read_text())
    for click in demo["clicks"][::2]:
        face = int(np.linalg.norm(center - click["position"], axis=1).argmin())
        answer = session.segment(Prompts((Click(click["position"], 1, True, face),))).labels == 1
        assert answer[face]
        assert area[answer].sum() <= 0.9 * area.sum()
        shown = hover(session, center[face], face)
        assert area[shown].sum() <= 0.95 * area.sum()
