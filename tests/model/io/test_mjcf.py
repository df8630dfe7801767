"""What MuJoCo is particular about."""

import mujoco
import numpy as np
import trimesh

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import Material, Mesh
from model.core.tree import KinematicTree
from model.io.export.mjcf import MjcfExporter


def test_a_material_on_triangles_without_area_is_left_out(tmp_path):
    box = trimesh.creation.box((0.2, 0.3, 0.4))
    line = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-17, 0]]) * 0.1
    mesh = Mesh(
        np.concatenate([box.vertices, line]),
        np.concatenate([box.faces, [[8, 9, 10]]]).astype(np.int32),
        np.array([0] * 12 + [1], np.int32),
        (Material("red", (255, 0, 0, 255)), Material("blue", (0, 0, 255, 255))),
    )
    obj = ArticulatedObject("box", (Part("link_0", mesh),), KinematicTree(("link_0",)))
    path = MjcfExporter().export(obj, tmp_path)[0]
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.ngeom == 1
    np.testing.assert_allclose(model.mat_rgba[0], (1, 0, 0, 1), atol=1e-3)
