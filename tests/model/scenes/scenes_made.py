"""Small assets and the same scene in every format."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from model.core.geometry import Mesh
from model.io.write import write_mesh
from tests.builders import boxes, spans


def cabinet_parts() -> dict[str, Mesh]:
    """0.6 x 0.5 x 0.8 m about its own middle, open to +x, one door and one drawer."""
    body = """
        -0.3 -0.25 -0.4  0.28 -0.23 0.4     -0.3 0.23 -0.4  0.28 0.25 0.4
        -0.3 -0.23 -0.4  0.28 0.23 -0.38    -0.3 -0.23 0.38  0.28 0.23 0.4
        -0.3 -0.23 -0.38  -0.28 0.23 0.38   -0.28 -0.23 0.09  0.28 0.23 0.11"""
    door = "0.281 -0.25 -0.4  0.3 0.25 0.1   0.3 0.2 -0.2  0.32 0.22 -0.1"
    drawer = """
        0.281 -0.25 0.105  0.3 0.25 0.4     -0.2 -0.2 0.13  0.281 0.2 0.15
        -0.2 -0.2 0.15  0.281 -0.19 0.3     -0.2 0.19 0.15  0.281 0.2 0.3"""
    tables = {"body": body, "door": door, "drawer": drawer}
    return {name: boxes(*spans(table)) for name, table in tables.items()}


def make_cabinet(folder: Path) -> Path:
    """:func:`cabinet_parts` as a folder of part meshes."""
    folder.mkdir(parents=True)
    parts = cabinet_parts()
    for i, mesh in enumerate(parts.values()):
        write_mesh(mesh, folder / f"link_{i}.obj")
    files = [{"file": f"link_{i}.obj", "name": n} for i, n in enumerate(parts)]
    described = {"format": 1, "name": folder.name, "category": "cabinet", "parts": files}
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
    turn = {"x": 0, "y": -math.degrees(YAW), "z": 0}
    pose = {"position": {"x": 1.0, "y": 0.5, "z": 2.0}, "rotation": turn}
    said = {"assetId": "cab", "id": "cabinet-0 (kitchen)", "kinematic": True, "roomId": "r1"}
    house = {"proceduralParameters": {}, "rooms": [{"id": "r1", "roomType": "kitchen"}]}
    return {**house, "walls": [], "objects": [said | pose] if objects is None else objects}


def mesatask(objects: list[dict] | None = None) -> dict:
    turn = [0, 0, math.sin(YAW / 2), math.cos(YAW / 2)]
    pose = {"position": list(POSITION), "rotation": turn, "scale_factor": [1, 1, 1]}
    said = {"instance": "cabinet_1", "retrieved_uid": "cab", "size": [0.6, 0.5, 0.8], **pose}
    return {"item_placement_zone": [0, 1, 0, 1], "objects": [said] if objects is None else objects}


def internscenes(objects: list[dict] | None = None) -> list:
    # The asset fills the box, handle included: 0.62 m deep.
    bounds = [*POSITION, 0.62, 0.5, 0.8, 0, 0, YAW]
    cabinet = {"id": 7, "category": "cabinet", "model_uid": "set/cab", "bbox": bounds}
    return [cabinet] if objects is None else objects


def lisdf(includes: str | None = None) -> str:
    cabinet = (
        f'<include name="cabinet#1"><uri>../models/Cabinet/cab/link_0.obj</uri>'
        f"<static>true</static><scale>1.0</scale>"
        f"<pose>{POSITION[0]} {POSITION[1]} {POSITION[2]} 0 0 {YAW}</pose></include>"
    )
    body = cabinet if includes is None else includes
    return f'<?xml version="1.0" ?>\n<sdf version="1.9"><world name="w">{body}</world></sdf>'


def own_object(id: str, asset: str, position: Any, turn: Any, **more: Any) -> dict[str, Any]:
    """An entry of our own scene format; ``turn`` is a quaternion, w first."""
    pose = {"position": position, "quaternion_wxyz": turn, "scale": [1, 1, 1], "anchor": "center"}
    return {"id": id, "asset": asset, **pose, **more}


def own(objects: list[dict] | None = None) -> dict:
    turn = [math.cos(YAW / 2), 0, 0, math.sin(YAW / 2)]
    cabinet = own_object("c", "cab", list(POSITION), turn, description="cabinet")
    return {"artiworld_scene": 1, "name": "w", "objects": [cabinet] if objects is None else objects}


def optiscene(objects: list[dict] | None = None) -> str:
    asked = {"object": "cabinet", "bounding box": [{"h": 0.8, "w": 0.62, "d": 0.5}]}
    x, y, z = POSITION
    pose = {"rotate": [{"angle": YAW}], "coordinates": [{"x": x, "y": y, "z": z - 0.4}]}
    cabinet = {"object": "cabinet", "asset": "cab", **pose}
    answer = {"room type": "kitchen", "objects": [cabinet] if objects is None else objects}
    design = "[Design] It stands {by} the wall."
    return f"Place {json.dumps([asked])}.\n{design}\n{json.dumps(answer)}\nDone."


def physcene(entries: list[dict] | None = None) -> dict:
    x, y, z = POSITION
    at = {"theta": YAW, "position": [x, z, -y], "centroid": [0.0, 0.0, 0.0], "scale": 1.0}
    query = {"query_label": "cabinet", "query_size": [0.31, 0.4, 0.25]}
    file = {"path": "3D-FUTURE-model/cab/raw_model.obj", "size": [0.62, 0.8, 0.5]}
    cabinet = {"label": "Cabinet", **file, **query, **at}
    return {"ThreedFront": {"cab": [cabinet] if entries is None else entries}, "GPN": {}}


def world_pose(scale: float = 1.0) -> np.ndarray:
    """(4, 4) of the cabinet in every scene."""
    out = np.eye(4)
    c, s = math.cos(YAW), math.sin(YAW)
    out[:2, :2] = [[c, -s], [s, c]]
    out[:3, :3] *= scale
    out[:3, 3] = POSITION
    return out


TO_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def write_gltf(path: Path, near: bool = False) -> Path:
    """One wrapper with the cabinet of three meshes and two equal rocks, by trimesh.

    Args:
        near: one rock stands before the cabinet's door.
    """
    import trimesh

    scene = trimesh.Scene(base_frame="world")
    rock = boxes(((0.0, 0.0, 0.0), (0.2, 0.3, 0.4)))

    def add(name: str, mesh: Mesh | None, parent: str, matrix: np.ndarray) -> None:
        turned = TO_Y_UP @ matrix @ TO_Y_UP.T
        if mesh is None:
            scene.graph.update(frame_to=name, frame_from=parent, matrix=turned)
            return
        made = trimesh.Trimesh(mesh.vertices @ TO_Y_UP[:3, :3].T, mesh.faces, process=False)
        geometry = "rock" if name.startswith("rock") else name
        scene.add_geometry(
            made, node_name=name, geom_name=geometry, parent_node_name=parent, transform=turned
        )

    add("room", None, "world", np.eye(4))
    add("cabinet", None, "room", world_pose())
    for name, mesh in cabinet_parts().items():
        add(name, mesh, "cabinet", np.eye(4))
    for i in range(2):
        at = np.eye(4)
        at[:3, 3] = [10 + i, 0, 0]
        if near and i == 0:
            at[:3, 3] = (world_pose() @ [0.6, 0.0, -0.4, 1.0])[:3]
        add(f"rock_{i}", rock, "room", at)
    scene.export(path)
    return path


def write_usd(path: Path, up: str = "Y", unit: float = 0.01) -> Path:
    """The same in units of ``unit`` metres, by usd-core."""
    from pxr import Gf, Usd, UsdGeom  # type: ignore[import-not-found]

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    turn = TO_Y_UP if up == "Y" else np.eye(4)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())

    def place(at: str, world: np.ndarray) -> None:
        xform = UsdGeom.Xform.Define(stage, at)
        matrix = turn @ world @ turn.T
        matrix[:3, 3] /= unit
        xform.AddTransformOp().Set(Gf.Matrix4d(matrix.T.tolist()))

    def shape(at: str, mesh: Mesh) -> None:
        made = UsdGeom.Mesh.Define(stage, at)
        made.CreatePointsAttr((mesh.vertices @ turn[:3, :3].T / unit).tolist())
        made.CreateFaceVertexCountsAttr([3] * len(mesh.faces))
        made.CreateFaceVertexIndicesAttr(mesh.faces.reshape(-1).tolist())
        made.CreateDisplayColorAttr([(1.0, 0.0, 0.0)])

    place("/World/cabinet", world_pose())
    for name, mesh in cabinet_parts().items():
        shape(f"/World/cabinet/{name}", mesh)
    place("/World/rock", np.eye(4))
    shape("/World/rock/mesh", boxes(((0.0, 0.0, 0.0), (0.2, 0.3, 0.4))))
    stage.GetRootLayer().Save()
    return path


def write_scan(path: Path, labels: bool = True, seed: int = 0) -> Path:
    """A room of points: floor, the cabinet and a rock; with instances beside it, or boxes."""
    from model.core.geometry import PointCloud
    from model.io.write import write_cloud

    rng = np.random.default_rng(seed)
    pose = world_pose()
    clouds, instance, classes = [], [], []

    def add(mesh: Mesh, world: np.ndarray, count: int, label: int, kind: int) -> None:
        areas = mesh.face_areas / mesh.face_areas.sum()
        corners = mesh.triangles[rng.choice(len(mesh.faces), count, p=areas)]
        weights = rng.dirichlet([1, 1, 1], count)
        points = (corners * weights[..., None]).sum(1)
        clouds.append(points @ world[:3, :3].T + world[:3, 3])
        instance.append(np.full(count, label))
        classes.append(np.full(count, kind))

    add(boxes(((-1.0, -1.0, -0.02), (3.0, 4.0, 0.0))), np.eye(4), 4000, 0, 1)
    for mesh in cabinet_parts().values():
        add(mesh, pose, 3000, 4, 2)
    add(boxes(((2.5, 0.0, 0.0), (2.7, 0.3, 0.4))), np.eye(4), 800, 5, 19)
    add(boxes(((2.5, 3.0, 0.0), (2.7, 3.3, 0.4))), np.eye(4), 20, 6, 19)
    points = np.concatenate(clouds).astype(np.float32)
    colors = np.full((len(points), 3), 150, np.uint8)
    write_cloud(PointCloud(points, colors=colors), path)
    if labels:
        held = {"instance": np.concatenate(instance), "segment20": np.concatenate(classes)}
        np.savez(path.with_name(f"{path.stem}_labels.npz"), **held)
    else:
        box = {"id": "my cabinet", "category": "cabinet", "size": [0.7, 0.6, 0.9]}
        box |= {"center": list(POSITION), "yaw": YAW}
        path.with_name(f"{path.stem}_boxes.json").write_text(json.dumps({"objects": [box]}))
    return path


def write_scene(path: Path, value: Any) -> Path:
    """A text, JSON values, or a function that writes the file."""
    if callable(value):
        return value(path)
    path.write_text(value if isinstance(value, str) else json.dumps(value))
    return path
