"""Quality and behaviour of the default segmenter on a cabinet with known parts."""

import json
from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from model.core.asset import Asset
from model.core.geometry import Mesh
from model.data.procedural.examples import joined
from model.data.procedural.generate import make
from model.segmentation import default
from model.segmentation.default import DefaultSegmenter, DefaultSession
from model.segmentation.mask_features import FEATURE_NAMES, Repeats
from model.segmentation.models import Mlp
from model.segmentation.prompts import (
    Click,
    Prompts,
    Region,
    central,
    deepest,
    iou,
    next_click,
    next_part_click,
)
from model.segmentation.proposals import PartState
from model.segmentation.scores import shipped_moving_scorers, shipped_scorers
from model.segmentation.solver import PartSolver, solver_of
from tests.builders import blocks
from tests.model.demos import EXAMPLES, demo_truth, encoded_demo


@pytest.fixture
def session(cloud_session):
    return cloud_session


def scorer(names, liked: str = "", weight: float = 0.0) -> Mlp:
    """One that likes a feature alone, or nothing."""
    weights = np.array([[weight * (name == liked) for name in names]], np.float32)
    zero = np.zeros(len(names), np.float32)
    return Mlp(names, zero, np.ones_like(zero), ((weights, np.zeros(1, np.float32)),))


def first_liking(solver: PartSolver, liked: str = "", weight: float = 0.0) -> PartSolver:
    return solver.with_first(scorer(solver.describe.names, liked, weight))


def superpoint_at(encoding, *place: float) -> int:
    return int(np.abs(encoding.superpoints.center - place).sum(1).argmin())


def click_at(labelled, element: int, part: int, positive: bool = True) -> Click:
    return Click(labelled.asset.element_centers[element], part, positive, int(element))


def test_a_few_clicks_take_a_door(session, cloud_cabinet):
    points, truth = cloud_cabinet.asset.element_centers, cloud_cabinet.labels == 1
    clicks = [click_at(cloud_cabinet, deepest(points, truth), 1)]
    for _ in range(4):
        answer = session.segment(Prompts(tuple(clicks))).labels == 1
        found = next_click(points, truth, answer)
        if found is None:
            break
        clicks.append(click_at(cloud_cabinet, found[0], 1, found[1]))
    assert iou(session.segment(Prompts(tuple(clicks))).labels == 1, truth) > 0.8


def test_competing_parts_with_two_clicks_each(session, cloud_cabinet):
    points, truth = cloud_cabinet.asset.element_centers, cloud_cabinet.labels
    clicks = [click_at(cloud_cabinet, deepest(points, truth == p), p) for p in (0, 1, 2)]
    for _ in range(3):
        labels = session.segment(Prompts(tuple(clicks))).labels
        found = next_part_click(points, truth, labels)
        assert found is not None
        clicks.append(click_at(cloud_cabinet, found[0], found[1]))
    labels = session.segment(Prompts(tuple(clicks))).labels
    assert np.mean([iou(labels == p, truth == p) for p in (0, 1, 2)]) > 0.85


def test_a_click_that_agrees_changes_nothing(session, cloud_cabinet):
    points, truth = cloud_cabinet.asset.element_centers, cloud_cabinet.labels == 1
    first = click_at(cloud_cabinet, deepest(points, truth), 1)
    before = session.segment(Prompts((first,))).labels
    inside = np.nonzero(before == 1)[0]
    again = click_at(cloud_cabinet, int(inside[len(inside) // 3]), 1)
    assert np.array_equal(session.segment(Prompts((first, again))).labels, before)


def test_a_click_inside_a_region_takes_a_part_of_it(session, cloud_cabinet):
    everything = Region(1, np.arange(len(cloud_cabinet.labels)))
    knob = np.nonzero(
        (cloud_cabinet.labels == 2) & (cloud_cabinet.asset.element_centers[:, 1] < -0.03)
    )[0]
    labels = session.segment(Prompts((everything, click_at(cloud_cabinet, int(knob[0]), 2)))).labels
    assert labels[knob[0]] == 2
    assert set(np.unique(labels)) == {1, 2}


def test_clicks_for_two_parts_in_one_cell_share_it(session, cloud_cabinet):
    """Nodes follow the nearest click."""
    superpoints, points = session.encoding.superpoints, cloud_cabinet.asset.element_centers
    superpoint = int(superpoints.size.argmax())
    nodes = np.nonzero(superpoints.of_node == superpoint)[0]
    along = points[nodes] @ (points[nodes[-1]] - points[nodes[0]])
    low, high = int(nodes[along.argmin()]), int(nodes[along.argmax()])
    for last in (low, high):
        first = low + high - last
        clicks = [click_at(cloud_cabinet, first, 1), click_at(cloud_cabinet, last, 2)]
        labels = session.segment(Prompts(tuple(clicks))).labels
        assert labels[first] == 1 and labels[last] == 2
        nearer = np.linalg.norm(points[nodes] - points[last], axis=1) < np.linalg.norm(
            points[nodes] - points[first], axis=1
        )
        assert np.array_equal(labels[nodes] == 2, nearer)


def test_candidates_differ_from_each_other_and_the_answer(session, cloud_cabinet):
    points, truth = cloud_cabinet.asset.element_centers, cloud_cabinet.labels == 1
    prompts = Prompts((click_at(cloud_cabinet, deepest(points, truth), 1),))
    masks = [session.segment(prompts).labels == 1, *session.candidates(prompts, 1)]
    assert len(masks) >= 3
    for i, first in enumerate(masks):
        for second in masks[:i]:
            assert iou(first, second) < 0.95


def test_many_more_points_than_nodes(make_cabinet_cloud):
    labelled = make_cabinet_cloud(130_000, noise=0.0005)
    session = DefaultSegmenter().encode(labelled.asset)
    assert len(session.encoding.nodes) <= 105_000
    points, truth = labelled.asset.element_centers, labelled.labels == 2
    labels = session.segment(Prompts((click_at(labelled, deepest(points, truth), 2),))).labels
    assert labels.shape == (130_000,) and (labels == 2).any()


def test_the_mesh_is_cut_along_its_edges(mesh_cabinet, mesh_session):
    session = mesh_session
    centers, truth = mesh_cabinet.asset.element_centers, mesh_cabinet.labels
    clicks = [click_at(mesh_cabinet, deepest(centers, truth == p), p) for p in (0, 1, 2)]
    for _ in range(4):
        labels = session.segment(Prompts(tuple(clicks))).labels
        found = next_part_click(centers, truth, labels)
        if found is None:
            break
        clicks.append(click_at(mesh_cabinet, found[0], found[1]))
    labels = session.segment(Prompts(tuple(clicks))).labels
    area = mesh_cabinet.asset.mesh.face_areas
    assert area[labels == truth].sum() > 0.95 * area.sum()


def test_undo_works_after_more_clicks_than_states_are_cached(
    cloud_cabinet, session, monkeypatch
) -> None:
    """The state of a first click is forgotten before that of the second one."""
    monkeypatch.setattr(default, "STATES_CACHED", 4)
    session = DefaultSession(session.asset, session.encoding, session.solver)
    points, truth = cloud_cabinet.asset.element_centers, cloud_cabinet.labels
    door, other = (click_at(cloud_cabinet, deepest(points, truth == p), p) for p in (1, 2))
    both = session.segment(Prompts((door, other))).labels
    session.segment(Prompts((other, door, click_at(cloud_cabinet, 0, 3))))
    assert np.array_equal(session.segment(Prompts((door, other))).labels, both)


def test_progress_rises_and_can_cancel(cloud_cabinet):
    from model.core.progress import Cancelled

    seen: list[float] = []
    DefaultSegmenter().encode(cloud_cabinet.asset, lambda f, _: seen.append(f))
    assert seen == sorted(seen) and seen[-1] == 1.0

    def stop(fraction: float, message: str) -> None:
        if fraction > 0.3:
            raise Cancelled

    with pytest.raises(Cancelled):
        DefaultSegmenter().encode(cloud_cabinet.asset, stop)


def test_a_modelled_panel_is_never_cut_along_its_triangles() -> None:
    """A door of two triangles a side is one part after one click on one of them."""
    import trimesh

    from model.core.asset import Asset
    from model.segmentation.prompts import Click, Prompts
    from model.segmentation.registry import load_segmenter

    boxes = []
    for size, center in (((1, 0.5, 1), (0, 0, 0.5)), ((0.9, 0.02, 0.9), (0, -0.27, 0.5))):
        box = trimesh.creation.box(size)
        box.apply_translation(center)
        boxes.append(box)
    whole = trimesh.util.concatenate(boxes)
    mesh = Mesh(whole.vertices, whole.faces)
    session = load_segmenter().encode(Asset("door", mesh))
    front = np.flatnonzero(mesh.triangles[:, :, 1].max(axis=1) < -0.279)
    assert len(front) == 2
    at = mesh.triangles[front[0]].mean(axis=0)
    labels = session.segment(Prompts((Click(tuple(at), 1, True, int(front[0])),))).labels
    assert (labels[front] == 1).all()


def test_one_click_takes_a_key_of_a_keyboard() -> None:
    """Keys are a thousandth of the object, and there are dozens: every click must count."""
    mesh, part = joined(make("Keyboard", 3).object)
    asset = Asset("keyboard", mesh=mesh)
    keys = np.unique(part)[1:][::9][:6]
    session = DefaultSegmenter().encode(asset)
    found = []
    for key in keys:
        truth = part == key
        face = deepest(asset.element_centers, truth)
        click = Click(asset.element_centers[face], 1, True, int(face))
        found.append(iou(session.segment(Prompts((click,))).labels == 1, truth))
    assert np.median(found) > 0.9


def test_what_comes_again_is_counted() -> None:
    """Eight studs on a plate: each has seven others like it, the plate has none."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(2.0))
    low = np.stack([x.ravel(), y.ravel(), np.zeros(8)], axis=1)
    mesh, _ = blocks(*((p, p + (0.5, 0.5, 0.4)) for p in low), ((-1, -1, -0.2), (5, 3, -0.01)))
    encoding = DefaultSegmenter().encode(Asset("studs", mesh=mesh)).encoding
    superpoints = encoding.superpoints
    corner, diagonal = superpoints.center.min(0), np.linalg.norm(np.ptp(superpoints.center, axis=0))
    at = (superpoints.center - corner) / diagonal
    share = superpoints.size / superpoints.size.sum()
    stud = (np.abs(superpoints.center[:, :2] - low[0, :2] - 0.25) < 0.3).all(1) & (
        superpoints.center[:, 2] > -0.005
    )
    moments = np.concatenate([np.ones((len(at), 1)), at, at**2], axis=1) * share[:, None]
    sums = np.stack([moments[stud].sum(0), moments[superpoints.center[:, 2] < -0.005].sum(0)])
    counted = np.expm1(Repeats(superpoints, encoding.hierarchy, at)(sums))
    assert counted[0] >= 5 and counted[1] == 0


def test_a_handle_goes_with_the_door_it_is_mounted_on() -> None:
    """Whoever clicks the door means its handle too, unless a click says otherwise."""
    mesh, of = blocks(
        ((-0.5, -0.25, 0), (0.5, 0.25, 1)),
        ((-0.45, -0.29, 0.05), (0.45, -0.26, 0.95)),
        ((0.3, -0.3, 0.4), (0.32, -0.29, 0.42)),
        ((0.3, -0.3, 0.58), (0.32, -0.29, 0.6)),
        ((0.29, -0.33, 0.38), (0.33, -0.3, 0.62)),
        ((-0.4, 0.25, 0.4), (-0.3, 0.27, 0.5)),
    )
    session = DefaultSegmenter().encode(Asset("door", mesh))
    front = int(np.flatnonzero((of == 1) & (mesh.triangles[:, :, 1].max(1) < -0.28))[0])
    at = mesh.triangles.mean(1)
    door = Click((float(at[front, 0]), float(at[front, 1]), float(at[front, 2])), 1, True, front)
    panel = Region(1, np.flatnonzero(of == 1))
    labels = session.segment(Prompts((panel, door))).labels
    assert [set(labels[of == k]) for k in range(6)] == [{0}, {1}, {1}, {1}, {1}, {0}]
    bar = int(np.flatnonzero(of == 4)[0])
    other = Click((float(at[bar, 0]), float(at[bar, 1]), float(at[bar, 2])), 2, True, bar)
    labels = session.segment(Prompts((panel, door, other))).labels
    assert set(labels[of == 4]) == {2} and set(labels[of == 1]) == {1}


@pytest.fixture(scope="module")
def bundled() -> tuple[DefaultSession, np.ndarray, dict]:
    """The bundled cabinet, encoded, the true part of each face, and what is told of the parts."""
    return encoded_demo("cabinet"), *demo_truth("cabinet")


def test_tab_shows_masks_that_differ_and_whole_drawers(bundled) -> None:
    """A click on each drawer's front takes its handle along, and the tray is behind Tab."""
    session, labels, truth = bundled
    center, area = session.asset.element_centers, session.asset.mesh.face_areas

    def overlap(one: np.ndarray, other: np.ndarray) -> float:
        return float(area[one & other].sum() / area[one | other].sum())

    drawers = [p["id"] for p in truth["parts"] if p["name"] == "drawer"]
    assert len(drawers) == 3
    for drawer in drawers:
        own = labels == drawer
        handle = own & (center[:, 1] < center[own, 1].min() + 0.03)
        front = own & (np.abs(center[:, 1] + 0.24) < 1e-4)
        middle = np.median(center[front], axis=0) - (0.12, 0, 0)
        spot = int(np.where(front, np.linalg.norm(center - middle, axis=1), np.inf).argmin())
        clicked = Prompts((Click(center[spot], 1, True, spot),))
        answer = session.segment(clicked).labels == 1
        assert answer[handle].all()
        shown = [answer, *session.candidates(clicked, 1)]
        assert max(overlap(mask, own) for mask in shown) > 0.95
        for i, mask in enumerate(shown):
            assert area[mask].sum() < 0.99 * area.sum()
            assert all(overlap(mask, other) < 0.9 for other in shown[:i])


def test_the_last_door_is_as_good_as_the_first(bundled) -> None:
    """Clicks on other parts don't make a first click take all that is left."""
    session, labels, _truth = bundled
    center, area = session.asset.element_centers, session.asset.mesh.face_areas
    table = """-0.4201 -0.2324 0.4439   -0.0170 -0.2400 0.5951   -0.1106 -0.2400 0.4426
        -0.1107 -0.2400 0.2302   0.4350 -0.2320 0.4240"""
    spots = np.array(table.split(), float).reshape(-1, 3)
    clicks, met = [], set()
    for part, spot in enumerate(spots, 1):
        clicks.append(Click(spot, part))
        own = session.segment(Prompts(tuple(clicks))).labels == part
        nearest = int(np.where(own, np.linalg.norm(center - spot, axis=1), np.inf).argmin())
        taken = np.bincount(labels[own], area[own], 6)
        met.add(labels[nearest])
        assert taken[labels[nearest]] > 0.97 * area[own].sum(), f"part {part} takes {taken}"
    assert met == {1, 2, 3, 4, 5}


def test_a_first_click_leaves_something_of_what_others_left(session) -> None:
    """However large the scorer wants it: what nobody claims is the base that the part moves on."""
    encoding, greedy = session.encoding, scorer(FEATURE_NAMES, "log_size", 3.0)
    solver = PartSolver(encoding.superpoints, encoding.hierarchy, encoding.walk, greedy, None)
    taken = encoding.superpoints.center[:, 0] < 0.5
    free = float(encoding.superpoints.size[~taken].sum())
    for place in ((0.75, -0.02, 0.4), (0.99, 0.25, 0.4), (0.75, 0.25, 0.8)):
        best = solver.answer(PartState(), superpoint_at(encoding, *place), True, taken).best
        assert not best[taken].any()
        assert encoding.superpoints.size[best].sum() < 0.95 * free


def test_a_first_click_on_a_mesh_seldom_means_most_of_it(mesh_session) -> None:
    """A scorer that hesitates between a shell and the whole gets the shell."""
    encoding, solver = mesh_session.encoding, first_liking(mesh_session.solver, "log_size", 0.5)
    size, door = encoding.superpoints.size, superpoint_at(encoding, 0.25, -0.02, 0.4)
    best = solver.answer(PartState(), door, True, None).best
    assert best[door] and size[best].sum() < 0.6 * size.sum()


def test_a_first_click_beside_others_seldom_means_most_of_a_scan(session) -> None:
    """Alone it may: the base of a scan is asked for as well."""
    encoding, solver = session.encoding, first_liking(session.solver, "log_size", 1.0)
    size, door = encoding.superpoints.size, superpoint_at(encoding, 0.25, -0.02, 0.4)
    alone = solver.answer(PartState(), door, True, None, moving=False).best
    assert size[alone].sum() > 0.7 * size.sum()
    taken = np.zeros(len(size), bool)
    taken[superpoint_at(encoding, 0.9, 0.5, 0.1)] = True
    best = solver.answer(PartState(), door, True, taken, moving=False).best
    assert best[door] and size[best].sum() < 0.6 * size.sum()


def test_a_first_click_means_no_speck(session) -> None:
    """However much the scorer likes small masks: nobody clicks for a handful of points."""
    encoding, solver = session.encoding, first_liking(session.solver, "log_size", -0.5)
    size, door = encoding.superpoints.size, superpoint_at(encoding, 0.25, -0.02, 0.4)
    found = solver.answer(PartState(), door, True, None, moving=False)
    held = found.proposals.masks @ size
    assert held.min() < 16 < size[found.best].sum() < 0.1 * size.sum()


def test_of_equally_likely_masks_no_detail_is_meant(session) -> None:
    encoding, solver = session.encoding, first_liking(session.solver)
    door = int(np.abs(encoding.nodes.points - (0.25, -0.02, 0.4)).sum(1).argmin())
    best = solver.answer(PartState(), int(encoding.superpoints.of_node[door]), True, None).best
    assert encoding.superpoints.size[best].sum() > 0.018 * encoding.superpoints.size.sum()


@pytest.fixture
def stubborn(session) -> PartSolver:
    """A solver whose scorer would rather keep the mask."""
    encoding, keeps = session.encoding, scorer(FEATURE_NAMES, "from_keep", 2.0)
    return PartSolver(encoding.superpoints, encoding.hierarchy, encoding.walk, None, keeps)


def test_clicks_in_vain_make_the_next_one_count(session, stubborn) -> None:
    """The scorer is heard at first, not for ever."""
    encoding, solver = session.encoding, stubborn
    everything = np.ones(len(encoding.superpoints), bool)
    body, door = (superpoint_at(encoding, *p) for p in ((0.0, 0.25, 0.4), (0.25, -0.02, 0.4)))
    state = PartState((door,), tuple(range(8)), everything)

    def lost(state: PartState) -> float:
        answer = solver.answer(state, body, False, None)
        gone = encoding.superpoints.size[~answer.best].sum()
        return float(gone / encoding.superpoints.size.sum())

    assert lost(state) < 0.01
    for _ in range(3):
        state = solver.moved(state, body, False, everything)
    assert state.ineffective == 3
    assert lost(state) > 0.1
    assert (
        solver.moved(state, body, False, encoding.superpoints.center[:, 0] < 0.5).ineffective == 0
    )


def test_a_click_far_from_a_small_mask_means_more_than_a_speck(session, stubborn) -> None:
    encoding, solver = session.encoding, stubborn
    knob = np.linalg.norm(encoding.superpoints.center - (0.42, -0.05, 0.37), axis=1) < 0.04
    assert knob.any()
    first = int(np.nonzero(knob)[0][0])
    door = int(np.abs(encoding.superpoints.center - (0.2, -0.02, 0.4)).sum(1).argmin())
    before = tuple(int(c) for c in np.nonzero(encoding.superpoints.center[:, 0] > 0.5)[0][:8])
    answer = solver.answer(PartState((first,), before, knob), door, True, None)
    gained = encoding.superpoints.size[answer.best & ~knob].sum()
    assert gained > 3 * encoding.superpoints.size[door], gained


def test_a_mask_that_was_chosen_is_kept_by_the_next_click() -> None:
    """Tab, then a click on what is still wrong, must not bring back what Tab had left behind."""
    session, (labels, _) = encoded_demo("oven_scan"), demo_truth("oven_scan")
    points = session.asset.element_centers
    door, known, rng = labels == 1, labels >= 0, np.random.default_rng(0)

    def click(index: int, positive: bool = True) -> Click:
        return Click(points[index], 1, positive, int(index))

    after, refused = [], 0
    for _ in range(14):
        items: list[Click | Region] = [click(central(points, door, rng))]
        first = session.segment(Prompts(tuple(items))).labels == 1
        others = session.candidates(Prompts(tuple(items)), 1)
        best = max(others, key=lambda m: iou(m & known, door))
        before = iou(best & known, door)
        if before < 0.4:
            continue
        items.append(Region(1, np.nonzero(first & ~best)[0], False))
        items.append(Region(1, np.nonzero(best & ~first)[0]))
        found = next_click(points, door, best & known)
        assert found is not None
        items.append(click(*found))
        refused += not found[1]
        mask = session.segment(Prompts(tuple(items))).labels == 1
        after.append(iou(mask & known, door) - before)
    assert refused >= 1
    assert min(after) > -0.02, after


def test_one_kind_of_click_again_and_again_counts_as_in_vain(session, cloud_cabinet) -> None:
    solver, size = session.solver, session.encoding.superpoints.size
    points, truth = cloud_cabinet.asset.element_centers, cloud_cabinet.labels == 1
    door = int(session.encoding.superpoints.of_node[deepest(points, truth)])
    wide = solver.regions.nested(door).masks
    masks = wide[np.argsort(wide @ size)[[2, len(wide) // 3, len(wide) // 2]]]
    state = solver.moved(PartState(), door, True, masks[0])
    assert state.streak == 0
    for mask, run in ((masks[1], 1), (masks[2], 2), (masks[1], 3)):
        state = solver.moved(state, door, True, mask)
        assert state.streak == run and state.ineffective == 0
    assert solver.moved(state, door, False, masks[0]).streak == -1
    barely = state.mask.copy()
    barely[door] = False
    nothing = np.zeros(1, np.float32)

    def against(run: int) -> float:
        known = replace(state, streak=run)
        return float(
            solver.penalties.of_later(
                solver.superpoints, known, door, False, barely[None], nothing
            )[0]
        )

    assert against(-6) > against(-1) + 1
    assert against(6) == against(-1)


def test_what_is_taken_away_leaves_no_speck(session, cloud_cabinet) -> None:
    solver, superpoints = session.solver, session.encoding.superpoints
    points, truth = cloud_cabinet.asset.element_centers, cloud_cabinet.labels == 1
    door = int(superpoints.of_node[deepest(points, truth)])
    wide = solver.regions.nested(door).masks
    mask = wide[np.argsort(wide @ superpoints.size)[len(wide) // 2]]
    state = solver.moved(PartState(), door, True, mask)
    small = np.argsort(np.where(mask, superpoints.size, np.inf))[:30]
    kept = np.zeros((30, len(superpoints)), bool)
    kept[np.arange(30), small] = True
    kept = np.maximum.accumulate(kept)
    against = solver.penalties.of_later(
        superpoints, state, door, False, kept, np.ones(30, np.float32)
    )
    left = kept @ superpoints.size
    assert (left < 16).any() and (left > 16).any()
    expected = np.clip(3 * np.log(16 / left), 0, 9)
    np.testing.assert_allclose(against - against[-1], expected, atol=0.1)


def test_a_click_beside_the_border_means_what_is_there(session, cloud_cabinet) -> None:
    solver, superpoints = session.solver, session.encoding.superpoints
    points, truth = cloud_cabinet.asset.element_centers, cloud_cabinet.labels == 1
    door = int(superpoints.of_node[deepest(points, truth)])
    wide = solver.regions.nested(door).masks
    mask = wide[np.argsort(wide @ superpoints.size)[len(wide) // 2]]
    links = superpoints.links
    edge = int(links.b[mask[links.a] & ~mask[links.b]][0])
    state = solver.moved(PartState(), door, True, mask)

    def scores(penalty: float) -> tuple[np.ndarray, np.ndarray]:
        other = copy(solver)
        other.penalties = replace(solver.penalties, far=penalty)
        answer = other.answer(state, edge, True, None)
        return answer.proposals.masks, answer.scores

    masks, free = scores(0.0)
    same, fell = scores(0.3)
    assert np.array_equal(masks, same)
    apart = ((superpoints.center - superpoints.center[edge]) ** 2).sum(1)
    near = superpoints.size[apart < apart[mask].min()].sum()
    large = (masks ^ mask) @ superpoints.size > 10 * near
    assert 0 < large.sum() < len(large) and np.array_equal(free > fell + 1e-6, large)
    assert (free - fell).max() <= 0.9 + 1e-5


def test_a_mask_that_held_too_much_bounds_the_ones_to_come(session, cloud_cabinet) -> None:
    solver, encoding = session.solver, session.encoding
    size = encoding.superpoints.size
    points, truth = cloud_cabinet.asset.element_centers, cloud_cabinet.labels == 1
    door = int(encoding.superpoints.of_node[deepest(points, truth)])
    wide = solver.regions.nested(door).masks
    mask = wide[np.argsort(wide @ size)[len(wide) // 2]]
    own = float(size[mask].sum())
    superpoint = int(np.nonzero(~mask)[0][0])
    state = solver.moved(PartState(), door, True, mask)
    assert state.least == 0 and np.isinf(state.most)

    def scores(known: PartState) -> dict[bytes, float]:
        answer = solver.answer(known, superpoint, True, None)
        pairs = zip(answer.proposals.masks, answer.scores, strict=True)
        return {m.tobytes(): float(s) for m, s in pairs}

    free, bound = scores(state), scores(replace(state, most=2 * own))
    fell = {key for key in free if free[key] > bound[key] + 1e-4}
    large = {key for key in free if size[np.frombuffer(key, bool)].sum() > 2 * own}
    assert large and fell == large
    # A click that says the mask is too small after one that called nearly the same too large:
    # whoever clicks so mends what comes next, and only the last click counts.
    odd = replace(state, most=1.1 * own)
    assert scores(odd) == free
    after = solver.moved(odd, superpoint, True, mask)
    assert after.least == own and np.isinf(after.most)


def test_clicks_that_agree_do_not_hold_the_mask_as_it_is() -> None:
    """The clicks beside the bundled oven: five within the middle of its door, then its frame."""
    encoded, (labels, _) = encoded_demo("oven_scan"), demo_truth("oven_scan")
    encoding = encoded.encoding
    solver = solver_of(encoding, *shipped_scorers("cloud"), shipped_moving_scorers())
    points = encoding.superpoints
    size, center = points.size, points.center
    elements = encoding.nodes.elements.element_of_node
    door = np.bincount(points.of_node, labels[elements] == 1) > np.bincount(points.of_node) / 2
    low, high = center[door].min(0), center[door].max(0)
    away = np.abs(center - (low + high) / 2) / np.maximum(high - low, 1e-9)
    middle = door & (away[:, [0, 2]] <= 0.3).all(1)
    told = json.loads((EXAMPLES / "oven_scan.prompts.json").read_text())["clicks"]
    clicked = [superpoint_at(encoding, *c["position"]) for c in told if c["part"] == 1]
    inside = tuple(s for s in clicked if middle[s])
    frame = next(s for s in clicked if door[s] and not middle[s])

    def reached(confirmed: int) -> float:
        state = PartState(inside, mask=middle, confirmed=(confirmed, 0))
        best = solver.answer(state, frame, True, None).best
        return float(size[best & door].sum() / size[best | door].sum())

    assert len(inside) == 5 and reached(4) > max(0.8, reached(0) + 0.1)
