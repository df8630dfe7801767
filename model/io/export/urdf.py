"""URDF with OBJ meshes: for ROS, PyBullet, Isaac, SAPIEN, MuJoCo and the rest.

A ROS 2 description package is the same with launch files: ``colcon build``, then
``ros2 launch NAME display.launch.py``.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.sax.saxutils import escape

from model.core.articulated_object import ArticulatedObject
from model.core.progress import Progress
from model.io.assets.reader import URDF
from model.io.export.formats import FileExporter
from model.io.export.part_files import PartFile, is_flat, write_collision, write_parts
from model.io.urdf.writer import to_urdf_text, xml_name
from model.physics.part_mesh import part_mesh
from model.physics.simulation_values import Physics, plain_physics


class UrdfExporter(FileExporter):
    """``object.urdf`` and ``meshes/``, as in a saved asset but without its records."""

    name = "urdf"

    def write(
        self, obj: ArticulatedObject, folder: Path, physics: Physics, progress: Progress
    ) -> tuple[Path, ...]:
        """See :class:`~model.io.export.formats.FileExporter`."""
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
    text = to_urdf_text(
        obj,
        {p.link: [prefix + p.mesh] for p in parts},
        collisions=named,
        inertials=physics.inertials,
        dynamics=physics.dynamics,
        mujoco_visuals=None if prefix else not any(p.flat for p in parts),
    )
    path.write_text(text, encoding="utf-8")
    return path, tuple(folder / s for held in shapes.values() for s in held if isinstance(s, str))


PACKAGE_URDF = "urdf/object.urdf"
FOLDERS = ("launch", "meshes", "rviz", "urdf")


class RosExporter(FileExporter):
    """``package.xml``, ``CMakeLists.txt``, ``launch/``, ``rviz/``, ``urdf/`` and ``meshes/``."""

    name = "ros"

    def write(
        self, obj: ArticulatedObject, folder: Path, physics: Physics, progress: Progress
    ) -> tuple[Path, ...]:
        """See :class:`~model.io.export.formats.FileExporter`."""
        package = package_name(obj.name)
        for name in FOLDERS:
            (folder / name).mkdir(exist_ok=True)
        parts = write_parts(obj, folder, clouds=False, progress=progress)
        urdf, shapes = write_urdf_of(
            obj, parts, folder / PACKAGE_URDF, physics, f"package://{package}/"
        )
        texts = {
            "package.xml": _PACKAGE.format(
                name=package, text=escape(f"Articulated object {xml_name(obj.name)}")
            ),
            "CMakeLists.txt": _CMAKE.format(name=package, folders=" ".join(FOLDERS)),
            "launch/display.launch.py": _LAUNCH.format(name=package, urdf=PACKAGE_URDF),
            "rviz/display.rviz": _RVIZ.format(root=obj.tree.root),
        }
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        return (*(folder / n for n in texts), urdf, *(folder / p.mesh for p in parts), *shapes)


def package_name(name: str) -> str:
    """A name that ROS takes for a package (REP 144): a letter, then a-z, 0-9 and single ``_``."""
    plain = re.sub(r"_+", "_", re.sub(r"[^a-z0-9]+", "_", name.lower())).strip("_")
    if not plain or not plain[0].isalpha():
        plain = f"object_{plain}".rstrip("_")
    return f"{plain}_description"


_PACKAGE = """<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.1.0</version>
  <description>{text}</description>
  <maintainer email="user@example.com">user</maintainer>
  <license>see the source of the object</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <exec_depend>joint_state_publisher_gui</exec_depend>
  <exec_depend>launch</exec_depend>
  <exec_depend>launch_ros</exec_depend>
  <exec_depend>robot_state_publisher</exec_depend>
  <exec_depend>rviz2</exec_depend>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""

_CMAKE = """cmake_minimum_required(VERSION 3.8)
project({name})
find_package(ament_cmake REQUIRED)
install(DIRECTORY {folders} DESTINATION share/${{PROJECT_NAME}})
ament_package()
"""

_LAUNCH = '''"""Shows the object in RViz with a slider for each joint."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    share = Path(get_package_share_directory("{name}"))
    description = (share / "{urdf}").read_text(encoding="utf-8")
    return LaunchDescription([
        Node(package="robot_state_publisher", executable="robot_state_publisher",
             parameters=[{{"robot_description": description}}]),
        Node(package="joint_state_publisher_gui", executable="joint_state_publisher_gui"),
        Node(package="rviz2", executable="rviz2",
             arguments=["-d", str(share / "rviz" / "display.rviz")]),
    ])
'''

_RVIZ = """Visualization Manager:
  Class: ""
  Displays:
    - Class: rviz_default_plugins/Grid
      Enabled: true
      Name: Grid
    - Class: rviz_default_plugins/RobotModel
      Description Source: Topic
      Description Topic:
        Value: /robot_description
      Enabled: true
      Name: Object
      Visual Enabled: true
  Global Options:
    Fixed Frame: "{root}"
  Tools:
    - Class: rviz_default_plugins/MoveCamera
  Views:
    Current:
      Class: rviz_default_plugins/Orbit
      Distance: 3
"""
