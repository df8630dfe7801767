"""URDF with OBJ meshes: for ROS, PyBullet, Isaac, SAPIEN, MuJoCo and the rest."""

from __future__ import annotations

from pathlib import Path

from model.exporters.inertia import inertials_of
from model.exporters.part_files import write_parts
from model.exporters.saved import URDF
from model.kinematics.articulated_object import ArticulatedObject
from model.kinematics.urdf import write_urdf
from model.progress import Progress, no_progress


class UrdfExporter:
    """``object.urdf`` and ``meshes/``, as in a saved asset but without its records."""

    name = "urdf"
    description = "URDF with OBJ meshes and textures"

    def export(
        self, obj: ArticulatedObject, folder: Path, *, progress: Progress = no_progress
    ) -> tuple[Path, ...]:
        """See :class:`~model.exporters.protocol.Exporter`."""
        parts = write_parts(obj, folder, clouds=False, progress=progress)
        path = write_urdf(
            obj,
            folder / URDF,
            {p.link: [p.mesh] for p in parts},
            inertials=inertials_of(obj),
            mujoco_visuals=not any(p.flat for p in parts),
        )
        return (path, *(folder / p.mesh for p in parts))
