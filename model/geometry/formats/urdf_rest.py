"""The visual meshes of a URDF in its rest pose, as one plain mesh with textures.

This reads geometry only; joints belong to ``model.kinematics.urdf``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from model.errors import InputFileError
from model.geometry.formats.loaded import Loaded, join, read_bytes
from model.geometry.formats.references import ReferenceRefused, resolve

Array = npt.NDArray[Any]
_MAX_XML = 64 << 20


def read_urdf_rest(
    path: Path, read_mesh: Callable[[Path], Loaded | None]
) -> tuple[Loaded, list[Path]]:
    """Read all visuals of ``path`` with every joint at 0, in the root link's frame.

    Args:
        path: the URDF; its meshes must lie in its folder.
        read_mesh: reads one mesh file; None where it holds nothing.

    Returns:
        The geometry and the mesh files that were read.

    Raises:
        InputFileError: on broken XML, entities, numbers that are none, and meshes outside.
    """
    root = _parse(path)
    links = {e.get("name", ""): e for e in root.findall("link")}
    pose = _poses(path, root, links)
    pieces: list[Loaded] = []
    files: list[Path] = []
    cache: dict[Path, Loaded | None] = {}
    for name, link in links.items():
        for visual in link.findall("visual"):
            geometry = visual.find("geometry")
            if geometry is None or not len(geometry):
                continue
            world = pose[name] @ _origin(path, visual.find("origin"))
            mesh = geometry.find("mesh")
            if mesh is None:
                pieces.append(_shape(path, geometry[0]).moved(world))
                continue
            target = _mesh_file(path, mesh.get("filename", ""))
            if target not in cache:
                cache[target] = read_mesh(target)
                files.append(target)
            loaded = cache[target]
            if loaded is not None:
                scale = np.eye(4)
                scale[[0, 1, 2], [0, 1, 2]] = _three(path, mesh.get("scale"), (1.0, 1.0, 1.0))
                pieces.append(loaded.moved(world @ scale))
    solid = [p for p in pieces if len(p.faces)]
    if not solid:
        raise InputFileError(path, "no link has a visual mesh", "at least one is needed")
    return join(solid), files


def _parse(path: Path) -> Element:
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        root = fromstring(read_bytes(path, _MAX_XML))
    except ParseError as error:
        raise InputFileError(path, f"is not XML: {error}", "a URDF is an XML file") from None
    except DefusedXmlException:
        raise InputFileError(
            path, "declares XML entities, which are refused", "remove the DOCTYPE"
        ) from None
    except (ValueError, LookupError) as error:  # an encoding that isn't there
        raise InputFileError(path, f"is not XML: {error}", "save it as UTF-8") from None
    if root.tag != "robot":
        raise InputFileError(path, f"begins with <{root.tag}>", "a URDF begins with <robot>")
    return root


def _poses(path: Path, root: Element, links: dict[str, Element]) -> dict[str, Array]:
    """Link → (4, 4) ``world_from_link`` with every joint at 0."""
    parent: dict[str, tuple[str, Array]] = {}
    for joint in root.findall("joint"):
        ends = [
            e.get("link", "") if e is not None else ""
            for e in (joint.find("parent"), joint.find("child"))
        ]
        for end in ends:
            if end not in links:
                raise InputFileError(path, f"joint {joint.get('name')!r} names link {end!r}, "
                                     "which doesn't exist")  # fmt: skip
        parent[ends[1]] = (ends[0], _origin(path, joint.find("origin")))
    out: dict[str, Array] = {}
    for name in links:
        chain, link = [], name
        while link in parent and link not in out:
            chain.append(link)
            link = parent[link][0]
            if len(chain) > len(links):
                raise InputFileError(path, f"its joints form a cycle through link {name!r}")
        pose = out.get(link, np.eye(4))
        out.setdefault(link, pose)
        for step in reversed(chain):
            pose = pose @ parent[step][1]
            out[step] = pose
    return out


def _mesh_file(path: Path, name: str) -> Path:
    text = name.removeprefix("file://").removeprefix("package://")
    try:
        target = resolve(text, path.parent, path.parent)
    except ReferenceRefused as error:
        raise InputFileError(path, f"mesh {error}", "keep its meshes in its folder") from None
    if not target.is_file():
        raise InputFileError(path, f"its mesh {name!r} is missing", "copy it beside the URDF")
    return target


def _shape(path: Path, element: Element) -> Loaded:
    """Boxes, cylinders and spheres as meshes."""
    import trimesh

    def number(key: str) -> float:
        try:
            value = float(element.get(key, ""))
        except ValueError:
            value = -1.0
        if not 0 < value < 1e9:
            raise InputFileError(path, f"{element.tag} with {key} {element.get(key)!r}")
        return value

    if element.tag == "box":
        made = trimesh.creation.box(_three(path, element.get("size"), (1.0, 1.0, 1.0)))
    elif element.tag == "cylinder":
        made = trimesh.creation.cylinder(number("radius"), number("length"))
    elif element.tag == "sphere":
        made = trimesh.creation.icosphere(3, number("radius"))
    else:
        raise InputFileError(path, f"geometry <{element.tag}> is unknown", "use a mesh")
    return Loaded(np.asarray(made.vertices, np.float64), np.asarray(made.faces, np.int64))


def _origin(path: Path, element: Element | None) -> Array:
    """(4, 4) of an <origin>: fixed-axis roll, pitch, yaw as URDF has it."""
    from scipy.spatial.transform import Rotation

    out = np.eye(4)
    if element is not None:
        out[:3, 3] = _three(path, element.get("xyz"), (0.0, 0.0, 0.0))
        rpy = _three(path, element.get("rpy"), (0.0, 0.0, 0.0))
        out[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    return out


def _three(path: Path, text: str | None, default: tuple[float, float, float]) -> Array:
    if text is None:
        return np.array(default)
    try:
        values = np.array([float(v) for v in text.split()])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InputFileError(path, f"{text!r} is not three numbers", "as in '0 0 0.5'")
    return values
