"""The built-in export formats in one table: who writes and reads them, and what they can't hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from model.core.articulated_object import ArticulatedObject
from model.core.packages import at_place
from model.core.progress import Progress, no_progress
from model.core.tables import table
from model.physics.affordances import find_affordances
from model.physics.simulation_values import Physics, plain_physics


class FileExporter:
    """Base of the built-in exporters; each has its row in :data:`FORMATS`."""

    name = ""

    @property
    def description(self) -> str:
        """One human-readable line."""
        return FORMATS[self.name].written

    def export(
        self,
        obj: ArticulatedObject,
        folder: Path,
        *,
        physics: Physics | None = None,
        progress: Progress = no_progress,
    ) -> tuple[Path, ...]:
        """See :class:`Exporter`."""
        return self.write(obj, folder, physics or plain_physics(obj), progress)

    def write(
        self, obj: ArticulatedObject, folder: Path, physics: Physics, progress: Progress
    ) -> tuple[Path, ...]:
        """Write the files; they are returned, the one to open first."""
        raise NotImplementedError


@dataclass(frozen=True)
class Format:
    """A built-in format: who writes and reads it, and what it can't hold.

    Attributes:
        exporter: place of its class.
        title: in documents. written: one line about its files.
        readers: name, module and place of the function of each software that reads it back.
        missing: feature of :data:`FEATURES` → why files of the format lack it.
        losses: places of functions that say, in words, what of an object is lost or not shown.
    """

    exporter: str
    title: str
    written: str
    readers: tuple[tuple[str, str, str], ...]
    missing: Mapping[str, str] = field(default_factory=dict)
    losses: tuple[str, ...] = ()


FEATURES = (
    "category of the object",
    "names of parts as people wrote them",
    "names of fixed joints",
    "colours of vertices",
    "joints, masses, collision shapes",
    "affordances",
)
"""What an object has beside its shape, and some formats lack."""
CATEGORY, _, FIXED, COLOURS, PHYSICS, AFFORDANCES = FEATURES

_HERE, _POSES = "model.io.export", "model.io.readback_poses"
_YOURDFPY = ("yourdfpy", "yourdfpy", "model.io.assets.reader:yourdfpy_problems")
_MUJOCO = ("MuJoCo", "mujoco", "model.io.assets.reader:mujoco_problems")
_BULLET = ("PyBullet", "pybullet", f"{_POSES}:bullet_problems")
_ROBOT = {CATEGORY: "no", AFFORDANCES: "no"}
_OBJ = f"{_HERE}.part_files:losses_of"

FORMATS: dict[str, Format] = {
    "urdf": Format(
        f"{_HERE}.urdf:UrdfExporter",
        "URDF",
        "URDF with meshes, collision shapes, mass, inertia, joint dynamics",
        (_YOURDFPY, _MUJOCO, _BULLET),
        _ROBOT,
        (_OBJ, f"{_HERE}.urdf:losses_of"),
    ),
    "mjcf": Format(
        f"{_HERE}.mjcf:MjcfExporter",
        "MJCF",
        "MuJoCo's MJCF with textured meshes",
        (_MUJOCO,),
        {CATEGORY: "no", FIXED: "no", COLOURS: "no, the mean"},
        (f"{_HERE}.mjcf:losses_of",),
    ),
    "glb": Format(
        f"{_HERE}.glb:GlbExporter",
        "GLB",
        "GLB with an animation of each joint; meshes are named after their parts",
        (("pygltflib", "pygltflib", f"{_POSES}:glb_problems"),),
        {CATEGORY: "no", FIXED: "no", PHYSICS: "no: an animation of each joint", AFFORDANCES: "no"},
    ),
    "ros": Format(
        f"{_HERE}.urdf:RosExporter",
        "ROS 2 package",
        "the same as URDF, as a ROS 2 package",
        ((*_YOURDFPY[:2], "model.io.readback:ros_problems"),),
        _ROBOT,
        (_OBJ,),
    ),
    "usd": Format(
        f"{_HERE}.usd:UsdExporter",
        "USD",
        "OpenUSD with UsdPhysics: joints, drives, mass, collision shapes",
        (("usd-core", "pxr", f"{_POSES}:usd_problems"),),
    ),
    "sdf": Format(
        f"{_HERE}.sdf:SdfExporter",
        "SDF",
        "SDFormat for Gazebo and Drake",
        (_BULLET, ("Drake", "pydrake", f"{_POSES}:drake_problems")),
        _ROBOT,
        (_OBJ,),
    ),
}
"""The built-in formats; a new one is a row here and a file with its exporter."""


def documented() -> tuple[list[str], list[str]]:
    """The tables of docs/formats.md: what is written, and what each format can't hold."""
    written = table(("`--format`", "what is written"), [])
    written += [f"| `{name}` | {row.written} |" for name, row in FORMATS.items()]
    held = [[row.missing.get(what, "yes") for row in FORMATS.values()] for what in FEATURES]
    rows = [(what, *cells) for what, cells in zip(FEATURES, held, strict=True)]
    return written, table(("", *(row.title for row in FORMATS.values())), rows)


def losses_of(name: str, obj: ArticulatedObject, physics: Physics | None = None) -> tuple[str, ...]:
    """Features that files of a built-in format lack or that their readers don't show.

    Args:
        physics: which the files were written with.
    """
    row, losses = FORMATS.get(name), list[str]()
    if row is None:
        return ()
    if AFFORDANCES not in row.missing and physics is not None:
        find_affordances(obj, physics.collision, remarks=losses)
    for place in row.losses:
        losses += at_place(place)(obj)
    return tuple(losses)
