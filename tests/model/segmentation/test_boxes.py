"""Boxes round clicked regions: a drawer is found with the tray behind its front."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from model.core.asset import Asset
from model.core.geometry import Mesh, PointCloud
from model.geometry.sampling import sample_surface
from model.segmentation.default import DefaultSegmenter
from model.segmentation.encoding import encode
from model.segmentation.graph import shipped_edge_model
from model.segmentation.mask_features import ClickContext
from model.segmentation.plane_boxes import BoxGrid, PlaneBoxes, main_directions
from model.segmentation.prompts import Click, Prompts
from model.segmentation.proposals import CorrectiveClick, PartState, Proposals
from model.segmentation.solver import PartSolver, solver_of
from tests.builders import blocks, spans

DRAWER = 2
"""The middle one of three."""


def chest() -> tuple[Mesh, np.ndarray]:
    """A chest of three drawers, trays included, and the part of each face; 0 is the carcass."""
    made = spans(
        "0 0 0 .02 .5 .6  .78 0 0 .8 .5 .6  0 .48 0 .8 .5 .6  0 0 0 .8 .5 .02  0 0 .58 .8 .5 .6"
    )
    tray = """.01 -.02 0 .79 0 .185  .03 0 .01 .77 .45 .02  .03 0 .01 .04 .45 .15
        .76 0 .01 .77 .45 .15  .03 .44 .01 .77 .45 .15"""
    parts = [0] * len(made)
    for drawer, z in enumerate((0.02, 0.21, 0.40), start=1):
        made += [(np.add(low, (0, 0, z)), np.add(high, (0, 0, z))) for low, high in spans(tray)]
        parts += [drawer] * 5
    mesh, of = blocks(*made)
    return mesh, np.array(parts)[of]


@pytest.fixture(scope="module")
def drawers():
    mesh, part = chest()
    turned = Mesh(mesh.vertices @ Rotation.from_euler("z", 0.4).as_matrix().T, mesh.faces)
    cloud, face = sample_surface(turned, 40_000, np.random.default_rng(0))
    encoding = encode(Asset("chest", cloud=cloud), shipped_edge_model())
    return encoding, part[np.asarray(face)]


def overlap(mask, encoding, truth) -> float:
    of_node = mask[encoding.superpoints.of_node]
    return float((of_node & truth).sum() / (of_node | truth).sum())


def cell_at(encoding, labels, spot) -> int:
    """A cell of the drawer near a place in the chest's own frame."""
    at = Rotation.from_euler("z", 0.4).as_matrix() @ np.asarray(spot, float)
    own = np.nonzero(labels == DRAWER)[0]
    node = own[np.linalg.norm(encoding.nodes.points[own] - at, axis=1).argmin()]
    return int(encoding.superpoints.of_node[node])


def best(solver, drawers, superpoints) -> float:
    """Best overlap on offer after positive clicks, the front's own region being the first mask."""
    encoding, labels = drawers
    truth = labels == DRAWER
    state, found = PartState(), 0.0
    for superpoint in superpoints:
        answer = solver.answer(state, superpoint, True, None)
        all_ = [overlap(m, encoding, truth) for m in answer.proposals.masks]
        found = max(all_)
        state = solver.moved(state, superpoint, True, answer.proposals.masks[int(np.argmax(all_))])
    return found


def test_a_drawer_is_on_offer_after_its_front_and_its_back(drawers) -> None:
    encoding, labels = drawers
    made = (encoding.superpoints, encoding.hierarchy, encoding.walk, None, None)
    superpoints = [cell_at(encoding, labels, s) for s in ((0.4, -0.02, 0.3), (0.4, 0.44, 0.3))]
    with_boxes = best(solver_of(encoding, None, None), drawers, superpoints)
    assert with_boxes > 0.75
    assert with_boxes > best(PartSolver(*made), drawers, superpoints) + 0.1


def test_a_negative_click_cuts_along_a_plane(drawers) -> None:
    """The carcass with a drawer by mistake: a click on the drawer takes all of that off."""
    encoding, labels = drawers
    solver = solver_of(encoding, None, None)
    chosen = np.isin(labels, (1, 2))
    mask = np.bincount(encoding.superpoints.of_node, chosen, len(encoding.superpoints)) > 0.5 * (
        encoding.superpoints.size
    )
    front = cell_at(encoding, labels, (0.4, -0.02, 0.3))
    below = int(encoding.superpoints.of_node[np.nonzero(labels == 1)[0][0]])
    state = PartState((below,), (), mask)
    answer = solver.answer(state, front, False, None)
    assert max(overlap(m, encoding, labels == 1) for m in answer.proposals.masks) > 0.9


def test_on_a_mesh_boxes_give_whole_shells() -> None:
    """A drawer's front, then its tray: the drawer to the last face, without the carcass."""
    mesh, part = chest()
    asset = Asset("chest", mesh=mesh)
    encoding = encode(asset, shipped_edge_model())
    labels = part[encoding.nodes.elements.element_of_node]
    of_node = encoding.superpoints.of_node
    solver = solver_of(encoding, None, None)
    spots = encoding.nodes.points
    front, back = (
        int(of_node[np.linalg.norm(spots - at, axis=1).argmin()])
        for at in ((0.4, -0.02, 0.3), (0.4, 0.44, 0.3))
    )
    panel = (spots[:, 1] < 0.001) & (labels == DRAWER)
    mask = np.bincount(of_node, panel, len(encoding.superpoints)) > 0.5 * encoding.superpoints.size
    state = PartState((front,), (), mask)
    answer = solver.answer(state, back, True, None)
    assert max(overlap(m, encoding, labels == DRAWER) for m in answer.proposals.masks) > 0.99


def test_features_have_their_names_and_are_finite(drawers) -> None:
    encoding, labels = drawers
    solver = solver_of(encoding, None, None)
    superpoint = cell_at(encoding, labels, (0.4, -0.02, 0.3))
    first = solver.answer(PartState(), superpoint, True, None, moving=False)
    later = solver.answer(
        PartState((superpoint,), (), first.best), int(labels.argmin()), False, None, moving=False
    )
    for answer in (first, later):
        assert answer.features.shape == (len(answer.proposals), len(solver.describe.names))
        assert np.isfinite(answer.features).all()


def feature(solver: PartSolver, masks, clicked: ClickContext, name: str) -> list[float]:
    found = solver.describe(Proposals.of(list(masks), "keep"), clicked)
    return found[:, solver.describe.names.index(name)].tolist()


def test_features_say_on_which_side_of_the_clicks_a_mask_lies(drawers) -> None:
    """Halves of the chest, told by a click in the middle of each."""
    superpoints, solver = drawers[0].superpoints, solver_of(drawers[0], None, None)
    at = superpoints.center @ Rotation.from_euler("z", 0.4).as_matrix()
    across = at[:, 0]
    left, right = (int(np.linalg.norm(at - [x, 0.25, 0.3], axis=1).argmin()) for x in (0.2, 0.6))
    masks = np.stack([across < 0.4, across > 0.4, across < 9])
    clicked = ClickContext((left,), (right,), right, False, masks[2])
    near = feature(solver, masks, clicked, "near_negatives")
    size = superpoints.size
    beyond = float(size[across > 0.4].sum() / size.sum())
    assert near[0] < 0.2 and near[1] > 0.8 and near[2] == pytest.approx(beyond, abs=0.15)

    both = ClickContext((left, right), (), right, True, masks[0])
    held = feature(solver, masks, both, "between_positives")
    assert held[2] == 1 and held[0] + held[1] == pytest.approx(1, abs=0.05)
    assert feature(solver, masks, both, "near_negatives") == [0, 0, 0]
    alone = ClickContext((left,), (), left, True)
    assert feature(solver, masks, alone, "between_positives") == [1, 1, 1]


def test_a_first_click_in_the_middle_is_deep_in_what_it_means(drawers) -> None:
    superpoints, solver = drawers[0].superpoints, solver_of(drawers[0], None, None)
    at = superpoints.center @ Rotation.from_euler("z", 0.4).as_matrix()
    half = at[:, 0] < 0.4
    middle, edge = (
        int(np.where(half, np.linalg.norm(at - [x, 0.25, 0.3], axis=1), 9).argmin())
        for x in (0.05, 0.38)
    )
    (deep,), (shallow,) = (
        feature(solver, half[None], ClickContext((c,), (), c, True), "first_deepest")
        for c in (middle, edge)
    )
    assert -0.5 < deep <= 1 and shallow < deep - 1


def test_what_was_clicked_before_tells_masks_apart(drawers) -> None:
    """The chest's left half is meant; a first answer took the right one along, and two clicks in
    the middle of what was too much were needed.
    """
    superpoints, solver = drawers[0].superpoints, solver_of(drawers[0], None, None)
    at = superpoints.center @ Rotation.from_euler("z", 0.4).as_matrix()
    across = at[:, 0]

    def nearest(x: float, low: float, high: float) -> int:
        far = np.linalg.norm(at - [x, 0.25, 0.3], axis=1)
        return int(np.where((across > low) & (across < high), far, 9).argmin())

    left, right, edge = nearest(0.05, 0, 0.4), nearest(0.75, 0.4, 0.8), nearest(0.42, 0.4, 0.8)
    meant, all_ = across < 0.4, across < 9
    without_edge = all_ & ~((across > 0.72) & (at[:, 2] > 0.2))
    without_edge[right] = False
    masks = np.stack([meant, without_edge])
    first = CorrectiveClick(left, True, np.zeros(len(superpoints), bool))
    clicked = ClickContext((left,), (right,), right, False, all_, corrections=(first,))
    deepest = feature(solver, masks, clicked, "change_deepest")
    assert deepest[0] > -0.5 and deepest[0] >= deepest[1]
    # The same click when only a strip beside it would have been wrong: not in its middle.
    beside = ClickContext((left,), (edge,), edge, False, all_, corrections=(first,))
    assert feature(solver, masks, beside, "change_deepest")[0] < deepest[0] - 0.5
    # Something was missing, says a click. Of the half more was too much then; of all nothing was.
    missing = ClickContext((right, left), (), left, True, across > 0.3)
    other = feature(solver, np.stack([meant, all_]), missing, "change_other")
    assert -1 < other[0] < 0 and other[1] == 4
    # What an earlier click says stays, whatever the last one is.
    both, before = (first, CorrectiveClick(right, False, all_)), all_ & ~(across > 0.72)
    second = ClickContext((left,), (right, edge), edge, False, before, corrections=both)
    worst = feature(solver, masks, second, "past_deepest_worst")
    alone = feature(solver, masks, replace(second, corrections=(first,)), "past_deepest_worst")
    assert all(w <= a + 1e-6 for w, a in zip(worst, alone, strict=True)) and worst != alone


def test_states_remember_the_masks_that_clicks_were_to_change(drawers) -> None:
    encoding, labels = drawers
    solver = solver_of(encoding, None, None)
    a = cell_at(encoding, labels, (0.4, -0.02, 0.3))
    b = cell_at(encoding, labels, (0.4, -0.02, 0.1))
    state, masks = PartState(), []
    for superpoint, positive in ((a, True), (b, False)):
        found = solver.answer(state, superpoint, positive, None)
        masks.append(
            np.zeros(len(encoding.superpoints), bool) if state.mask is None else state.mask
        )
        state = solver.moved(state, superpoint, positive, found.best)
    assert [(s.superpoint, s.positive) for s in state.corrections] == [(a, True), (b, False)]
    assert all(np.array_equal(s.before, m) for s, m in zip(state.corrections, masks, strict=True))


def test_contents_hold_what_bounds_were_taken_of(drawers) -> None:
    boxes = BoxGrid(drawers[0].superpoints)
    truth = drawers[1] == DRAWER
    mask = np.bincount(drawers[0].superpoints.of_node, truth, len(drawers[0].superpoints)) > 0
    low, high = boxes.bounds(mask[None])
    held = boxes.contents(low, high)[0]
    size = drawers[0].superpoints.size
    # All but the hundredth that is trimmed at each of six ends.
    assert size[held & mask].sum() > 0.93 * size[mask].sum()
    assert (high > low).all()
    side = (high - low + 1)[0] * boxes.step
    assert sorted(side.round(1)) == [0.2, 0.5, 0.8]


def test_behind_a_front_a_box_ends_at_the_back(drawers) -> None:
    boxes = BoxGrid(drawers[0].superpoints)
    points = drawers[0].superpoints.center @ Rotation.from_euler("z", 0.4).as_matrix()
    front = (points[:, 1] < 0.002) & (abs(points[:, 2] - 0.3) < 0.08)
    low, high = boxes.behind(*boxes.bounds(front[None]), 4)
    depth = ((high - low + 1) * boxes.step).min(1)
    assert len(low) and any(abs(d - 0.47) < 0.03 for d in ((high - low + 1) * boxes.step).ravel())
    assert (depth > 0.02).all()


@settings(max_examples=25)
@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_main_directions_turn_with_the_object(angles) -> None:
    turn = Rotation.from_euler("xyz", angles).as_matrix()
    normal = np.repeat(np.eye(3), (60, 40, 20), axis=0)
    axes = main_directions(normal @ turn.T, np.ones(len(normal)))
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    assert np.allclose(np.sort(np.abs(axes @ turn), axis=1), [[0, 0, 1]] * 3, atol=1e-6)


@pytest.mark.parametrize("normal", [np.zeros((0, 3)), np.zeros((5, 3)), np.eye(3)[:1]])
def test_without_directions_the_axes_of_the_frame_stay(normal) -> None:
    axes = main_directions(normal, np.ones(len(normal)))
    assert np.allclose(np.sort(np.abs(axes), axis=1), [[0, 0, 1]] * 3)


def test_clicks_leave_the_boxes_between_planes_that_hold_them(drawers) -> None:
    superpoints, labels = drawers[0].superpoints, drawers[1]
    grid = BoxGrid(superpoints)
    planes = grid.between_planes(superpoints)
    held = grid.contents(planes.low.T[::50], planes.high.T[::50], 0) @ superpoints.size
    assert np.allclose(held / superpoints.size.sum(), planes.share[::50], atol=1e-6)
    inner, outer = (int(superpoints.of_node[np.nonzero(labels == p)[0][50]]) for p in (1, 3))
    place = grid.place.astype(np.int16)
    before = planes.holding(place[:, [inner]], place[:, []])
    after = planes.holding(place[:, [inner]], place[:, [outer]])
    assert 0 < len(after.share) < len(before.share) < len(planes.share)
    inside = grid.contents(after.low.T, after.high.T, 0)
    assert inside[:, inner].all() and not inside[:, outer].any()
    apart = before.apart(6)
    overlaps = np.stack([apart.overlap(*c) for c in zip(apart.low.T, apart.high.T, strict=True)])
    assert np.allclose(np.diagonal(overlaps), 1) and (overlaps - np.eye(6)).max() < 0.66
    sizes = np.floor(np.log(before.of_all_sizes(6).share) / 0.3)
    assert len(set(sizes.tolist())) == len(sizes)


def test_overlap_of_volumes() -> None:
    low, high = (
        np.array([[0, 5, 20], [0, 0, 0], [0, 0, 0]]),
        np.array([[9, 14, 29], [9] * 3, [9] * 3]),
    )
    boxes = PlaneBoxes(low.astype(np.int16), high.astype(np.int16), np.ones(3, np.float32))
    one = np.zeros(3, np.int16), np.full(3, 9, np.int16)
    assert np.allclose(boxes.overlap(*one), [1, 1 / 3, 0])
    none = boxes.take(np.zeros(0, np.int64))
    assert not any(len(b.share) for b in (none.apart(3), none.of_all_sizes(3)))
    assert not len(none.overlap(*one))


def test_an_object_without_planes_has_no_boxes_and_is_answered() -> None:
    """A ball: nothing faces along a direction for long."""
    points = np.random.default_rng(0).normal(size=(3000, 3))
    points = (points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)
    session = DefaultSegmenter().encode(Asset("ball", cloud=PointCloud(points)))
    x, y, z = points[0].tolist()
    assert (session.segment(Prompts((Click((x, y, z), 1, True, 0),))).labels == 1).any()
