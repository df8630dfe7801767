"""Masks by other means than clicks."""

import numpy as np
import pytest
import trimesh

from model.core.asset import Asset
from model.core.errors import GeometryError, PromptError
from model.core.geometry import Mesh, PointCloud
from model.data.procedural.examples import EXAMPLES
from model.data.simulated.depth_camera import ReconstructionSettings, reconstruct_scan
from model.data.simulated.primitives import block
from model.geometry.cleaning import OBJECT
from model.geometry.crop import crop, floor_and_walls, largest_component, outliers
from model.geometry.prepare import moved
from model.segmentation.all_parts import absorb_small_components, propose_parts
from model.segmentation.default import DefaultSegmenter
from model.segmentation.mask_tools import (
    connected,
    connected_components,
    grow,
    hover,
    line_cut,
    rectangle_cut,
)
from model.segmentation.prompts import iou
from model.segmentation.similar import mirrored, same_shape


@pytest.fixture
def session(cloud_session):
    return cloud_session


def sampled(boxes, count: int, seed: int = 0):
    """Points on the boxes' surfaces, by area, and the box of each."""
    rng = np.random.default_rng(seed)
    t = np.concatenate([block(low, high) for low, high in boxes])
    which = np.repeat(np.arange(len(boxes)), 12)
    area = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    face = rng.choice(len(t), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    points = t[face, 0] + u * (t[face, 1] - t[face, 0]) + v * (t[face, 2] - t[face, 0])
    return points, which[face]


@pytest.fixture(scope="module")
def keypad():
    """A slab with six equal buttons and a long one, all standing proud."""
    boxes = [((0, 0, 0), (0.4, 0.3, 0.03))]
    for i in range(3):
        for j in range(2):
            x, y = 0.06 + 0.11 * i, 0.05 + 0.1 * j
            boxes.append(((x, y, 0.031), (x + 0.05, y + 0.05, 0.06)))
    boxes.append(((0.05, 0.24, 0.031), (0.35, 0.28, 0.06)))
    points, label = sampled(boxes, 30_000)
    asset = Asset("keypad", cloud=PointCloud(points))
    return DefaultSegmenter().encode(asset), label


def test_hover_is_what_a_first_click_takes(session, cloud_cabinet):
    from model.segmentation.prompts import Click, Prompts

    element = int(np.nonzero(cloud_cabinet.labels == 1)[0][40])
    position = cloud_cabinet.asset.element_centers[element]
    clicked = session.segment(Prompts((Click(tuple(map(float, position)), 1, True, element),)))
    assert np.array_equal(hover(session, position, element), clicked.labels == 1)


def test_connected_stops_at_the_gap():
    points, label = sampled([((0, 0, 0), (1, 1, 1)), ((1.2, 0, 0), (2, 1, 1))], 20_000)
    session = DefaultSegmenter().encode(Asset("two", cloud=PointCloud(points)))
    mask = connected(session, (0.5, 0.5, 1.0)).mask
    assert iou(mask, label == 0) > 0.999
    both = connected_components(session, np.ones(len(points), bool))
    assert sorted(m.sum() for m in both) == sorted(np.bincount(label))


def test_connected_on_a_mesh_is_the_shell(mesh_session):
    mask = connected(mesh_session, (0.42, -0.06, 0.37)).mask
    knob = np.zeros(len(mask), bool)
    knob[-2 * 12 * 64 : -12 * 64] = True
    assert np.array_equal(mask, knob)


def test_grow_and_shrink(session, cloud_cabinet):
    door = cloud_cabinet.labels == 1
    larger = grow(session, door, 2)
    smaller = grow(session, door, -2)
    assert (larger & door).sum() == door.sum() and larger.sum() > door.sum()
    assert not (smaller & ~door).any() and smaller.sum() < door.sum()
    assert np.array_equal(grow(session, door, 0), door)


def test_straight_cut_by_two_and_three_clicks(session, cloud_cabinet):
    top = cloud_cabinet.asset.element_centers[:, 2] > 0.79
    centers = cloud_cabinet.asset.element_centers
    first = line_cut(session, top, [(0.3, 0.1, 0.8), (0.3, 0.4, 0.8)]).inside(session.asset)
    ends = sorted([centers[first, 0], centers[top & ~first, 0]], key=min)
    assert ends[0].max() < 0.301 and ends[1].min() > 0.299
    everything = np.ones(len(centers), bool)
    half = line_cut(session, everything, [(0, 0, 0.2), (1, 0, 0.2), (0, 0.5, 0.2)])
    inside = half.inside(session.asset)
    low, high = sorted([centers[inside, 2], centers[~inside, 2]], key=min)
    assert low.max() <= 0.2 <= high.min()
    with pytest.raises(PromptError, match="two or three"):
        line_cut(session, top, [(0, 0, 0)])
    with pytest.raises(PromptError, match="line"):
        line_cut(session, top, [(0, 0, 0), (0, 0, 0)])


def test_a_rectangle_takes_the_door_that_no_gap_parts_with_its_handle():
    rng = np.random.default_rng(3)
    body, _ = sampled([((0, 0, 0), (1, 0.6, 1.2))], 30_000)
    handle, _ = sampled([((0.2, -0.06, 0.5), (0.24, 0, 0.7))], 600)
    points = np.concatenate([body, handle]) + rng.normal(0, 0.002, (30_600, 3))
    session = DefaultSegmenter().encode(Asset("flush", cloud=PointCloud(points.astype(np.float32))))
    mask = np.ones(len(points), bool)
    for view in ((0.3, 1.0, -0.2), None):
        cut = rectangle_cut(session, mask, [(0.1, 0, 1.1), (0.8, 0, 0.1)], view)
        door = cut.inside(session.asset)
        clean = np.concatenate([body, handle])
        truth = (clean[:, 1] < 1e-6) & (np.abs(clean[:, 0] - 0.45) < 0.35)
        truth &= np.abs(clean[:, 2] - 0.6) < 0.5
        assert iou(door, truth) > 0.97
        assert door[30_000:].all()
    # On a level surface it follows the object, not the view.
    lid = rectangle_cut(session, mask, [(0.1, 0.1, 1.2), (0.9, 0.5, 1.2)], (0.3, 0.7, -1.0))
    top = lid.inside(session.asset)
    truth = (np.abs(clean - (0.5, 0.3, 1.2)) < (0.4, 0.2, 1e-6)).all(1)
    assert iou(top, truth) > 0.95
    with pytest.raises(PromptError, match="two opposite"):
        rectangle_cut(session, mask, [(0, 0, 0)])
    with pytest.raises(PromptError, match="one of its sides"):
        rectangle_cut(session, mask, [(0.1, 0, 1.1), (0.8, 0, 1.1)], (0, 1, 0))


def test_a_rectangle_moves_to_the_step_of_colour_close_by():
    points, _ = sampled([((0, 0, 0), (1, 0.6, 1.2))], 60_000)
    points = points + np.random.default_rng(3).normal(0, 0.001, points.shape)
    truth = (np.abs(points - (0.45, 0, 0.6)) < (0.35, 0.01, 0.5)).all(1)
    colors = np.where(truth[:, None], (120, 80, 60), (200, 190, 170)).astype(np.uint8)
    asset = Asset("painted", cloud=PointCloud(points.astype(np.float32), colors=colors))
    session = DefaultSegmenter().encode(asset)
    everything = np.ones(len(points), bool)
    corners = [(0.115, 0, 1.085), (0.785, 0, 0.112)]  # a centimetre or two off
    inside = [
        rectangle_cut(session, everything, corners, (0, 1, 0), snap=snap).inside(asset)
        for snap in (False, True)
    ]
    assert iou(inside[0], truth) < 0.94
    assert iou(inside[1], truth) > 0.98


def test_a_rectangle_moves_onto_the_edges_that_a_mesh_has():
    body = trimesh.creation.box((1, 0.6, 1.2))
    door = trimesh.creation.box((0.6, 0.02, 0.9))
    door.apply_translation((0, -0.31, 0))
    knob = trimesh.creation.box((0.04, 0.04, 0.04))
    knob.apply_translation((0.2, -0.34, 0))
    both = trimesh.util.concatenate([body, door, knob])
    asset = Asset("cupboard", mesh=Mesh(both.vertices, both.faces))
    session = DefaultSegmenter().encode(asset)
    corners = [(-0.292, -0.32, 0.443), (0.295, -0.32, -0.456)]
    cut = rectangle_cut(session, np.ones(36, bool), corners, (0, 1, 0))
    at = sorted(float(np.dot(p.point, np.abs(p.normal))) for p in cut.planes)
    np.testing.assert_allclose(at, [-0.45, -0.3, 0.3, 0.45], atol=1e-9)
    # The door with its rim, its back and its knob, and nothing of the body behind it.
    assert not cut.splits_faces(asset)
    np.testing.assert_array_equal(np.flatnonzero(cut.inside(asset)), np.arange(12, 36))


def test_mirrored_door_is_the_other_door(session, cloud_cabinet):
    other = mirrored(session, cloud_cabinet.labels == 1)
    assert iou(other, cloud_cabinet.labels == 2) > 0.85


def test_same_shape_finds_the_other_buttons(keypad):
    session, label = keypad
    found = same_shape(session, label == 1)
    hits = {b for b in range(2, 7) if any(iou(m, label == b) > 0.55 for m in found)}
    assert hits == {2, 3, 4, 5, 6}
    assert not any(iou(m, label == 7) > 0.5 for m in found)


def test_same_shape_finds_the_other_door_of_a_scan():
    """No tree has it as a region, but a click there means it; the body's panels look otherwise."""
    rng = np.random.default_rng(0)
    truth = EXAMPLES["cabinet"].make(rng).object
    scan = reconstruct_scan(truth, ReconstructionSettings(points=40_000), rng)
    upright = moved(Asset("scan", cloud=scan.cloud), np.linalg.inv(scan.source_from_object))
    mine = scan.kind == OBJECT
    doors = [k for k, p in enumerate(truth.parts) if p.name == "door"]
    first, second = (scan.part[mine] == k for k in doors)
    session = DefaultSegmenter().encode(crop(upright, mine))
    (found,) = same_shape(session, first)
    assert iou(found, second) > 0.7


def test_propose_finds_parts_without_any_click(keypad):
    session, label = keypad
    answer = propose_parts(session)
    assert answer.labels.shape == label.shape and answer.labels.min() >= 0
    found = [
        max(iou(answer.labels == p, label == b) for p in answer.parts) > 0.7 for b in range(1, 8)
    ]
    assert sum(found) >= 5


def test_leftovers_go_to_their_neighbours(session, cloud_cabinet):
    labels = cloud_cabinet.labels.copy()
    points = cloud_cabinet.asset.element_centers
    crumb = np.linalg.norm(points - (0.25, -0.02, 0.6), axis=1) < 0.02
    labels[crumb] = 5
    labels[np.linalg.norm(points - (0.5, 0.5, 0.4), axis=1) < 0.02] = -1
    clean = absorb_small_components(session, labels)
    assert (clean >= 0).all()
    assert (clean[crumb] == 5).all(), "the only piece of a part is never a crumb"
    labels[crumb] = 2
    clean = absorb_small_components(session, labels)
    assert (clean[crumb] == 1).all()


def test_a_mask_of_the_wrong_length_is_refused(session):
    with pytest.raises(PromptError, match="shape"):
        grow(session, np.ones(3, bool))


def test_a_box_round_a_thing_keeps_the_thing():
    thing, _ = sampled([((-0.4, -0.4, 0.0), (0.4, 0.4, 1.0))], 6000)
    behind, _ = sampled([((-1.0, 0.7, 0.0), (1.0, 0.75, 1.0))], 4000)
    points = np.concatenate([behind, thing])
    np.testing.assert_array_equal(largest_component(points), np.arange(len(points)) >= len(behind))
    assert largest_component(points[:1]).all() and len(largest_component(points[:0])) == 0
    assert largest_component(thing + 5e4).mean() > 0.99  # far from the origin, too


def test_floor_walls_and_outliers_leave_the_object():
    rng = np.random.default_rng(1)
    floor = np.c_[rng.uniform(-2, 2, (8000, 2)), rng.normal(0, 0.003, 8000)]
    wall = np.c_[rng.uniform(-2, 2, 5000), np.full(5000, 2.0), rng.uniform(0, 2, 5000)]
    thing, _ = sampled([((-0.4, -0.4, 0.15), (0.4, 0.4, 1.0))], 8000)
    stray = rng.uniform((-1.5, -1.5, 2.5), (1.5, 1.5, 5.5), (20, 3))
    points = np.concatenate([floor, wall, thing, stray])
    kind = np.repeat([0, 1, 2, 3], [8000, 5000, 8000, 20])
    asset = Asset("room", cloud=PointCloud(points))
    far = outliers(asset)
    assert far[kind == 3].all() and far[kind != 3].mean() < 0.01
    inside = crop(asset, ~far)
    border = floor_and_walls(inside)
    kept = kind[~far][~border]
    assert (kept == 2).mean() > 0.98 and (kept == 2).sum() > 0.95 * 8000
    with pytest.raises(GeometryError, match="room"):
        crop(asset, np.zeros(len(points), bool))
