"""Small objects, and a working folder for each test."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from model.core.geometry import Material, Mesh, PointCloud
from model.core.textures import ImageFile, SurfaceMaps, encode
from model.segmentation.default import DefaultSegmenter, DefaultSession
from tests.builders import Labelled, cabinet_cloud, cabinet_mesh


@pytest.fixture(autouse=True)
def _in_temporary_folder(tmp_path_factory, monkeypatch):
    """MuJoCo writes its warnings into a file of the working folder."""
    monkeypatch.chdir(tmp_path_factory.mktemp("cwd"))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture
def checker() -> Image.Image:
    """Four pixels: red and green above, blue and white below."""
    pixels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    return Image.fromarray(pixels)


@pytest.fixture
def textured(checker: Image.Image) -> Mesh:
    """A unit cube, half of whose faces are textured, have relief and glow, and half plain orange,
    rough metal."""
    cube = trimesh.creation.box((1, 1, 1))
    vertices = cube.vertices[cube.faces.reshape(-1)]
    relief = ImageFile(*encode(Image.new("RGB", (2, 2), (128, 128, 255))))
    maps = SurfaceMaps(normal=relief, normal_scale=0.5, emission=(2.0, 0.5, 0.0))
    uv = np.tile(np.array([[0.25, 0.25], [0.75, 0.25], [0.75, 0.75]], np.float32), (12, 1))
    return Mesh(
        vertices,
        np.arange(36, dtype=np.int32).reshape(-1, 3),
        np.repeat(np.array([0, 1], np.int32), 6),
        (
            Material("tex", (255, 255, 255, 255), checker, maps=maps),
            Material("orange", (240, 120, 30, 255), metallic=0.75, roughness=0.25),
        ),
        uv,
    )


@pytest.fixture
def ball() -> Mesh:
    sphere = trimesh.creation.icosphere(3)
    return Mesh(np.asarray(sphere.vertices), np.asarray(sphere.faces, np.int32))


@pytest.fixture
def cloud(rng: np.random.Generator) -> PointCloud:
    """2000 coloured points with normals on a box of 1 x 0.6 x 2 m."""
    box = trimesh.creation.box((1, 0.6, 2))
    points, face = trimesh.sample.sample_surface(box, 2000, seed=1)
    colors = rng.integers(0, 256, (2000, 3)).astype(np.uint8)
    return PointCloud(np.asarray(points), box.face_normals[face], colors)


@pytest.fixture(scope="session")
def cloud_cabinet() -> Labelled:
    return cabinet_cloud()


@pytest.fixture(scope="session")
def mesh_cabinet() -> Labelled:
    return cabinet_mesh()


@pytest.fixture(scope="session")
def cloud_session(cloud_cabinet: Labelled) -> DefaultSession:
    """The encoded cloud; its answers depend on the prompts alone."""
    return DefaultSegmenter().encode(cloud_cabinet.asset)


@pytest.fixture(scope="session")
def mesh_session(mesh_cabinet: Labelled) -> DefaultSession:
    return DefaultSegmenter().encode(mesh_cabinet.asset)


@pytest.fixture(scope="session")
def make_cabinet_cloud():
    """:func:`cabinet_cloud`, for tests that need another size or noise."""
    return cabinet_cloud
