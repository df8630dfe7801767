"""Links judged with what lies around them: the network, its training, and what it is worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from model.errors import InputFileError
from model.geometry.asset import Asset
from model.segmentation.cells import Links, build_cells, paired
from model.segmentation.edge_strength import edge_strength, edge_weight, shipped_edge_model
from model.segmentation.encoding import BorderModels, encode, shipped_border_models
from model.segmentation.features import edge_features
from model.segmentation.graph import build_graph
from model.segmentation.link_strength import (
    LINK_FEATURES,
    LinkInputs,
    link_inputs,
    load_link_model,
    refined,
    save_link_model,
    shipped_link_model,
)
from model.segmentation.nodes import nodes_of_asset
from model.segmentation.training.fit import area_under_curve
from model.segmentation.training.links import (
    LinkTraining,
    fit_links,
    link_example,
    logits,
    network,
    plain,
)
from model.segmentation.training.scans import build, scan

SMALL = LinkTraining(width=8, pooled=4, rounds=2, patch_rounds=(1,), epochs=8, threads=1)


@pytest.fixture(scope="module")
def example():
    """Nodes, graph, features, strengths and cells of a made object, and its nodes' parts."""
    data = scan(build(123_456, ("StorageFurniture",)), 20_000, "outside", 0.0005, 5)
    nodes = nodes_of_asset(Asset("object", cloud=data.cloud))
    graph = build_graph(nodes)
    features = edge_features(nodes, graph)
    strength = edge_strength(nodes, graph, shipped_edge_model(), features)
    cells = build_cells(nodes, graph, strength, edge_weight(strength, graph))
    labels = data.labels[nodes.elements.element_of_node]
    return nodes, graph, features, strength, cells, labels


@pytest.fixture(scope="module")
def seen(example) -> LinkInputs:
    return link_inputs(*example[:5])


def small_model(seen: LinkInputs, seed: int = 0):
    import torch

    torch.manual_seed(seed)
    mean = {"cell": seen.cell.mean(0), "link": seen.link.mean(0)}
    scale = {"cell": seen.cell.std(0) + 1e-3, "link": seen.link.std(0) + 1e-3}
    net = network(SMALL)
    return net, mean, scale


def test_numpy_answers_as_what_was_trained(seen) -> None:
    net, mean, scale = small_model(seen)
    told = logits(net, seen, mean, scale).detach().numpy()
    np.testing.assert_allclose(plain(net, mean, scale)(seen), told, atol=1e-4)
    assert told.std() > 1e-3


def test_it_does_not_matter_which_end_of_a_link_is_first(seen) -> None:
    model = plain(*small_model(seen))
    turned = replace(seen, a=seen.b, b=seen.a, along=-seen.along[:, ::-1])
    np.testing.assert_allclose(model(turned), model(seen), atol=1e-4)


def test_links_tell_what_their_node_edges_show(example, seen) -> None:
    _, graph, features, strength, cells, _ = example
    link = int(cells.links.count.argmax())
    ends = {int(cells.links.a[link]), int(cells.links.b[link])}
    of = cells.of_node
    held = [i for i, (a, b) in enumerate(zip(of[graph.a], of[graph.b], strict=True))
            if {int(a), int(b)} == ends]  # fmt: skip
    row = dict(zip(LINK_FEATURES, seen.link[link], strict=True))
    assert len(held) == cells.links.count[link]
    np.testing.assert_allclose(seen.link[link, : features.shape[1]], features[held].mean(0),
                               atol=1e-4)  # fmt: skip
    assert row["strength_max"] == strength[held].max()
    assert row["strength_min"] == strength[held].min()


def test_patches_nest_and_grow_coarser_even_where_all_links_are_alike() -> None:
    side = 60
    at = np.arange(side * side).reshape(side, side)
    a = np.concatenate([at[:, :-1].ravel(), at[:-1].ravel()])
    b = np.concatenate([at[:, 1:].ravel(), at[1:].ravel()])
    one = np.ones(len(a))
    links = Links(a.astype(np.int32), b.astype(np.int32), 0 * one, one, one)
    group, left, size = paired(links, np.ones(side * side), 200, 0.4)
    assert 100 < group.max() + 1 <= 200
    assert size.sum() == side * side
    assert size.max() < 8 * size.mean()
    assert left.a.max() < group.max() + 1


def test_strengths_stay_in_their_range_and_weights_follow(example, seen) -> None:
    cells = example[4]
    logit = np.linspace(-30, 30, len(seen.a))
    links = refined(cells, logit).links
    mean = links.strength / links.count
    assert (mean.min(), mean.max()) == (0, 9)
    assert (np.diff(mean) >= -1e-12).all()
    before = cells.links.conductance * np.exp(cells.links.strength / cells.links.count)
    np.testing.assert_allclose(links.conductance * np.exp(mean), before, rtol=1e-9)


def test_the_shipped_model_finds_more_borders_than_single_edges_show() -> None:
    model, gained = shipped_link_model(), []
    assert model is not None, "static_assets/segmentation/links.npz is missing"
    for index in range(900, 908):
        made = link_example(index, LinkTraining())
        known = made.weight > 0
        full = replace(made.seen, link=made.seen.link.astype(np.float32))
        edges = made.seen.link[known, LINK_FEATURES.index("strength")].astype(np.float64)
        gained.append(
            area_under_curve(model(full)[known].astype(np.float64), made.border[known])
            - area_under_curve(edges, made.border[known])
        )
    assert np.mean(gained) > 0.015, gained


def test_it_learns(tmp_path) -> None:
    """Eight passes over two objects must tell their borders better than single edges do."""
    examples = [link_example(i, SMALL) for i in (3, 13)]
    model = fit_links(examples, SMALL)
    path = tmp_path / "links.npz"
    save_link_model(model, path, {"training": {}})
    again = load_link_model(path)
    for one in examples:
        full = replace(one.seen, link=one.seen.link.astype(np.float32))
        np.testing.assert_array_equal(again(full), model(full))
        edges = full.link[:, LINK_FEATURES.index("strength")].astype(np.float64)
        assert area_under_curve(model(full).astype(np.float64), one.border) > area_under_curve(
            edges, one.border
        )


def test_files_that_do_not_fit_are_named(seen, tmp_path) -> None:
    with pytest.raises(InputFileError, match=r"none\.npz.*not there"):
        load_link_model(tmp_path / "none.npz")
    path = tmp_path / "other.npz"
    save_link_model(plain(*small_model(seen)), path, {})
    held = dict(np.load(path))
    np.savez(path, **{**held, "names": held["names"][1:]})
    with pytest.raises(InputFileError, match=r"other\.npz.*other features"):
        load_link_model(path)
    np.savez(path, **{**held, "format": np.array(2)})
    with pytest.raises(InputFileError, match=r"other\.npz.*format 2"):
        load_link_model(path)


def test_a_single_point_and_a_lone_pair_are_encoded() -> None:
    from model.geometry.point_cloud import PointCloud

    for count in (1, 2, 5):
        points = np.arange(3 * count, dtype=np.float32).reshape(count, 3)
        encoding = encode(Asset("few", cloud=PointCloud(points)), shipped_border_models())
        assert len(encoding.nodes) == count


def test_without_networks_links_stay_as_the_edges_are(example) -> None:
    nodes, graph, _, _, _, _ = example
    strength = edge_strength(nodes, graph, None)
    cells = build_cells(nodes, graph, strength, edge_weight(strength, graph))
    from model.geometry.point_cloud import PointCloud

    cloud = PointCloud(nodes.points, colors=nodes.colors)
    encoding = encode(Asset("object", cloud=cloud), BorderModels())
    np.testing.assert_array_equal(encoding.cells.links.strength, cells.links.strength)
