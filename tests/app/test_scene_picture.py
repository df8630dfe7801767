"""What a click in the picture of a scene means."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh

from app.server.scene_tasks import Shape
from app.viewer.picture.scene_nodes import Group, Node, Placement, first_under
from model.geometry.picking import DEFAULT_PIXEL_ANGLE


@pytest.fixture
def nodes() -> dict[str, Node]:
    """A thin lamp post, and a crate a metre beside it, both drawn at half their size."""
    out: dict[str, Node] = {}
    client: Any = None
    sizes = {"post": (0.01, 0.01, 2.0), "crate": (0.8, 0.8, 0.8)}
    for at, (name, size) in enumerate(sizes.items()):
        box = trimesh.creation.box(size)
        shape = Shape(np.asarray(box.bounds), box.vertices.astype(np.float32),
                      box.faces.astype(np.uint32))  # fmt: skip
        world = np.eye(4)
        world[0, 3] = at
        out[name] = Node(client, name, Group((name,), shape, [Placement(world, np.full(3, 0.5))]))
    return out


def picked(nodes: dict[str, Node], target: tuple[float, float, float], pixels: float) -> str | None:
    eye = np.array([0.0, -5.0, 0.0])
    away = np.array(target) - eye
    away[0] -= pixels * DEFAULT_PIXEL_ANGLE * np.linalg.norm(away)
    return first_under(list(nodes.values()), eye, away / np.linalg.norm(away))


def test_a_click_a_few_pixels_beside_a_thin_object_takes_it(nodes: dict[str, Node]) -> None:
    half = 0.0025 / (5 * DEFAULT_PIXEL_ANGLE)
    assert picked(nodes, (0, 0, 0), 0) == "post"
    assert picked(nodes, (0, 0, 0), half + 2.5) == "post"
    assert picked(nodes, (0, 0, 0), half + 6) is None
    assert picked(nodes, (0.8, 0, 0), 2.5) == "crate"


def test_what_is_met_counts_before_what_is_passed(nodes: dict[str, Node]) -> None:
    nodes["crate"].now[0].world[:2, 3] = (-0.205, 1.0)  # behind the post, to its left
    half = 0.0025 / (5 * DEFAULT_PIXEL_ANGLE)
    assert picked(nodes, (0, 0, 0), half + 2.5) == "crate"
