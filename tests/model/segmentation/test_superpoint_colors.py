"""Cells of layers that lie within one another's spacing are of one colour each."""

import numpy as np
import pytest

from model.core.asset import Asset
from model.core.geometry import PointCloud
from model.segmentation.encoding import encode_superpoints
from model.segmentation.graph import lab_colors, shipped_edge_model
from model.segmentation.superpoints import split_by_color

RED, BLUE = (180, 40, 40), (40, 60, 170)


def _layers(noise: float) -> tuple[PointCloud, np.ndarray]:
    """Two sheets a metre wide, a millimetre apart, with points about four millimetres apart."""
    rng = np.random.default_rng(3)
    number = 30_000
    layer = np.repeat([0, 1], number)
    points = np.c_[rng.random((2 * number, 2)), 0.001 * layer].astype(np.float32)
    rgb = np.array([RED, BLUE], float)[layer] + rng.normal(0, noise, (2 * number, 3))
    return PointCloud(points, colors=np.clip(rgb, 0, 255).astype(np.uint8)), layer


def _mixed(noise: float) -> float:
    """Share of the points that are in a cell of more points of the other sheet."""
    cloud, layer = _layers(noise)
    nodes, _, _, superpoints = encode_superpoints(
        Asset("layers", cloud=cloud), shipped_edge_model()
    )
    layer = layer[nodes.elements.element_of_node]
    share = np.bincount(superpoints.of_node, layer, len(superpoints)) / superpoints.size
    links = superpoints.links
    assert superpoints.size.sum() == len(nodes)
    assert (links.a < links.b).all() and links.b.max() < len(superpoints)
    return float((np.minimum(share, 1 - share) * superpoints.size).sum() / superpoints.size.sum())


def test_layers_a_millimetre_apart_are_told_by_their_plain_colours() -> None:
    assert _mixed(noise=0) < 0.03  # 0.054 with cells of two colours; single points stay


def test_noisy_colours_part_no_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on scans, where they would cost cells and bring nothing."""
    cloud, _ = _layers(noise=3)
    asset = Asset("layers", cloud=cloud)
    superpoints = encode_superpoints(asset, shipped_edge_model())[3]
    monkeypatch.setattr("model.segmentation.superpoints.has_flat_colors", lambda *_: False)
    np.testing.assert_array_equal(
        superpoints.of_node, encode_superpoints(asset, shipped_edge_model())[3].of_node
    )


def test_one_colour_and_a_gradient_are_left_whole_and_noise_nearly() -> None:
    rng = np.random.default_rng(4)
    of_node = np.repeat(np.arange(500), 8)
    x = np.linspace(0, 255, len(of_node))
    plain = np.tile([90, 120, 60], (len(of_node), 1))
    for rgb in (plain, np.c_[x, x, 255 - x]):
        lab = lab_colors(np.clip(rgb, 0, 255).astype(np.uint8))
        now, number = split_by_color(of_node, lab, 500)
        assert number == 500
        np.testing.assert_array_equal(now, of_node)
    noisy = np.clip(plain + rng.normal(0, 12, plain.shape), 0, 255).astype(np.uint8)
    assert split_by_color(of_node, lab_colors(noisy), 500)[1] < 525


def test_a_point_of_another_colour_alone_is_no_cell() -> None:
    of_node = np.repeat(np.arange(3), 8)
    rgb = np.tile(RED, (24, 1))
    rgb[3] = BLUE
    rgb[8:12] = BLUE
    rgb[22:] = BLUE
    now, number = split_by_color(of_node, lab_colors(rgb.astype(np.uint8)), 3)
    assert number == 5
    assert len(set(now[:8])) == 1
    assert now[8] != now[12]
    assert now[16] != now[22]
    assert set(now[[8, 12]]) == {1, 3}
