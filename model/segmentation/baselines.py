"""Three simple segmenters: nearest click, region growing, random walk.

``artiworld bench segment`` measures them beside the default segmenter.
"""

from __future__ import annotations

import time
from operator import attrgetter

import numpy as np
from cachetools import LRUCache, cachedmethod
from scipy.sparse import diags
from scipy.sparse.csgraph import dijkstra
from scipy.sparse.linalg import splu

from model.core.asset import Asset
from model.core.progress import Progress, no_progress
from model.segmentation.arrays import Bool, Float32, Int16
from model.segmentation.graph import Graph, adjacency, build_graph, edge_strength, edge_weight
from model.segmentation.nodes import Nodes, nodes_of_asset
from model.segmentation.prompt_steps import ClickStep, enforce, resolve
from model.segmentation.prompts import BASE, PartSegmentation, Prompts

_GROWTH = 25.0
_LEAK = 1e-4
_COLUMNS = 256


class _Session:
    """Nodes, graph and edge strengths; subclasses score the parts."""

    def __init__(self, name: str, asset: Asset, progress: Progress) -> None:
        self.asset = asset
        self._name = name
        progress(0.0, "sampling")
        self._nodes: Nodes = nodes_of_asset(asset)
        progress(0.3, "neighbours and normals")
        self._graph: Graph = build_graph(self._nodes)
        progress(0.6, "edges")
        self._strength = edge_strength(self._nodes, self._graph, None)
        self._prepare()
        progress(1.0, "ready")

    def _prepare(self) -> None:
        """Compute what a subclass needs once."""

    def segment(self, prompts: Prompts) -> PartSegmentation:
        """See :class:`~model.segmentation.registry.SegmentationSession`."""
        begin = time.perf_counter()
        steps = resolve(self.asset, self._nodes, prompts)
        clicks = [s for s in steps if isinstance(s, ClickStep)]
        zero = np.zeros(self.asset.element_count, np.int16)
        if not any(s.positive and s.part != BASE for s in clicks):
            labels = enforce(zero, steps, zero)
        else:
            parts, scores = self._scores(clicks)
            order = np.argsort(-scores, axis=0, kind="stable")[:2]
            first = parts[order[0]]
            second = parts[order[1]] if len(order) > 1 else first
            to_elements = self._nodes.elements.to_elements
            labels = enforce(to_elements(first), steps, to_elements(second))
        return PartSegmentation(labels, self._name, time.perf_counter() - begin)

    def candidates(self, prompts: Prompts, part: int) -> list[Bool]:
        """None: baselines have one answer."""
        return []

    def _scores(self, clicks: list[ClickStep]) -> tuple[Int16, Float32]:
        """(P,) part ids with the base, and (P, N) scores; the highest wins."""
        raise NotImplementedError


def _seeds(clicks: list[ClickStep]) -> dict[int, list[int]]:
    """Seed nodes of each part; a negative click is a seed of the base; later beats earlier."""
    owner: dict[int, int] = {}
    for click in clicks:
        owner[click.node] = click.part if click.positive else BASE
    seeds: dict[int, list[int]] = {BASE: []}
    for node, part in owner.items():
        seeds.setdefault(part, []).append(node)
    return seeds


class _NearestSession(_Session):
    def _scores(self, clicks: list[ClickStep]) -> tuple[Int16, Float32]:
        seeds = _seeds(clicks)
        points = self._nodes.points
        reach = 0.25 * self.asset.diagonal
        scores = []
        for part, nodes in seeds.items():
            nearest = np.full(len(points), reach if part == BASE else np.inf, np.float32)
            for node in nodes:
                gap = np.linalg.norm(points - points[node], axis=1)
                nearest = np.minimum(nearest, gap)
            scores.append(-nearest)
        return np.array(list(seeds), np.int16), np.stack(scores)


class _GrowingSession(_Session):
    def _prepare(self) -> None:
        graph = self._graph
        cost = graph.length / np.float32(graph.spacing) * 0.02 + self._strength + 1e-4
        self._cost = adjacency(graph.node_count, graph.a, graph.b, cost)

    def _scores(self, clicks: list[ClickStep]) -> tuple[Int16, Float32]:
        seeds = _seeds(clicks)
        scores = []
        for part, nodes in seeds.items():
            far = np.full(self._graph.node_count, np.inf)
            if nodes:
                far = dijkstra(self._cost, directed=False, indices=nodes, min_only=True)
            scores.append(-np.minimum(far, _GROWTH) if part == BASE else -far)
        return np.array(list(seeds), np.int16), np.stack(scores).astype(np.float32)


class _WalkSession(_Session):
    def _prepare(self) -> None:
        graph = self._graph
        links = adjacency(
            graph.node_count, graph.a, graph.b, edge_weight(self._strength, graph).astype(float)
        )
        degree = np.asarray(links.sum(1)).ravel()
        leak = _LEAK * float(np.median(degree)) if len(degree) else 1.0
        self._factor = splu(
            (diags(degree + max(leak, 1e-12)) - links).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        self._columns: LRUCache = LRUCache(_COLUMNS)

    @cachedmethod(attrgetter("_columns"))
    def _column(self, node: int) -> Float32:
        unit = np.zeros(self._graph.node_count)
        unit[node] = 1
        return self._factor.solve(unit).astype(np.float32)

    def _scores(self, clicks: list[ClickStep]) -> tuple[Int16, Float32]:
        seeds = _seeds(clicks)
        nodes = [n for group in seeds.values() for n in group]
        green = np.stack([self._column(n) for n in nodes], axis=1)
        inner = green[nodes].astype(np.float64)
        inner += 1e-9 * np.trace(inner) / len(nodes) * np.eye(len(nodes))
        ids = np.array(list(seeds), np.int16)
        owner = np.concatenate([np.full(len(g), i) for i, g in enumerate(seeds.values())])
        wanted = (owner[:, None] == np.arange(len(ids))).astype(np.float64)
        scores = (green @ np.linalg.solve(inner, wanted)).T
        if not seeds[BASE]:
            # Without a click on it, the base gets what the walk reaches with less than a tenth.
            scores[int(np.nonzero(ids == BASE)[0][0])] = 0.1
        return ids, scores.astype(np.float32)


class _Baseline:
    """A :class:`~model.segmentation.registry.Segmenter` around one of the sessions."""

    def __init__(self, name: str, session: type[_Session]) -> None:
        self.name = name
        self._session = session

    def encode(self, asset: Asset, progress: Progress = no_progress) -> _Session:
        """See :class:`~model.segmentation.registry.Segmenter`."""
        return self._session(self.name, asset, progress)


def nearest_click() -> _Baseline:
    """Each element goes to the nearest click; to the base beyond a quarter of the diagonal."""
    return _Baseline("nearest", _NearestSession)


def region_growing() -> _Baseline:
    """Each element goes to the click with the cheapest path over creases and colour steps."""
    return _Baseline("region-growing", _GrowingSession)


def random_walk() -> _Baseline:
    """Each element goes to the click that a random walk from it most likely reaches first.

    Grady, *Random Walks for Image Segmentation*, 2006, on the node graph with hand-set weights.
    """
    return _Baseline("random-walk", _WalkSession)
