"""An object is matched with one that is done: turned, mirrored, of other proportions, noisy."""

from dataclasses import replace

import numpy as np
import pytest

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import GeometryError
from model.core.geometry import Mesh
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.geometry.like_object import POINTS, best_match, example_of
from model.geometry.sampling import sample_surface
from tests.builders import box, linked, part

DOOR = Joint(
    "hinge", "revolute", "base", "door", (0, 0, 1), (-0.4, -0.25, 0.5), lower=0.0, upper=1.7
)
DRAWER = Joint("slide", "prismatic", "base", "drawer", (0, -1, 0), (0.2, 0, 0), lower=0, upper=0.3)


def cabinet() -> ArticulatedObject:
    parts = (
        part("base", box((-0.4, -0.25, 0), (0.4, 0.25, 1.0)), name="base"),
        part("door", box((-0.4, -0.28, 0.3), (0.1, -0.25, 1.0)), name="door"),
        part("drawer", box((-0.4, -0.28, 0.02), (0.4, -0.25, 0.28)), name="drawer"),
        part("knob", box((0.02, -0.32, 0.6), (0.06, -0.28, 0.7)), name="knob"),
    )
    knob = Joint("turn", "continuous", "door", "knob", (0, -1, 0), (0.04, -0.3, 0.65))
    return ArticulatedObject(
        "cabinet", parts, KinematicTree(("base", "door", "drawer", "knob"), (DOOR, DRAWER, knob))
    )


def moved(parts: tuple[Part, ...], linear: np.ndarray) -> tuple[Part, ...]:
    out = []
    for k, p in enumerate(parts):
        assert p.mesh is not None
        faces = p.mesh.faces if np.linalg.det(linear) > 0 else p.mesh.faces[:, ::-1]
        out.append(Part(f"link_{k}", Mesh(p.mesh.vertices @ linear.T + (3, -2, 0), faces)))
    return tuple(out)


def surface_points(parts: tuple[Part, ...]) -> np.ndarray:
    rng, meshes = np.random.default_rng(0), [p.mesh for p in parts if p.mesh is not None]
    areas = [float(m.face_areas.sum()) for m in meshes]
    counts = [int(POINTS * area / sum(areas)) for area in areas]
    return np.concatenate(
        [sample_surface(*m, rng)[0].points for m in zip(meshes, counts, strict=True)]
    )


def turn(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


@pytest.mark.parametrize(
    "linear",
    [
        turn(0),
        turn(117) * 1.1,
        turn(-64) @ np.diag([1.15, 0.95, 1.05]),
        turn(30) @ np.diag([-1.0, 1.0, 1.0]),
    ],
    ids=["as it is", "turned", "other proportions", "mirrored"],
)
def test_parts_are_found_again(linear: np.ndarray) -> None:
    done = cabinet()
    parts = moved(done.parts, linear)
    match = best_match([example_of(done)], surface_points(parts))
    assert match is not None and match.fit > 0.97
    there = {f"link_{i}": k for i, k in enumerate(["base", "door", "drawer", "knob"])}
    for p in parts:
        near = match.example.tree.query(match.to_example(surface_points((p,))))[1]
        owners = np.bincount(match.example.part[near], minlength=4)
        assert match.example.links[int(owners.argmax())] == there[p.link]


def test_the_example_of_its_shape_is_chosen_and_nothing_of_another_size() -> None:
    done = example_of(cabinet())
    base = part("base", box((-0.4, -0.25, 0), (0.4, 0.25, 0.8)))
    lid = part("lid", box((-0.4, -0.25, 0.9), (0.4, 0.25, 1.0)))
    chest = linked((replace(DOOR, child="lid"),), base, lid, name="chest")
    points = surface_points(moved(cabinet().parts, turn(20)))
    match = best_match([example_of(chest), done], points)
    assert match is not None and match.example is done
    assert best_match([done], 3 * points) is None
    assert best_match([done], points * (1, 1, 2)) is None
    assert best_match([], points) is None and best_match([done], points[:5]) is None


def test_noise_and_an_open_back_lower_the_fit_only_a_little() -> None:
    done = cabinet()
    points = surface_points(moved(done.parts, turn(200)))
    rng = np.random.default_rng(0)
    seen = points[points[:, 1] < np.quantile(points[:, 1], 0.8)]
    match = best_match([example_of(done)], seen + rng.normal(0, 0.003, seen.shape))
    assert match is not None and match.fit > 0.85


def test_an_object_without_a_surface_is_refused() -> None:
    empty = Part("base", Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]])))
    with pytest.raises(GeometryError, match="no surface"):
        example_of(ArticulatedObject("empty", (empty,), KinematicTree(("base",), ())))
