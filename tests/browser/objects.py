"""Small objects for the browser: quick to draw without a GPU, with known parts."""

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from tests.builders import box


def _box(size: tuple[float, ...], center: tuple[float, ...]) -> trimesh.Trimesh:
    box = trimesh.creation.box(size)
    box.apply_translation(center)
    return box


def write_cabinet(path: Path) -> dict[str, np.ndarray]:
    """A carcass with a door (left) and a drawer (right), front at -y, gaps of 4 mm.

    Returns a visible point of the carcass ("base"), the door and the drawer.
    """
    w, d, h, t = 0.8, 0.45, 0.6, 0.02
    carcass = [
        _box((w, d, t), (0, 0, t / 2)),
        _box((w, d, t), (0, 0, h - t / 2)),
        _box((t, d, h - 2 * t), (-w / 2 + t / 2, 0, h / 2)),
        _box((t, d, h - 2 * t), (w / 2 - t / 2, 0, h / 2)),
        _box((t, d, h - 2 * t), (0, 0, h / 2)),
        _box((w - 2 * t, t, h - 2 * t), (0, d / 2 - t / 2, h / 2)),
    ]
    front = -d / 2 - 0.004 - t / 2
    door = [
        _box((w / 2 - 0.01, t, h - 0.01), (-w / 4, front, h / 2)),
        _box((0.015, 0.03, 0.12), (-0.05, front - 0.025, h / 2)),
    ]
    dx, dz = w / 2 - 0.06, h - 0.08
    drawer = [
        _box((w / 2 - 0.01, t, h - 0.01), (w / 4, front, h / 2)),
        _box((0.12, 0.03, 0.015), (w / 4, front - 0.025, h / 2)),
        _box((dx, d - 0.08, 0.01), (w / 4, -0.01, 0.06)),
        _box((0.01, d - 0.08, dz / 2), (w / 4 - dx / 2, -0.01, 0.06 + dz / 4)),
        _box((0.01, d - 0.08, dz / 2), (w / 4 + dx / 2, -0.01, 0.06 + dz / 4)),
    ]
    mesh = trimesh.util.concatenate([*carcass, *door, *drawer])
    mesh.export(path)
    return {
        "base": np.array([-0.2, -0.05, h]),
        "door": np.array([-w / 4 - 0.1, front - t / 2, h * 0.7]),
        "drawer": np.array([w / 4 + 0.1, front - t / 2, h * 0.7]),
    }


URDF = """<robot name="r"><link name="body"><visual><geometry>
<mesh filename="body.ply"/></geometry></visual></link>
<link name="door"><visual><geometry><mesh filename="door.ply"/></geometry></visual></link>
<joint name="hinge" type="revolute"><origin xyz="-0.3 -0.151 0"/><axis xyz="0 0 -1"/>
<parent link="body"/><child link="door"/><limit lower="0" upper="1.2"/></joint></robot>"""


def write_urdf(folder: Path) -> Path:
    """A URDF of a cupboard whose door moves freely."""
    box((-0.3, -0.13, 0), (0.3, 0.15, 0.4)).export(folder / "body.ply")
    box((0, 0, 0), (0.6, 0.02, 0.4)).export(folder / "door.ply")
    (folder / "cupboard.urdf").write_text(URDF)
    return folder / "cupboard.urdf"


def write_cloud(path: Path, count: int = 6000) -> dict[str, np.ndarray]:
    """A cloud of a lidded chest: body and lid with a gap between."""
    body, lid = _box((0.6, 0.4, 0.3), (0, 0, 0.15)), _box((0.6, 0.4, 0.05), (0, 0, 0.34))
    points = np.concatenate(
        [
            trimesh.sample.sample_surface(body, count * 3 // 4, seed=0)[0],
            trimesh.sample.sample_surface(lid, count // 4, seed=1)[0],
        ]
    )
    colors = np.full((len(points), 4), (150, 120, 90, 255), np.uint8)
    colors[count * 3 // 4 :, :3] = (90, 120, 160)
    trimesh.PointCloud(points, colors).export(path)
    return {"base": np.array([0.1, -0.2, 0.15]), "lid": np.array([0.05, 0.02, 0.365])}


def write_flush(path: Path) -> dict[str, np.ndarray]:
    """A box of twelve triangles; its door is only painted on the front (at -y), 0.5 m by 0.6 m.

    Returns two opposite corners of the door, and a point beside it.
    """
    w, d, h = 0.8, 0.4, 1.0
    whole = _box((w, d, h), (0, 0, h / 2))
    whole.unmerge_vertices()
    uv = np.stack([whole.vertices[:, 0] / w + 0.5, whole.vertices[:, 2] / h], axis=1)
    front = np.repeat(whole.face_normals[:, 1] < -0.5, 3)
    uv = np.where(front[:, None], uv, 0.02)
    picture = np.full((200, 160, 3), (196, 178, 150), np.uint8)
    picture[40:160, 30:130] = (120, 86, 60)  # x -0.25..0.25, z 0.2..0.8
    picture[90:110, 118:124] = (220, 220, 220)
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(picture), metallicFactor=0.0, roughnessFactor=0.9
    )
    whole.visual = trimesh.visual.TextureVisuals(uv, material=material)
    whole.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))  # y up
    whole.export(path)
    return {
        "low": np.array([-0.25, -d / 2, 0.2]),
        "high": np.array([0.25, -d / 2, 0.8]),
        "beside": np.array([-0.35, -d / 2, 0.9]),
    }
