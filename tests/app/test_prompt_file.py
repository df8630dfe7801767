"""Prompt files: what they may say, and how each fault is named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.server.prompt_file import check_prompts, distance_to_surface, read_prompts
from model.core.asset import Asset
from model.core.errors import InputFileError
from model.core.files import static_assets
from model.core.geometry import Mesh, PointCloud
from model.segmentation.prompts import Region

SQUARE = Mesh(
    np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float),
    np.array([[0, 1, 2], [0, 2, 3]], np.int32),
)


def read(tmp_path: Path, value: object):
    path = tmp_path / "prompts.json"
    path.write_text(value if isinstance(value, str) else json.dumps(value))
    return read_prompts(path)


def test_everything_that_may_be_said(tmp_path):
    file = read(
        tmp_path,
        {
            "format": 1,
            "category": "oven",
            "parts": [{"id": 1, "name": " door "}, {"id": 2}],
            "clicks": [
                {"position": [0, 1, 2.5], "part": 1},
                {"point": [1, 2, 3], "part": 2, "label": 0, "element": 17},
            ],
            "regions": [{"part": 1, "elements": [5, 3, 3], "positive": False}],
        },
    )
    first, second = file.prompts.clicks
    assert (first.position, first.part, first.positive) == ((0.0, 1.0, 2.5), 1, True)
    assert (second.part, second.positive, second.element) == (2, False, 17)
    region = file.prompts.items[2]
    assert isinstance(region, Region) and region.elements.tolist() == [3, 5]
    assert not region.positive
    assert file.names == {1: "door"} and file.category == "oven"


def test_a_bare_list_of_clicks(tmp_path):
    file = read(tmp_path, [{"point": [0, 0, 0]}, {"point": [1, 1, 1], "label": 0}])
    assert [(c.part, c.positive) for c in file.prompts.clicks] == [(1, True), (1, False)]


def test_half_a_character_in_a_name_is_left_out(tmp_path):
    text = '{"parts": [{"id": 1, "name": "do\\ud800or"}], "clicks": [{"point": [0, 0, 0]}]}'
    assert read(tmp_path, text).names == {1: "door"}


def test_a_byte_order_mark_is_no_fault(tmp_path):
    text = "\ufeff" + json.dumps([{"point": [0, 0, 0], "part": 2}])
    assert read(tmp_path, text).prompts.clicks[0].part == 2


GOOD = {"position": [0, 0, 0], "part": 1}


@pytest.mark.parametrize(
    ("value", "place"),
    [
        ("{", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("", "is not JSON"),
        (3, "the file"),
        ({}, "no clicks"),
        ([], "no clicks"),
        ({"click": []}, "unknown key 'click'"),
        ({"format": 2, "clicks": [GOOD]}, "format: 2"),
        ({"category": 3, "clicks": [GOOD]}, "category"),
        ({"clicks": GOOD}, "clicks: needs a list"),
        ({"parts": [{"name": "door"}], "clicks": [GOOD]}, "parts[0].id"),
        ({"parts": [{"id": 1}, {"id": 1}], "clicks": [GOOD]}, "parts[1].id"),
        ({"parts": [{"id": 1, "name": 7}], "clicks": [GOOD]}, "parts[0].name"),
        ({"parts": [{"id": 1, "name": "x" * 81}], "clicks": [GOOD]}, "parts[0].name: has 81"),
        ({"category": "x" * 100_000, "clicks": [GOOD]}, "category: has 100,000"),
        ([GOOD, 5], "clicks[1]: needs an object"),
        ([GOOD, {"part": 1}], "clicks[1].position: is missing"),
        ([{**GOOD, "point": [0, 0, 0]}], "clicks[0].position: is given twice"),
        ([{"position": [0, 0], "part": 1}], "clicks[0].position: needs three numbers"),
        ([{"point": "here", "part": 1}], "clicks[0].point: needs three numbers"),
        ([{"point": [0, True, 0], "part": 1}], "clicks[0].point"),
        ('[{"point": [0, NaN, 0], "part": 1}]', "clicks[0].point: needs three finite"),
        ('[{"point": [0, 1e999, 0], "part": 1}]', "clicks[0].point: needs three finite"),
        (f'[{{"point": [0, 1{"0" * 400}, 0], "part": 1}}]', "clicks[0].point"),
        ([GOOD, {"position": [0, 0, 0]}], "clicks[1].part: is missing"),
        ([{**GOOD, "part": -1}], "clicks[0].part"),
        ([{**GOOD, "part": 1.5}], "clicks[0].part"),
        ([{**GOOD, "part": "door"}], "clicks[0].part"),
        ([{**GOOD, "part": 1000}], "clicks[0].part"),
        ([{**GOOD, "positive": 1}], "clicks[0].positive"),
        ([{**GOOD, "label": 2}], "clicks[0].label"),
        ([{**GOOD, "label": 1, "positive": True}], "clicks[0].label"),
        ([{**GOOD, "element": -3}], "clicks[0].element"),
        ([{**GOOD, "postive": False}], "unknown key 'postive'"),
        ({"regions": [{"part": 1}]}, "regions[0].elements: is missing"),
        ({"regions": [{"part": 1, "elements": []}]}, "regions[0].elements"),
        ({"regions": [{"part": 1, "elements": [0, 2.5]}]}, "regions[0].elements[1]"),
    ],
)
def test_each_fault_is_named_with_its_place(tmp_path, value, place):
    with pytest.raises(InputFileError) as caught:
        read(tmp_path, value)
    assert str(caught.value).startswith(str(tmp_path / "prompts.json"))
    assert place in str(caught.value)
    assert len(str(caught.value)) < 600


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputFileError, match="no such file"):
        read_prompts(tmp_path / "gone.json")
    with pytest.raises(InputFileError, match="can't be read"):
        read_prompts(tmp_path)


@pytest.mark.parametrize("cloud", [False, True])
def test_elements_and_distances_are_checked_against_the_object(tmp_path, cloud):
    side = np.linspace(0, 1, 41)
    points = np.stack([*np.meshgrid(side, side), np.zeros((41, 41))], axis=-1).reshape(-1, 3)
    asset = Asset("plate", cloud=PointCloud(points)) if cloud else Asset("plate", mesh=SQUARE)
    near = {"point": [0.5, 0.5, 0.03], "part": 1}
    check_prompts(read(tmp_path, [near]), asset)
    with pytest.raises(InputFileError, match=r"clicks\[1\]\.position: 0\.3 m away"):
        check_prompts(read(tmp_path, [near, {"point": [0.5, 0.5, 0.3], "part": 1}]), asset)
    count = asset.element_count
    with pytest.raises(InputFileError, match=rf"clicks\[0\]\.element: there is no \w+ {count}"):
        check_prompts(read(tmp_path, [{**near, "element": count}]), asset)
    region = {"regions": [{"part": 1, "elements": [0, count]}]}
    with pytest.raises(InputFileError, match=r"regions\[0\]\.elements"):
        check_prompts(read(tmp_path, region), asset)


def test_distance_is_to_the_face_not_to_its_corners_even_far_from_the_origin():
    far = np.array([5e4, -3e4, 1e3])
    asset = Asset("far", mesh=Mesh(SQUARE.vertices + far, SQUARE.faces))
    positions = np.array([[0.5, 0.25, 0.25], [2.0, 0.5, 0.0]]) + far
    np.testing.assert_allclose(distance_to_surface(asset, positions), [0.25, 1.0], atol=1e-5)


def test_the_bundled_examples_have_good_prompts():
    files = sorted((static_assets() / "examples").glob("*.prompts.json"))
    assert files
    for path in files:
        assert read_prompts(path).prompts.clicks
