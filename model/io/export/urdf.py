"""URDF with OBJ meshes: for ROS, PyBullet, Isaac, SAPIEN, MuJoCo and the rest."""

from __future__ import annotations

from pathlib import Path

from model.core.articulated_object import ArticulatedObject
from model.core.progress import Progress, no_progress
from model.io.assets.reader import URDF
from model.io.export.collision_files import write_collision
from model.io.export.part_files import PartFile, is_flat, write_parts
from model.io.urdf.writer import write_urdf
from model.physics.part_mesh import part_mesh
from model.physics.simulation_values import Physics, plain_physics


class UrdfExporter:
    """``object.urdf`` and ``meshes/``, as in a saved asset but without its records."""

    name = "urdf"
    description = "URDF with OBJ meshes and textures"

    def export(
        self,
        obj: ArticulatedObject,
        folder: Path,
        *,
        physics: Physics | None = None,
        progress: Progress = no_progress,
    ) -> tuple[Path, ...]:
        """See :class:`~model.io.export.protocol.Exporter`."""
        parts = write_parts(obj, folder, clouds=False, progress=progress)
        path, shapes = write_urdf_of(obj, parts, folder / URDF, physics)
        return (path, *(folder / p.mesh for p in parts), *shapes)


def losses_of(obj: ArticulatedObject) -> tuple[str, ...]:
    """Features that a URDF reader doesn't show, in words; empty if nothing is lost."""
    flat = [p.link for p in obj.parts if is_flat(part_mesh(p))]
    if not flat:
        return ()
    named = ", ".join(flat[:5]) + (", …" if len(flat) > 5 else "")
    return (
        f"{named} {'is' if len(flat) == 1 else 'are'} flat, which MuJoCo refuses in a URDF: there "
        "only collision shapes are seen; the format mjcf keeps what is seen in MuJoCo",
    )


def write_urdf_of(
    obj: ArticulatedObject,
    parts: tuple[PartFile, ...],
    path: Path,
    physics: Physics | None,
    prefix: str = "",
) -> tuple[Path, tuple[Path, ...]]:
    """The URDF of parts that were written, and the collision hulls beside them.

    Args:
        path: of the URDF; hulls go into the folder that the parts' names are relative to.
        prefix: before every mesh path, such as ``package://name/``; with one, the URDF lies in a
            folder below that of the meshes.
    """
    physics = physics or plain_physics(obj)
    folder = path.parent.parent if prefix else path.parent
    shapes = write_collision(physics.collision, obj.parts, folder)
    named = {
        link: [prefix + s if isinstance(s, str) else s for s in held]
        for link, held in shapes.items()
    }
    write_urdf(
        obj,
        path,
        {p.link: [prefix + p.mesh] for p in parts},
        collisions=named,
        inertials=physics.inertials,
        dynamics=physics.dynamics,
        mujoco_visuals=None if prefix else not any(p.flat for p in parts),
    )
    return path, tuple(folder / s for held in shapes.values() for s in held if isinstance(s, str))
