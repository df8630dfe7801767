"""Small assets and the same scene in every format."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from model.geometry.mesh import Mesh
from model.geometry.writers import write_mesh

CORNERS = np.array([[i >> k & 1 for k in range(3)] for i in range(8)], float)
FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]], np.int32,
)  # fmt: skip


def boxes(*spans: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Mesh:
    """Axis-parallel boxes, each from its lowest to its highest corner."""
    vertices = [np.array(a) + CORNERS * (np.array(b) - np.array(a)) for a, b in spans]
    faces = [FACES + 8 * i for i in range(len(spans))]
    return Mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.int32))


def make_cabinet(folder: Path) -> Path:
    """0.6 x 0.5 x 0.8 m about its own middle, open to +x, one door and one drawer."""
    folder.mkdir(parents=True)
    walls = (
        ((-0.3, -0.25, -0.4), (0.28, -0.23, 0.4)), ((-0.3, 0.23, -0.4), (0.28, 0.25, 0.4)),
        ((-0.3, -0.23, -0.4), (0.28, 0.23, -0.38)), ((-0.3, -0.23, 0.38), (0.28, 0.23, 0.4)),
        ((-0.3, -0.23, -0.38), (-0.28, 0.23, 0.38)), ((-0.28, -0.23, 0.09), (0.28, 0.23, 0.11)),
    )  # fmt: skip
    door = (((0.281, -0.25, -0.4), (0.3, 0.25, 0.1)), ((0.3, 0.2, -0.2), (0.32, 0.22, -0.1)))
    drawer = (
        ((0.281, -0.25, 0.105), (0.3, 0.25, 0.4)), ((-0.2, -0.2, 0.13), (0.281, 0.2, 0.15)),
        ((-0.2, -0.2, 0.15), (0.281, -0.19, 0.3)), ((-0.2, 0.19, 0.15), (0.281, 0.2, 0.3)),
    )  # fmt: skip
    for i, spans in enumerate((walls, door, drawer)):
        write_mesh(boxes(*spans), folder / f"link_{i}.obj")
    names = ("body", "door", "drawer")
    described = {
        "format": 1, "name": folder.name, "category": "cabinet",
        "parts": [{"file": f"link_{i}.obj", "name": n} for i, n in enumerate(names)],
    }  # fmt: skip
    (folder / "object.json").write_text(json.dumps(described))
    return folder


def make_assets(folder: Path) -> Path:
    """``cab``, and a rigid ``rock`` of one piece."""
    make_cabinet(folder / "cab")
    write_mesh(boxes(((0.0, 0.0, 0.0), (0.2, 0.3, 0.4))), folder / "rock.obj")
    return folder


POSITION, YAW = (1.0, 2.0, 0.5), 0.7
"""Where the cabinet stands in every scene below: metres, and radians about +z."""


def holodeck(objects: list[dict] | None = None) -> dict:
    cabinet = {
        "assetId": "cab", "id": "cabinet-0 (kitchen)", "kinematic": True, "roomId": "r1",
        "position": {"x": 1.0, "y": 0.5, "z": 2.0},
        "rotation": {"x": 0, "y": -math.degrees(YAW), "z": 0},
    }  # fmt: skip
    return {
        "proceduralParameters": {}, "rooms": [{"id": "r1", "roomType": "kitchen"}], "walls": [],
        "objects": [cabinet] if objects is None else objects,
    }  # fmt: skip


def mesatask(objects: list[dict] | None = None) -> dict:
    cabinet = {
        "instance": "cabinet_1", "retrieved_uid": "cab", "position": list(POSITION),
        "rotation": [0, 0, math.sin(YAW / 2), math.cos(YAW / 2)], "size": [0.6, 0.5, 0.8],
        "scale_factor": [1, 1, 1],
    }  # fmt: skip
    return {
        "item_placement_zone": [0, 1, 0, 1],
        "objects": [cabinet] if objects is None else objects,
    }


def internscenes(objects: list[dict] | None = None) -> list:
    # The asset fills the box, handle included: 0.62 m deep.
    cabinet = {
        "id": 7, "category": "cabinet", "model_uid": "set/cab",
        "bbox": [*POSITION, 0.62, 0.5, 0.8, 0, 0, YAW],
    }  # fmt: skip
    return [cabinet] if objects is None else objects


def lisdf(includes: str | None = None) -> str:
    cabinet = (
        f'<include name="cabinet#1"><uri>../models/Cabinet/cab/link_0.obj</uri>'
        f"<static>true</static><scale>1.0</scale>"
        f"<pose>{POSITION[0]} {POSITION[1]} {POSITION[2]} 0 0 {YAW}</pose></include>"
    )
    body = cabinet if includes is None else includes
    return f'<?xml version="1.0" ?>\n<sdf version="1.9"><world name="w">{body}</world></sdf>'


def own(objects: list[dict] | None = None) -> dict:
    cabinet = {
        "id": "c", "description": "cabinet", "asset": "cab", "position": list(POSITION),
        "quaternion_wxyz": [math.cos(YAW / 2), 0, 0, math.sin(YAW / 2)], "scale": [1, 1, 1],
        "anchor": "center",
    }  # fmt: skip
    return {"artiworld_scene": 1, "name": "w", "objects": [cabinet] if objects is None else objects}


def write_scene(path: Path, value: object) -> Path:
    path.write_text(value if isinstance(value, str) else json.dumps(value))
    return path
