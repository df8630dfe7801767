"""Check that a saved asset loads again, here and in other software."""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ArtiworldError
from model.core.rotations import affine
from model.io.assets.reader import TREE, URDF, load_object, read_provenance
from model.io.tree_json import tree_json_problems
from model.io.urdf.writer import link_origins

POSE_TOLERANCE = 1e-6
"""Metres, and the entries of rotation matrices."""
AREA_TOLERANCE = 1e-6
"""Relative: the parts' areas must add up to the original's."""
FILE_AREA_TOLERANCE = 1e-5
"""Relative: an OBJ keeps nine digits of each coordinate, which slivers feel."""

Poses = dict[str, npt.NDArray[np.float64]]


def reload_check(
    folder: str | Path, *, configurations: int = 5, seed: int = 0, mujoco: bool = True
) -> list[str]:
    """Problems of a saved asset; empty if there are none.

    Reads it back, compares the tree with ``tree.json`` and the areas with what was recorded, and
    compares link poses at random joint values with yourdfpy's and, where it is installed,
    MuJoCo's.

    Args:
        configurations: random joint values to try; each joint is moved beyond its limits too.
        mujoco: False leaves MuJoCo out.
    """
    folder = Path(folder)
    try:
        kept = read_provenance(folder)["asset"]
        obj = load_object(folder)
        tree = json.loads((folder / TREE).read_text(encoding="utf-8"))
    except ArtiworldError as error:
        return [str(error)]
    except (OSError, ValueError) as error:
        return [f"{folder / TREE}: {error}"]
    problems = [f"{TREE}: {p}" for p in tree_json_problems(tree, obj.tree)]
    problems += _file_problems(folder, kept)
    problems += _area_problems(obj, kept)
    rng = np.random.default_rng(seed)
    settings = [random_q(obj, rng) for _ in range(configurations)]
    problems += yourdfpy_problems(folder / URDF, obj, settings)
    if mujoco and find_spec("mujoco") is not None:
        problems += mujoco_problems(folder / URDF, obj, settings)
    return problems


def _file_problems(folder: Path, kept: dict[str, Any]) -> list[str]:
    return [f"{name} is missing" for name in kept.get("files", {}) if not (folder / name).is_file()]


def _area_problems(obj: ArticulatedObject, kept: dict[str, Any]) -> list[str]:
    out: list[str] = []
    recorded = {p["link"]: p for p in kept.get("parts", [])}
    total = 0.0
    for part in obj.parts:
        if part.mesh is None or part.link not in recorded:
            continue
        area, wanted = float(part.mesh.face_areas.sum()), float(recorded[part.link]["area"])
        total += wanted
        if abs(area - wanted) > FILE_AREA_TOLERANCE * max(wanted, 1e-300):
            out.append(f"{part.link}: area {area:.9g} m² instead of {wanted:.9g}")
    original = kept.get("original")
    if original and original["faces"]:
        whole = float(original["area"])
        if abs(total - whole) > AREA_TOLERANCE * max(whole, 1e-300):
            out.append(f"the parts' areas add up to {total:.9g} m² instead of {whole:.9g}")
    return out


def random_q(obj: ArticulatedObject, rng: np.random.Generator) -> dict[str, float]:
    """Values of the leading joints, within two radians or metres either way."""
    free = [j for j in obj.tree.joints if j.moves and j.mimic is None]
    return {j.name: float(rng.uniform(-2.0, 2.0)) for j in free}


def object_from_links(obj: ArticulatedObject, q: dict[str, float]) -> Poses:
    """Link → (4, 4) pose of its URDF frame."""
    out: Poses = {}
    origins = link_origins(obj.tree)
    for link, posed_from_rest in obj.pose(q).items():
        rest_from_link = affine(shift=origins[link])
        out[link] = posed_from_rest @ rest_from_link
    return out


def _compare(reader: str, expected: Poses, seen: Poses, out: list[str]) -> None:
    for link, pose in expected.items():
        error = float(np.abs(pose - seen[link]).max())
        scale = max(1.0, float(np.abs(pose).max()))
        if not error <= POSE_TOLERANCE * scale:
            out.append(f"{reader} puts {link!r} elsewhere, off by {error:.3g}")


def yourdfpy_problems(
    path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]
) -> list[str]:
    """Problems when yourdfpy loads a URDF of ``obj`` with its meshes and moves its joints."""
    import yourdfpy

    def inside(fname: str) -> str:
        """``package://name/rest`` is ``rest`` in the folder above that of the URDF."""
        if fname.startswith("package://"):
            return str(path.parent.parent / fname.removeprefix("package://").partition("/")[2])
        return str(path.parent / fname)

    out: list[str] = []
    with _silenced("yourdfpy.urdf"):
        robot = yourdfpy.URDF.load(
            str(path), load_meshes=True, load_collision_meshes=True,
            build_collision_scene_graph=True, filename_handler=inside,
        )  # fmt: skip
        if not robot.validate():
            out += [f"yourdfpy: {error}" for error in robot.errors]
        for q in settings:
            robot.update_cfg(q)
            seen = {
                link: np.asarray(robot.get_transform(link, obj.tree.root))
                for link in obj.tree.links
            }
            _compare("yourdfpy", object_from_links(obj, q), seen, out)
    return list(dict.fromkeys(out))


def mujoco_problems(
    path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]
) -> list[str]:
    """Problems when MuJoCo loads a URDF or MJCF of ``obj`` and moves its joints."""
    mujoco: Any = import_module("mujoco")
    out: list[str] = []
    with _mujoco_warnings() as warnings:
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            return [f"MuJoCo can't load {path.name}: {' '.join(str(error).split())}"]
        out += [f"MuJoCo warns of {path.name}: {w[:200]}" for w in warnings]
        data = mujoco.MjData(model)
        for q in settings:
            for name, value in obj.tree.joint_values(q).items():
                data.qpos[model.joint(name).qposadr[0]] = value
            mujoco.mj_kinematics(model, data)
            seen: Poses = {}
            for link in obj.tree.links:
                body = data.body(link)
                seen[link] = np.eye(4)
                seen[link][:3, :3], seen[link][:3, 3] = body.xmat.reshape(3, 3), body.xpos
            _compare("MuJoCo", object_from_links(obj, q), seen, out)
        mujoco.mj_resetData(model, data)
        mujoco.mj_step(model, data, nstep=20)
        if not np.isfinite(data.qpos).all() or data.warning.number.any():
            out.append("MuJoCo's simulation from rest is unstable")
    return list(dict.fromkeys(out))


@contextlib.contextmanager
def _silenced(logger: str) -> Iterator[None]:
    log = logging.getLogger(logger)
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)


@contextlib.contextmanager
def _mujoco_warnings() -> Iterator[list[str]]:
    """MuJoCo writes warnings into a file of the working folder; here they come into a list."""
    mujoco: Any = import_module("mujoco")
    before, out = mujoco.get_mju_user_warning(), []
    mujoco.set_mju_user_warning(out.append)
    try:
        yield out
    finally:
        mujoco.set_mju_user_warning(before)
