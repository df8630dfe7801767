"""Rays, boxes and brushes find what a person means."""

import time

import numpy as np
import pytest
import trimesh

from model.core.asset import Asset
from model.core.errors import GeometryError
from model.core.geometry import Mesh, PointCloud
from model.geometry.picking import Camera, Picker, Stroke

FRONT = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # looks along +y, z up


def scan(count: int, noise: float = 0.0) -> tuple[PointCloud, np.ndarray]:
    """A box of 1 x 0.6 x 2 m and its face of each point."""
    box = trimesh.creation.box((1, 0.6, 2))
    points, face = trimesh.sample.sample_surface(box, count, seed=3)
    rng = np.random.default_rng(0)
    return PointCloud((points + rng.normal(0, noise, points.shape)).astype(np.float32)), face


def test_mesh_picks_are_on_the_face_that_was_meant(ball: Mesh, rng: np.random.Generator) -> None:
    picker = Picker(Asset("ball", mesh=ball))
    for _ in range(50):
        element = int(rng.integers(len(ball.faces)))
        weights = rng.dirichlet((2, 2, 2))
        target = weights @ ball.triangles[element]
        origin = target + ball.face_normals[element] * 3 + rng.normal(0, 0.3, 3)
        pick = picker.pick(origin, (target - origin) * rng.uniform(0.1, 10))
        assert pick is not None and pick.element == element
        np.testing.assert_allclose(pick.position, target, atol=1e-6)
        np.testing.assert_allclose(pick.normal, ball.face_normals[element], atol=1e-6)
    assert picker.pick((0, 0, 5), (0, 0, 1)) is None
    inside = picker.pick((0, 0, 0), (0.1, 0.2, 1))
    assert inside is not None and inside.normal @ (0.1, 0.2, 1) < 0  # towards the eye


def test_far_camera_and_far_object_keep_precision(ball: Mesh) -> None:
    shift = np.array([4000.0, -7000.0, 12.0])
    moved = Mesh(ball.vertices + shift, ball.faces)
    target = shift + ball.triangles[17].mean(0)
    origin = target + 5000 * ball.face_normals[17]
    pick = Picker(Asset("far", mesh=moved)).pick(origin, target - origin)
    assert pick is not None and pick.element == 17
    np.testing.assert_allclose(pick.position, target, atol=1e-4)


@pytest.mark.parametrize("count", [2_000, 50_000])
def test_cloud_picks_meet_the_front_not_the_back(count: int, rng: np.random.Generator) -> None:
    cloud, _ = scan(count, noise=0.001)
    picker = Picker(Asset("scan", cloud=cloud))
    for _ in range(100):
        target = np.array([rng.uniform(-0.3, 0.3), -0.3, rng.uniform(-0.7, 0.7)])
        pick = picker.pick((0.2, -4, 0.3), target - (0.2, -4, 0.3))
        assert pick is not None
        assert pick.position[1] < -0.29
        assert np.linalg.norm(pick.position - target) < 3.5 / np.sqrt(count / 9)
        assert pick.normal @ (0, -1, 0) > 0.9
        np.testing.assert_array_equal(pick.position, cloud.points[pick.element].astype(float))
    assert picker.pick((0.2, -4, 0.3), (0, 0, 1)) is None
    assert picker.pick((0.2, -4, 0.3), (0, -1, 0)) is None  # the object is behind


def test_cloud_pick_among_a_million_points_is_quick(rng: np.random.Generator) -> None:
    cloud, _ = scan(1_000_000)
    picker = Picker(Asset("scan", cloud=cloud))
    seconds = []
    for _ in range(60):
        origin = rng.normal(size=3)
        origin *= 4 / np.linalg.norm(origin)
        began = time.process_time()
        assert picker.pick(origin, rng.uniform(-0.2, 0.2, 3) - origin) is not None
        seconds.append(time.process_time() - began)
    assert np.median(seconds) < 0.010  # about 1 ms on a free core


def test_a_ray_meets_a_thin_mesh_that_it_passes_by_a_few_pixels() -> None:
    rim = trimesh.creation.cylinder(0.04, 0.01)  # a wheel seen from its side, 2 m away
    far = rim.copy().apply_translation((0.004, 0.5, 0))
    rim.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (0, 1, 0)))
    both = trimesh.util.concatenate([rim, far])
    picker = Picker(Asset("wheel", mesh=Mesh(both.vertices, both.faces.astype(np.int32))))
    for beside in (0.0051, 0.007, 0.0135):
        pick = picker.pick((beside, -2, 0.02), (0, 1, 0))
        assert pick is not None and pick.element < len(rim.faces)
        assert abs(pick.position[0]) <= 0.005 + 1e-6, "on the surface, not on the ray"
    assert picker.pick((0.0155, -2, 0.02), (0, 1, 0)) is None
    assert picker.pick((0.0051, -2, 0.02), (0, 1, 0), pixel_angle=1e-6) is None
    # What the ray itself meets comes first, however near something else is.
    behind = picker.pick((0.0055, -2, 0.001), (0, 1, 0))
    assert behind is not None and behind.position[1] > 0.4
    hidden = np.arange(len(both.faces)) < len(rim.faces)
    assert picker.pick((0.007, -2, 0.02), (0, 1, 0), hidden=hidden) is None


def test_rays_that_are_none(ball: Mesh) -> None:
    picker = Picker(Asset("ball", mesh=ball))
    for origin, direction in (
        ((0, 0, np.nan), (0, 0, 1)),
        ((0, 0, 0), (0, 0, 0)),
        ((0, 0), (0, 1)),
    ):
        with pytest.raises(GeometryError, match="is invalid"):
            picker.pick(origin, direction)


def test_odd_clouds_can_be_picked() -> None:
    four = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    pick = Picker(Asset("four", cloud=PointCloud(four))).pick((1, 0, 5), (0, 0, -1))
    assert pick is not None and pick.element == 1
    line = np.column_stack([np.linspace(0, 1, 50), np.zeros(50), np.zeros(50)]).astype(np.float32)
    pick = Picker(Asset("line", cloud=PointCloud(line))).pick((0.5, 0, 5), (0, 0, -1))
    assert pick is not None and abs(pick.position[0] - 0.5) < 0.03
    same = np.repeat(four, 20, axis=0)
    assert Picker(Asset("same", cloud=PointCloud(same))).pick((0, 0, 5), (0, 0, -1)) is not None


def test_camera_projects_what_its_rays_meet(rng: np.random.Generator) -> None:
    from scipy.spatial.transform import Rotation

    for _ in range(20):
        turn = Rotation.random(rng=rng)
        quaternion = turn.as_quat()[[3, 0, 1, 2]]
        camera = Camera(rng.normal(size=3), quaternion, rng.uniform(0.3, 1.5), rng.uniform(0.5, 2))
        screen = rng.random(2)
        origin, direction = camera.ray(screen)
        got, depth = camera.project((origin + 3 * direction)[None])
        np.testing.assert_allclose(got[0], screen, atol=1e-9)
        assert depth[0] > 0
    up = Camera((0, -4, 0), FRONT, 1.0, 1.5).project(np.array([[0.5, 0, 1.0]]))[0][0]
    assert up[0] > 0.5 and up[1] < 0.5  # right is right, up is up
    with pytest.raises(GeometryError, match="no rotation"):
        Camera((0, 0, 0), np.ones((3, 3)), 1.0, 1.0)


def test_box_selects_what_can_be_seen() -> None:
    camera = Camera((0, -4, 0), FRONT, 1.0, 1.5)
    box = trimesh.creation.box((1, 0.6, 2)).subdivide().subdivide().subdivide()
    mesh = Mesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32))
    cloud, face = scan(40_000)
    front_points = set(np.flatnonzero(cloud.points[:, 1] < -0.2999))
    for asset, front in (
        (Asset("m", mesh=mesh), set(np.flatnonzero(mesh.face_normals[:, 1] < -0.9))),
        (Asset("c", cloud=cloud), front_points),
    ):
        picker = Picker(asset)
        seen = set(picker.select_box(camera, (0.0, 1.0), (1.0, 0.0)))
        both = set(picker.select_box(camera, (0.0, 1.0), (1.0, 0.0), visible_only=False))
        assert len(both) == asset.element_count
        assert len(front & seen) > 0.995 * len(front)
        # Hidden sides begin right behind the front's edges; nothing deeper shows through.
        assert asset.element_centers[sorted(seen)][:, 1].max() < -0.2
        half = picker.select_box(camera, (0.5, 1.0), (1.0, 0.0))
        assert (asset.element_centers[half][:, 0] >= -1e-6).all() and 0 < len(half) < len(seen)
        assert len(picker.select_box(camera, (0.0, 0.0), (0.05, 0.05))) == 0
    assert len(face) == 40_000


@pytest.mark.parametrize("kind", ["mesh", "cloud"])
def test_a_lasso_takes_what_is_inside_and_seen(kind: str) -> None:
    camera = Camera((0, -4, 0), FRONT, 1.0, 1.5)
    box = trimesh.creation.box((1, 0.6, 2)).subdivide().subdivide().subdivide()
    mesh = Mesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32))
    asset = Asset("m", mesh=mesh) if kind == "mesh" else Asset("c", cloud=scan(40_000)[0])
    corners = np.array([(-0.3, -0.3, -0.5), (0.3, -0.3, -0.5), (0, -0.3, 0.6)])
    path = tuple(map(tuple, camera.project(corners)[0]))
    found = Picker(asset).select_stroke(camera, Stroke("lasso", path))
    x, y, z = asset.element_centers[found].T
    assert len(found) and (y < -0.299).mean() > 0.995, "the back is not seen"
    x, z = x[y < -0.299], z[y < -0.299]
    assert (z > -0.505).all() and (np.abs(x) < 0.305 * (0.6 - z) / 1.1 + 0.005).all()
    away = asset.element_centers
    within = (away[:, 1] < -0.299) & (away[:, 2] > -0.49)
    within &= np.abs(away[:, 0]) < 0.295 * (0.6 - away[:, 2]) / 1.1 - 0.005
    assert np.isin(np.flatnonzero(within), found).mean() > 0.99


def test_a_brush_takes_its_trace_and_the_large_faces_under_it() -> None:
    camera = Camera((0, -4, 0), FRONT, 1.0, 1.5)
    left, right = camera.project(np.array([(-0.3, -0.3, 0.2), (0.3, -0.3, 0.2)]))[0]
    stroke = Stroke("brush", (tuple(left), tuple(right)), radius=0.02)
    cloud, _ = scan(40_000)
    found = Picker(Asset("c", cloud=cloud)).select_stroke(camera, stroke)
    x, y, z = cloud.points[found].T
    reach = 0.02 * 2 * np.tan(0.5) * 3.7
    front = y < -0.299
    assert len(found) > 500 and front.mean() > 0.99
    assert (np.abs(z[front] - 0.2) < 1.1 * reach).all()
    assert (np.abs(x[front]) < 0.3 + 1.1 * reach).all()
    box = trimesh.creation.box((1, 0.6, 2))
    mesh = Mesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32))
    faces = Picker(Asset("m", mesh=mesh)).select_stroke(camera, stroke)
    assert (mesh.face_normals[faces][:, 1] < -0.9).all() and len(faces) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("pen", ((0, 0),)), "lasso or a brush"),
        (("lasso", ()), "points"),
        (("brush", ((float("nan"), 0.0),)), "on the screen"),
        (("brush", ((0.0, 0.0),), 2.0), "radius"),
        (("lasso", ((0.5, 0.5),) * 6000), "points"),
    ],
)
def test_strokes_that_are_none_are_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        Stroke(*arguments)


def test_a_ray_passes_what_is_hidden(ball: Mesh) -> None:
    picker = Picker(Asset("ball", mesh=ball))
    front = picker.pick((0.1, -5, 0.2), (0, 1, 0))
    assert front is not None and front.position[1] < 0
    hidden = ball.triangles.mean(1)[:, 1] < 0
    back = picker.pick((0.1, -5, 0.2), (0, 1, 0), hidden=hidden)
    assert back is not None and back.position[1] > 0
    assert picker.pick((0.1, -5, 0.2), (0, 1, 0), hidden=np.ones(len(hidden), bool)) is None

    cloud, _ = scan(20_000)
    picker = Picker(Asset("scan", cloud=cloud))
    hidden = cloud.points[:, 1] < 0.29
    behind = picker.pick((0.1, -4, 0.2), (0, 1, 0), hidden=hidden)
    assert behind is not None and behind.position[1] > 0.29


@pytest.mark.parametrize("kind", ["mesh", "cloud"])
def test_a_box_takes_what_lies_behind_what_is_hidden(kind: str) -> None:
    near = trimesh.creation.box((1, 0.1, 1)).subdivide().subdivide()
    far = near.copy().apply_translation((0, 1, 0))
    both = trimesh.util.concatenate([near, far])
    if kind == "mesh":
        asset = Asset("walls", mesh=Mesh(both.vertices, both.faces.astype(np.int32)))
    else:
        points = trimesh.sample.sample_surface(both, 20_000, seed=0)[0]
        asset = Asset("walls", cloud=PointCloud(points.astype(np.float32)))
    camera = Camera((0, -4, 0), FRONT, 0.7, 1.0)
    hidden = asset.element_centers[:, 1] < 0.5
    picker = Picker(asset)
    for found in (
        picker.select_box(camera, (0.4, 0.4), (0.6, 0.6), hidden=hidden),
        picker.select_stroke(
            camera, Stroke("brush", ((0.45, 0.5), (0.55, 0.5)), 0.02), hidden=hidden
        ),
    ):
        assert len(found) and not hidden[found].any()
        assert (asset.element_centers[found, 1] < 1.0).all()  # its front, not its back
