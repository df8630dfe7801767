"""Read saved assets, and load them here and in other people's software.

``asset_folder`` writes them and documents the format.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Affordance, ArticulatedObject, Part, remarks_of
from model.core.errors import ArtiworldError, GeometryError, InputFileError, KinematicsError
from model.core.files import OLD, read_json
from model.core.geometry import affine
from model.core.joint import DeclaredDynamics
from model.core.progress import Progress, no_progress
from model.core.textures import one_reading
from model.io.formats.loaded import size_of
from model.io.geometry_files import read_geometry_file
from model.io.model_files import articulated_stage, is_model, model_of, read_model, remarks_in
from model.io.tree_json import affordances_in, tree_json_problems
from model.io.urdf.files import URDF_SUFFIX
from model.io.urdf.model import DeclaredPhysics, UrdfModel
from model.io.urdf.sdf import SDF_SUFFIX
from model.io.urdf.writer import link_origins
from model.io.zips import unzipped

FORMAT = 1
URDF, TREE, PROVENANCE, MESHES = "object.urdf", "tree.json", "provenance.json", "meshes"
MIN_CLOUD = 4
"""Points below which readers take a file for damaged; such a part comes back as its mesh alone."""
DECLARED = "told"
"""Entry of ``provenance.json`` that names the masses, joints and shapes the source declared."""
COMPLETED = "completed"
"""Entry of ``provenance.json`` that names the completion of the parts' meshes."""

NO_MODEL = "is no URDF, SDF, MJCF, or USD with joints, and holds none"
NO_MODEL_REMEDY = (
    "give one, a folder with an object.urdf, or a folder or zip of these; of a scan run artiworld "
    "segment and predict first, or serve it"
)

_LOG = logging.getLogger(__name__)


def recover(folder: Path) -> None:
    """Restore an asset whose replacement was interrupted between its two renames."""
    if folder.exists() or not folder.parent.is_dir() or not folder.name:
        return
    start = f".{folder.name}."
    try:
        waiting = [
            p
            for p in folder.parent.iterdir()
            if p.name.startswith(start) and p.name.endswith(OLD) and (p / PROVENANCE).is_file()
        ]
        if waiting:
            max(waiting, key=lambda p: p.stat().st_mtime).rename(folder)
    except OSError:
        return  # the next reader of the folder reports the problem


@one_reading()
def load_object(asset: str | Path, progress: Progress = no_progress) -> ArticulatedObject:
    """The object of a saved asset, with its category, part names and clouds.

    Of a URDF or MJCF alone masses, joint dynamics and collision shapes are those of the file; of a
    saved asset those that its own source declared, while the others are computed again.

    Args:
        asset: the folder; or a URDF, SDF, MJCF, or USD with joints, a folder of one (such as a ROS
            package), or a zip of these, which have neither category nor clouds.

    Raises:
        InputFileError: for anything else, or a damaged file in it.
        ConfigurationError: for an MJCF or USD, where MuJoCo or usd-core isn't installed.
    """
    path = Path(asset)
    recover(path)
    with unzipped(path) as place:
        try:
            return _load(place, progress)
        except (GeometryError, KinematicsError) as error:
            raise InputFileError(path, str(error), "the file is damaged") from None


def _load(path: Path, progress: Progress) -> ArticulatedObject:
    """The object of a folder or file."""
    obj, declared = _read(path, progress)
    if not (path / PROVENANCE).is_file() or not (path / URDF).is_file():
        return declared.of(obj)
    kept = read_provenance(path)["asset"]
    entries = {entry["link"]: entry for entry in kept.get("parts", [])}
    remarks = remarks_in(kept)
    made = kept.get(COMPLETED)
    made_up = made if isinstance(made, dict) else {}
    parts: list[Part] = []
    for part in obj.parts:
        entry = entries.get(part.link, {})
        cloud = None
        if entry.get("cloud") and entry.get("points", 0) >= MIN_CLOUD:
            cloud = read_geometry_file(path / entry["cloud"], up_axis="z").cloud
        said = (*remarks, *part.remarks)
        words = () if cloud is None else tuple(map(str, made_up.get(part.link, ())))
        parts.append(
            replace(part, cloud=cloud, name=entry.get("name"), remarks=said, completed=words)
        )
    gives_way = kept.get("give_way")
    names = gives_way if isinstance(gives_way, list) else []
    joints = tuple(replace(j, give_way=j.name in names) for j in obj.tree.joints)
    tree = replace(obj.tree, joints=joints)
    obj = replace(obj, parts=tuple(parts), tree=tree, category=kept.get("category"))
    declared = _listed(declared, kept.get(DECLARED))
    return replace(declared, affordances=_affordances(path / TREE)).of(obj)


def _affordances(path: Path) -> tuple[Affordance, ...]:
    """Affordances of a saved tree; none in one of an earlier version."""
    if not path.is_file():
        return ()
    try:
        return affordances_in(read_json(path, "save the asset again"))
    except GeometryError as error:
        raise InputFileError(path, str(error), "save the asset again") from None


def _read(path: Path, progress: Progress) -> tuple[ArticulatedObject, DeclaredPhysics]:
    """The object of a model's file or folder, and the physics that the file declares."""
    model = _model(path)
    declared = model.declared
    for note in (*model.notes, *declared.notes):
        _LOG.warning("%s: %s", path, note)
    return model.load(progress), declared


def _model(path: Path) -> UrdfModel:
    """The model of a file, or of a folder with one.

    Raises:
        InputFileError: where it is none and holds none.
    """
    if path.is_dir():
        file = path / URDF if (path / URDF).is_file() else model_of(path)
        if file is not None:
            return read_model(file, given=path)
    elif is_model(path) or path.suffix.lower() in (URDF_SUFFIX, SDF_SUFFIX):
        return read_model(path)
    else:
        size_of(path)
        stage = articulated_stage(path)
        if stage is not None:
            return stage
    raise InputFileError(path, NO_MODEL, NO_MODEL_REMEDY)


def _listed(declared: DeclaredPhysics, entry: Any) -> DeclaredPhysics:
    """Values of ``declared`` that the entry ``told`` of a ``provenance.json`` lists."""
    named = entry if isinstance(entry, dict) else {}
    masses, dynamics, shaped = (named.get(k) for k in ("masses", "dynamics", "collision"))
    links = masses if isinstance(masses, list) else []
    kept = shaped if isinstance(shaped, list) else []
    fields = dynamics if isinstance(dynamics, dict) else {}
    return DeclaredPhysics(
        {link: i for link, i in declared.inertials.items() if link in links},
        {
            name: DeclaredDynamics(**{k: v for k, v in asdict(d).items() if k in fields[name]})
            for name, d in declared.dynamics.items()
            if isinstance(fields.get(name), list)
        },
        collision={link: c for link, c in declared.collision.items() if link in kept},
    )


def declared_links(folder: Path, what: Literal["masses", "collision"]) -> list[str] | None:
    """Links of a saved asset whose masses or collision shapes its own source declared; None where
    ``folder`` is none, and its URDF declares all of them."""
    if not (folder / PROVENANCE).is_file():
        return None
    named = read_provenance(folder)["asset"].get(DECLARED)
    links = named.get(what) if isinstance(named, dict) else None
    return links if isinstance(links, list) else []


def declared_entry(obj: ArticulatedObject, shaped: Collection[str] = ()) -> dict[str, Any]:
    """Entry ``told`` of ``provenance.json``: physics of links and joints that the source declared.

    Args:
        shaped: links whose written collision shapes the source declared.
    """
    return {
        "masses": sorted(obj.inertials),
        "dynamics": {
            j.name: [k for k, v in asdict(j.dynamics).items() if v is not None]
            for j in obj.tree.joints
            if j.dynamics is not None
        },
        "collision": sorted(shaped),
    }


def reading_notes(asset: str | Path, obj: ArticulatedObject) -> tuple[str, ...]:
    """Remarks on reading ``obj`` with :func:`load_object`: changes, and content that was skipped in
    its meshes or in the source they come from."""
    with unzipped(Path(asset)) as place:
        model = _model(place)
    return (*model.notes, *model.declared.notes, *remarks_of(obj.parts))


def read_provenance(folder: str | Path) -> dict[str, Any]:
    """``provenance.json`` of an asset folder.

    Raises:
        InputFileError: where it is missing, damaged, or of a newer format.
    """
    recover(Path(folder))
    path = Path(folder) / PROVENANCE
    data = read_json(path, "give the folder of a saved asset")
    asset = data.get("asset") if isinstance(data, dict) else None
    if not isinstance(asset, dict) or not isinstance(asset.get("format"), int):
        raise InputFileError(path, "has no 'asset' entry", "save the asset again")
    if asset["format"] > FORMAT:
        raise InputFileError(
            path, f"has format {asset['format']}, newer than {FORMAT}", "update ArtiWorld"
        )
    return data


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
    missing = (name for name in kept.get("files", {}) if not (folder / name).is_file())
    problems += [f"{name} is missing" for name in missing]
    problems += _area_problems(obj, kept)
    rng = np.random.default_rng(seed)
    settings = [random_q(obj, rng) for _ in range(configurations)]
    problems += yourdfpy_problems(folder / URDF, obj, settings)
    if mujoco and find_spec("mujoco") is not None:
        problems += mujoco_problems(folder / URDF, obj, settings)
    return problems


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


def pose_problems(
    reader: str, expected: Poses, seen: Mapping[str, np.ndarray], tolerance: float
) -> list[str]:
    """Links that are elsewhere, or missing.

    Args:
        tolerance: metres and entries of rotation matrices, in the size of the pose where that is
            above 1.
    """
    out: list[str] = []
    for link, pose in expected.items():
        if link not in seen:
            out.append(f"{reader} doesn't know the link {link!r}")
            continue
        error = float(np.abs(pose - seen[link]).max())
        if not error <= tolerance * max(1.0, float(np.abs(pose).max())):
            shown = "not a number" if math.isnan(error) else f"off by {error:.3g}"
            out.append(f"{reader} puts {link!r} elsewhere, {shown}")
    return out


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
            str(path),
            load_meshes=True,
            load_collision_meshes=True,
            build_collision_scene_graph=True,
            filename_handler=inside,
        )
        if not robot.validate():
            out += [f"yourdfpy: {error}" for error in robot.errors]
        for q in settings:
            robot.update_cfg(q)
            seen = {
                link: np.asarray(robot.get_transform(link, obj.tree.root))
                for link in obj.tree.links
            }
            out += pose_problems("yourdfpy", object_from_links(obj, q), seen, POSE_TOLERANCE)
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
            out += pose_problems("MuJoCo", object_from_links(obj, q), seen, POSE_TOLERANCE)
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
