"""Tools as the worker runs them: regions come out, and stand for themselves afterwards."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from app.server import prepare_tasks, segmenting_tasks, tasks, tool_tasks
from app.server.display_tasks import OpenedAsset, open_asset
from app.server.scene_tasks import drawn_parts
from app.server.segmenting_tasks import StoredRegion, session_of
from app.server.tool_tasks import NEW_PART, ToolRequest, use_tool
from model.core.errors import CommandError
from model.core.progress import Cancelled
from model.prediction.experience import Experience, ObjectExample, save_experience
from model.segmentation.all_parts import mask_examples
from model.segmentation.prompts import Click, Prompts

LID = (0.05, 0.02, 0.365)


def surface(size: tuple[float, ...], center: tuple[float, ...], count: int) -> np.ndarray:
    box = trimesh.creation.box(size)
    box.apply_translation(center)
    return trimesh.sample.sample_surface(box, count, seed=0)[0]


@pytest.fixture(scope="module")
def chest(tmp_path_factory) -> tuple[OpenedAsset, Path]:
    """A chest with a lid above a gap, and a knob on either side."""
    folder = tmp_path_factory.mktemp("chest")
    points = np.concatenate(
        [
            surface((0.6, 0.4, 0.3), (0, 0, 0.15), 5000),
            surface((0.6, 0.4, 0.05), (0, 0, 0.34), 2500),
            surface((0.05, 0.05, 0.05), (-0.2, -0.24, 0.15), 300),
            surface((0.05, 0.05, 0.05), (0.2, -0.24, 0.15), 300),
        ]
    )
    trimesh.PointCloud(points).export(folder / "chest.ply")
    opened = open_asset(folder / "chest.ply", folder, tasks.ReadOptions())
    return opened, folder


def points_of(opened: OpenedAsset) -> np.ndarray:
    return tasks.asset_of(opened.folder).element_centers


def click_at(opened: OpenedAsset, position, part: int) -> Click:
    element = int(np.linalg.norm(points_of(opened) - position, axis=1).argmin())
    x, y, z = map(float, points_of(opened)[element])
    return Click((x, y, z), part, True, element)


def region(chest, mask: np.ndarray, part: int) -> StoredRegion:
    ref = tasks.arrays_of(chest[1]).put(np.flatnonzero(mask))
    return StoredRegion(part, ref)


def run(chest, items, request: ToolRequest) -> list[tuple[int, bool, np.ndarray]]:
    opened, workspace = chest
    offers = use_tool(opened.folder, workspace, "default", tuple(items), request)
    arrays = tasks.arrays_of(workspace)
    return [(o.part, o.positive, np.asarray(arrays.get(o.elements))) for o in offers]


def test_a_cut_parts_what_no_gap_parts(chest):
    opened, _ = chest
    points = points_of(opened)
    front = (points[:, 1] < -0.199) & (points[:, 1] > -0.21) & (points[:, 2] < 0.3)
    items = [region(chest, front, 1)]
    element = int(np.flatnonzero(front)[0])
    request = ToolRequest(
        "cut",
        1,
        places=((0.1, -0.2, 0.05), (0.1, -0.2, 0.25)),
        element=element,
        view=(0.0, 1.0, 0.0),
    )
    ((part, positive, elements),) = run(chest, items, request)
    assert (part, positive) == (NEW_PART, True)
    expected = np.flatnonzero(front & (points[:, 0] > 0.1))
    assert len(np.setxor1d(elements, expected)) < 0.02 * len(expected)
    # A chosen part that has nothing yet takes the piece itself.
    ((part, _, _),) = run(chest, items, ToolRequest(**{**vars(request), "part": 5}))
    assert part == 5


def test_merge_split_mirror_and_leftovers(chest):
    opened, _ = chest
    points = points_of(opened)
    knobs = points[:, 1] < -0.212
    left, right = knobs & (points[:, 0] < 0), knobs & (points[:, 0] > 0)
    both = [region(chest, left, 1), region(chest, right, 2)]
    ((part, positive, elements),) = run(chest, both, ToolRequest("merge", 1, other=2))
    assert (part, positive) == (1, True) and np.array_equal(elements, np.flatnonzero(right))
    ((part, _, elements),) = run(chest, [region(chest, knobs, 1)], ToolRequest("split", 1))
    assert part == NEW_PART and np.isin(elements, np.flatnonzero(knobs)).all()
    one_side = points[elements][:, 0]
    assert (one_side < 0).all() or (one_side > 0).all()
    ((part, _, elements),) = run(chest, both[:1], ToolRequest("mirror", 1))
    assert part == NEW_PART and np.isin(np.flatnonzero(right), elements).mean() > 0.8
    # What mirrors it is a part already: asked again, nothing is taken from that.
    assert run(chest, both, ToolRequest("mirror", 1)) == []
    crumb = np.linalg.norm(points - (0.0, 0.0, 0.365), axis=1) < 0.012
    items = [region(chest, points[:, 2] > 0.31, 1), region(chest, left | crumb, 2)]
    found = run(chest, items, ToolRequest("leftovers", 1))
    assert any(p == 1 and np.isin(np.flatnonzero(crumb), e).all() for p, _, e in found)


def test_the_same_shape_is_found_where_a_large_part_took_it_along(chest):
    opened, _ = chest
    points = points_of(opened)
    knobs = points[:, 1] < -0.212
    left, right = knobs & (points[:, 0] < 0), knobs & (points[:, 0] > 0)
    body = (points[:, 2] < 0.31) & ~left
    items = [region(chest, body, 2), region(chest, left, 1)]
    ((part, positive, elements),) = run(chest, items, ToolRequest("same shape", 1))
    assert (part, positive) == (NEW_PART, True)
    assert np.isin(np.flatnonzero(right), elements).mean() > 0.8
    # A knob that is a part of its own already stays one.
    items = [region(chest, right, 2), region(chest, left, 1)]
    assert run(chest, items, ToolRequest("same shape", 1)) == []


def test_connected_stops_at_gaps_and_at_what_is_a_part_already(tmp_path):
    lid = surface((0.6, 0.4, 0.05), (0, 0, 0.346), 6000)
    body = surface((0.6, 0.4, 0.3), (0, 0, 0.15), 14000)
    # Three times the spacing spans the gap of 21 mm.
    points = np.concatenate([body, lid])
    points += np.random.default_rng(0).normal(0, 0.0004, points.shape)
    trimesh.PointCloud(points).export(tmp_path / "box.ply")
    here = (open_asset(tmp_path / "box.ply", tmp_path, tasks.ReadOptions()), tmp_path)
    above = points[:, 2] > 0.308
    click = click_at(here[0], LID, 1)
    few = region(here, np.arange(len(points)) == click.element, 1)
    ((part, positive, elements),) = run(here, [few, click], ToolRequest("connected", 1))
    assert (part, positive) == (1, True)
    got = np.zeros(len(points), bool)
    got[elements] = True
    assert not (got & ~above).any()
    # Half of the lid is a part already: that stays.
    half = above & (points[:, 0] > 0.1)
    said = [region(here, half, 2), few, click]
    for _, _, elements in run(here, said, ToolRequest("connected", 1)):
        assert not half[elements].any()


def test_connected_says_so_where_nearly_everything_is(tmp_path):
    points = surface((0.6, 0.4, 0.3), (0, 0, 0.15), 8000)
    trimesh.PointCloud(points).export(tmp_path / "box.ply")
    here = (open_asset(tmp_path / "box.ply", tmp_path, tasks.ReadOptions()), tmp_path)
    click = click_at(here[0], (0.0, -0.2, 0.15), 1)
    with pytest.raises(CommandError, match="nearly everything is connected"):
        run(here, [click], ToolRequest("connected", 1))


def test_all_parts_leaves_alone_what_is_a_part_already(chest):
    guessed = run(chest, [], ToolRequest("propose", 1))
    assert guessed and all(part == NEW_PART and positive for part, positive, _ in guessed)
    first = guessed[0][2]
    taken = np.zeros(len(points_of(chest[0])), bool)
    taken[first] = True
    again = run(chest, [region(chest, taken, 1)], ToolRequest("propose", 2))
    assert len(again) == len(guessed) - 1
    assert not any(taken[elements].any() for _, _, elements in again)
    np.testing.assert_array_equal(
        np.sort(np.concatenate([first, *(e for _, _, e in again)])),
        np.sort(np.concatenate([e for _, _, e in guessed])),
    )


def test_all_parts_follows_accepted_objects_of_its_kind(chest, tmp_path):
    """Of which the left knob alone was a part."""
    opened, _ = chest
    points = points_of(opened)
    labels = ((points[:, 1] < -0.21) & (points[:, 0] < 0)).astype(np.int16)
    masks = mask_examples(session_of(opened.folder, "default"), labels, ["", "left"])
    accepted = tuple(ObjectExample(k, "Chest", (), masks=masks) for k in "abc")
    (tmp_path / "learned" / "1").mkdir(parents=True)
    save_experience(Experience(accepted), tmp_path / "learned" / "1" / "experience.json")
    (tmp_path / "learned" / "current.json").write_text('{"version": 1}')
    for category, known, called in (("chest", 3, {"left"}), ("Oven", 0, {None})):
        request = ToolRequest("propose", 1, category=category)
        offers = use_tool(opened.folder, tmp_path, "default", (), request)
        assert isinstance(offers, list) and {o.known for o in offers} == {known}
        assert {o.name for o in offers} == called
        for offer in offers if known else ():
            found = np.asarray(tasks.arrays_of(tmp_path).get(offer.elements))
            assert labels[found].mean() > 0.9
    offer = tool_tasks.find_alike(opened.folder, tmp_path, (), "chest")
    assert offer is not None and (offer.folder, offer.known, offer.category) == ("", 3, "chest")
    assert {region.name for region in offer.regions} == {"left"}
    assert tool_tasks.find_alike(opened.folder, tmp_path, (), "Oven") is None


def test_all_parts_says_how_far_it_is_and_can_be_stopped(chest):
    opened, workspace = chest
    told: list[float] = []

    def progress(fraction: float, message: str) -> None:
        told.append(fraction)
        if len(told) == 5:
            raise Cancelled(message)

    with pytest.raises(Cancelled):
        use_tool(
            opened.folder, workspace, "default", (), ToolRequest("propose", 1), progress=progress
        )
    assert len(told) == 5 and told == sorted(told) and 0 < told[0] < told[-1] < 0.2


def test_masks_go_round_and_begin_with_the_answer(chest):
    opened, workspace = chest
    click = click_at(opened, LID, 1)

    def shown(turn: int):
        request = ToolRequest("next mask", 1, turn)
        return use_tool(opened.folder, workspace, "default", (click,), request)

    answer = shown(0)
    assert answer.number == 0 and not answer.regions and answer.total > 2
    second, last = shown(1), shown(-1)
    assert second.regions and (second.number, last.number) == (1, answer.total - 1)
    assert shown(answer.total) == answer and shown(answer.total + 1) == second


def test_masks_go_from_small_to_large_and_hold_the_small_part_under_the_click(tmp_path):
    boxes = [
        trimesh.creation.box(bounds=b).subdivide().subdivide()
        for b in (
            [[-0.3, -0.2, 0], [0.3, 0.2, 0.3]],
            [[-0.29, -0.21, 0.02], [0.29, -0.2, 0.28]],
            [[0.2, -0.235, 0.14], [0.22, -0.212, 0.16]],
        )
    ]
    trimesh.util.concatenate(boxes).export(tmp_path / "drawer.ply")
    opened = open_asset(tmp_path / "drawer.ply", tmp_path, tasks.ReadOptions())
    mesh = tasks.asset_of(opened.folder).mesh
    knob = points_of(opened)[:, 1] < -0.211
    click = click_at(opened, (0.21, -0.235, 0.15), 1)
    answer = use_tool(opened.folder, tmp_path, "default", (click,), ToolRequest("next mask", 1, 0))
    first = session_of(opened.folder, "default").segment(Prompts((click,))).labels == 1
    masks = {answer.rank: first}
    for turn in range(1, answer.total):
        request = ToolRequest("next mask", 1, turn)
        offer = use_tool(opened.folder, tmp_path, "default", (click,), request)
        mask = first.copy()
        for change in offer.regions:
            mask[tasks.arrays_of(tmp_path).get(change.elements)] = change.positive
        masks[offer.rank] = mask
        area = mesh.face_areas
        assert offer.share == pytest.approx(area[mask].sum() / area.sum(), rel=1e-4)
    sizes = [mesh.face_areas[masks[k]].sum() for k in range(answer.total)]
    assert sizes == sorted(sizes) and len(np.unique(np.round(sizes, 6))) == answer.total
    assert any(np.array_equal(m, knob) for m in masks.values())


def test_the_preview_is_what_the_click_does(chest):
    opened, workspace = chest
    click = click_at(opened, LID, 1)
    hover = tool_tasks.hover(opened.folder, workspace, "default", (), click)
    answer = segmenting_tasks.segment(opened.folder, workspace, "default", (click,), "key", None)
    assert hover.count == answer.counts[1] and len(hover.lost) == 0
    labels = tasks.arrays_of(workspace).get(answer.labels)
    mine = {tuple(p) for p in points_of(opened)[labels == 1].astype(np.float32)}
    assert {tuple(p) for p in hover.gained} <= mine
    # On top of the lid, where nothing else is near but at its rim: an outline, and few within.
    shown, there = (p[p[:, 2] > 0.36] for p in (hover.gained, points_of(opened)[labels == 1]))
    middle, whole = ((np.abs(p[:, :2]) < (0.24, 0.14)).all(1).sum() for p in (shown, there))
    assert 0 < middle < 0.4 * whole
    other = click_at(opened, LID, 2)
    taken = tool_tasks.hover(opened.folder, workspace, "default", (click,), other)
    assert taken.count > 0 and len(taken.gained)
    again = segmenting_tasks.segment(opened.folder, workspace, "default", (click,), "key", None)
    assert again.labels == answer.labels, "a preview leaves no trace"


def test_what_cannot_be_done_is_said(chest):
    with pytest.raises(CommandError, match="next mask"):
        run(chest, (), ToolRequest("magic", 1))
    words = {"grow": "is empty", "connected": "click on the part", "cut": "places"}
    for tool, told in {**words, "merge": "another part"}.items():
        with pytest.raises(CommandError, match=told):
            run(chest, (), ToolRequest(tool, 1))


def test_an_object_leaves_the_room_and_knows_its_place(tmp_path):
    rng = np.random.default_rng(1)
    floor = np.c_[rng.uniform(-2, 2, (8000, 2)), rng.normal(0, 0.003, 8000)]
    wall = np.c_[rng.uniform(-2, 2, 5000), np.full(5000, 2.0), rng.uniform(0, 2, 5000)]
    box = surface((0.8, 0.8, 0.85), (0.5, 0.1, 0.6), 8000)
    every = np.concatenate([floor, wall, box])
    trimesh.PointCloud(every).export(tmp_path / "room.ply")
    room = open_asset(tmp_path / "room.ply", tmp_path, tasks.ReadOptions())
    removal = prepare_tasks.floor_and_walls(tmp_path, None, room.folder)
    inside = open_asset(
        tmp_path / "room.ply", tmp_path, tasks.ReadOptions(left_out=removal.elements)
    )
    kept = points_of(inside)
    assert inside.element_count == len(every) - removal.count
    assert abs(inside.element_count - 8000) < 400
    arrays = tasks.arrays_of(tmp_path)
    labels = arrays.put((kept[:, 2] > 0.3).astype(np.int16))
    crop = prepare_tasks.cut_out(tmp_path, removal.elements, inside.folder, labels, 1, "big box")
    assert crop.name == "big_box" and crop.path.suffix == ".ply"
    alone = open_asset(crop.path, tmp_path, tasks.ReadOptions())
    assert abs(alone.bounds[0][2]) < 1e-6
    source = points_of(room)[arrays.get(crop.elements)]
    np.testing.assert_allclose(points_of(alone) + crop.position, source, atol=1e-6)
    # Leaving out the rest too: both are gone, in the numbers of the whole source.
    rest = prepare_tasks.leave_out_part(tmp_path, removal.elements, inside.folder, labels, 0)
    assert rest.count == len(every) - crop.count
    with pytest.raises(CommandError, match="single object"):
        prepare_tasks.floor_and_walls(tmp_path, None, alone.folder)


def test_a_cut_splits_large_faces_and_the_parts_keep_theirs(tmp_path):
    box = trimesh.creation.box((1.0, 0.6, 1.2))
    box.export(tmp_path / "box.ply")
    opened = open_asset(tmp_path / "box.ply", tmp_path, tasks.ReadOptions())
    mesh = tasks.asset_of(opened.folder).mesh
    top = mesh.face_normals[:, 2] > 0.5
    here = (opened, tmp_path)
    items = [region(here, top, 1)]
    front = int(np.flatnonzero(mesh.face_normals[:, 1] < -0.5)[0])

    def cut(tool: str, *places: tuple[float, float, float]) -> tool_tasks.FaceCutOffer:
        request = ToolRequest(
            tool, 1, places=places, element=front, view=(0.0, 1.0, 0.0), free_part=2
        )
        offer = use_tool(opened.folder, tmp_path, "default", tuple(items), request)
        assert isinstance(offer, tool_tasks.FaceCutOffer)
        return offer

    offer = cut("rectangle", (-0.3, -0.3, -0.4), (0.2, -0.3, 0.5))
    options = tasks.ReadOptions(face_cuts=(offer.cut,))
    after = open_asset(tmp_path / "box.ply", tmp_path, options)
    split = tasks.asset_of(after.folder).mesh
    labels = tasks.arrays_of(tmp_path).get(offer.labels)
    assert len(split.faces) == len(labels) == sum(offer.counts.values()) > 12
    assert split.face_areas[labels == 2].sum() == pytest.approx(0.5 * 0.9, rel=1e-6)
    assert split.face_areas[labels == 1].sum() == pytest.approx(0.6, rel=1e-6)
    # So is it drawn in a scene, and saved from there.
    drawn = drawn_parts(tmp_path / "box.ply", tmp_path, offer.labels, 1000, options)
    np.testing.assert_allclose(
        drawn.shapes["link_2"].bounds, [(-0.3, -0.3, -0.4), (0.2, -0.3, 0.5)], atol=1e-6
    )
    assert drawn.folder == after.folder
    # The regions alone say the same, when the segmenter is asked again after a reload.
    stored = tuple(StoredRegion(r.part, r.elements) for r in offer.regions)
    session = segmenting_tasks.session_of(after.folder, "default")
    prompts = segmenting_tasks.prompts_of(tmp_path, stored)
    np.testing.assert_array_equal(session.segment(prompts).labels, labels)
    # A line takes the smaller side of what was clicked.
    line = cut("cut", (0.3, -0.3, -0.2), (0.3, -0.3, 0.2))
    right = tasks.arrays_of(tmp_path).get(line.labels) == 2
    opened_line = open_asset(
        tmp_path / "box.ply", tmp_path, tasks.ReadOptions(face_cuts=(line.cut,))
    )
    mesh = tasks.asset_of(opened_line.folder).mesh
    assert mesh.triangles[right][..., 0].min() == pytest.approx(0.3, abs=1e-6)
    with pytest.raises(CommandError, match="nothing of the part"):
        cut("rectangle", (3.0, -0.3, 3.0), (4.0, -0.3, 4.0))
    trimesh.Trimesh(np.eye(3), [[0, 1, 2]]).export(tmp_path / "tri.ply")
    with pytest.raises(CommandError, match="fewer faces"):
        tasks.working_copy(tmp_path / "tri.ply", tmp_path, options)
