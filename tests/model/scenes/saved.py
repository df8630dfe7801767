"""What a written scene holds."""

import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from model.io.assets.asset_folder import load_object


def points_in_place(out: Path) -> np.ndarray:
    """(N, 3) points and vertices of all objects where they stand in the scene."""
    found = []
    for entry in json.loads((out / "scene.json").read_text())["objects"]:
        w, x, y, z = entry["world_from_urdf"]["quaternion_wxyz"]
        turn = Rotation.from_quat([x, y, z, w]).as_matrix()
        for part in load_object(out / entry["asset_folder"]).parts:
            held = part.mesh.vertices if part.cloud is None else part.cloud.points
            found.append(held @ turn.T + entry["world_from_urdf"]["position"])
    return np.concatenate(found)
