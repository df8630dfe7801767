"""Everything the default segmenter computes once for an asset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset
from model.core.progress import Progress, no_progress
from model.segmentation.encode.edge_strength import edge_strength, edge_weight
from model.segmentation.encode.graph import Graph, build_graph
from model.segmentation.encode.hierarchy import Hierarchy, build_hierarchy
from model.segmentation.encode.nodes import Nodes, nodes_of_asset
from model.segmentation.encode.random_walk import RandomWalk
from model.segmentation.encode.room import Room, fenced, room_of
from model.segmentation.encode.superpoints import Superpoints, build_superpoints
from model.segmentation.parallel import together
from model.segmentation.score.mlp import Mlp


@dataclass(frozen=True, eq=False)
class Encoding:
    """Nodes, graph, superpoints, merge trees and factorised walks of an asset.

    Attributes:
        strength: (M,) float32 how much each edge of the node graph looks like a cut, 0..9.
        room: where the asset is a scanned room.
    """

    nodes: Nodes
    graph: Graph
    strength: npt.NDArray[np.float32]
    superpoints: Superpoints
    hierarchy: Hierarchy
    walk: RandomWalk
    room: Room | None = None


def encode_superpoints(
    asset: Asset, edges: Mlp | None, progress: Progress = no_progress
) -> tuple[Nodes, Graph, npt.NDArray[np.float32], Superpoints]:
    """Nodes, graph, strengths and superpoints of ``asset``, without what answers clicks on them."""
    progress(0.0, "sampling the surface")
    nodes = nodes_of_asset(asset)
    progress(0.15, "neighbours and normals")
    graph = build_graph(nodes)
    progress(0.45, "creases and colours")
    strength = edge_strength(nodes, graph, edges)
    progress(0.7, "small patches")
    return (
        nodes,
        graph,
        strength,
        build_superpoints(nodes, graph, strength, edge_weight(strength, graph)),
    )


def encode(asset: Asset, edges: Mlp | None, progress: Progress = no_progress) -> Encoding:
    """Over-segment ``asset``; ``edges`` is the edge model, None for the hand-set rule."""
    nodes, graph, strength, superpoints = encode_superpoints(asset, edges, progress)
    room = room_of(asset, nodes, superpoints)
    if room is not None:
        superpoints = fenced(superpoints, room)
    progress(0.8, "patches that belong together")
    # SuperLU frees only what the same thread has asked for: the factors are made on this one.
    walk, hierarchy = together(
        lambda: RandomWalk(superpoints), lambda: build_hierarchy(superpoints)
    )
    nodes.elements.prepare()
    progress(1.0, "ready")
    return Encoding(nodes, graph, strength, superpoints, hierarchy, walk, room)
