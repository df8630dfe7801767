"""Encode an asset once for all clicks: everything that doesn't depend on prompts."""

from __future__ import annotations

from dataclasses import dataclass

from model.core.asset import Asset
from model.core.progress import Progress, no_progress
from model.segmentation.arrays import Float32
from model.segmentation.encode.edge_strength import edge_strength, edge_weight
from model.segmentation.encode.graph import Graph, build_graph
from model.segmentation.encode.hierarchy import Hierarchy, build_hierarchy
from model.segmentation.encode.nodes import Nodes, nodes_of_asset
from model.segmentation.encode.random_walk import RandomWalk
from model.segmentation.encode.room import Room, room_of, with_borders_cut
from model.segmentation.encode.superpoints import Superpoints, build_superpoints
from model.segmentation.models.mlp import Mlp
from model.segmentation.parallel import together


@dataclass(frozen=True, eq=False)
class Encoding:
    """Nodes, graph, superpoints, merge trees and factorised walks of an asset.

    Attributes:
        strength: (M,) float32 of each edge of the node graph as a cut, 0..9.
        room: borders of a scanned room; None for an object.
    """

    nodes: Nodes
    graph: Graph
    strength: Float32
    superpoints: Superpoints
    hierarchy: Hierarchy
    walk: RandomWalk
    room: Room | None = None


def encode_superpoints(
    asset: Asset, edges: Mlp | None, progress: Progress = no_progress
) -> tuple[Nodes, Graph, Float32, Superpoints]:
    """Nodes, graph, edge strengths and superpoints of ``asset``: the first four steps."""
    progress(0.0, "sampling the surface")
    nodes = nodes_of_asset(asset)
    progress(0.15, "neighbours and normals")
    graph = build_graph(nodes)
    progress(0.45, "creases and colours")
    strength = edge_strength(nodes, graph, edges)
    progress(0.7, "small patches")
    superpoints = build_superpoints(nodes, graph, strength, edge_weight(strength, graph))
    return nodes, graph, strength, superpoints


def encode(asset: Asset, edges: Mlp | None, progress: Progress = no_progress) -> Encoding:
    """Encode ``asset``; ``edges`` is the edge model, None for the hand-set rule."""
    nodes, graph, strength, superpoints = encode_superpoints(asset, edges, progress)
    room = room_of(asset, nodes, superpoints)
    if room is not None:
        superpoints = with_borders_cut(superpoints, room)
    progress(0.8, "patches that belong together")
    # SuperLU frees memory only on the thread that allocated it: factorise on this one.
    walk, hierarchy = together(
        lambda: RandomWalk(superpoints), lambda: build_hierarchy(superpoints)
    )
    nodes.elements.prepare()
    progress(1.0, "ready")
    return Encoding(nodes, graph, strength, superpoints, hierarchy, walk, room)
