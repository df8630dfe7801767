"""MJCF for MuJoCo, with textures; MuJoCo's own URDF reader drops them.

One body a link, its frame as in the URDF (see ``model.io.urdf.writer``), so link poses agree.
Each material of a part is a geom of its own, as MuJoCo has one material a geom; those are for
looking at only. Collision shapes are geoms of another group that nobody sees. Maps are layers of
materials, which MuJoCo compiles and renderers of such models draw; its own viewer shows the colour.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET  # only writes; reading is defusedxml's

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Inertial
from model.core.geometry import Material, Mesh, quaternion_wxyz
from model.core.joint import JOINT_KINDS, Joint
from model.core.progress import Progress
from model.core.shapes import Primitive
from model.core.textures import ImageFile, SurfaceMaps, decode, encode, to_linear
from model.core.tree import KinematicTree
from model.io.assets.reader import MESHES
from model.io.export.formats import FileExporter
from model.io.export.part_files import file_stems, write_collision
from model.io.mjcf_source import PART_NAME, write_sites
from model.io.urdf.writer import link_origins, number, vector, xml_name
from model.io.write import write_mesh
from model.physics.affordances import find_affordances
from model.physics.part_mesh import part_mesh
from model.physics.simulation_values import Physics

FILE = "object.xml"
VISUAL_GROUP = 2
"""MuJoCo's habit for geoms that are only seen."""
COLLISION_GROUP = 3
"""And for those that are only felt."""
FRICTION_IMPEDANCE = "0.999 0.9999 0.001 0.5 2"
"""MuJoCo's friction is soft by default: a lid that it should hold sinks by six degrees a second."""
WORLD = "world"
LEAST_AREA = 1e-12
"""m² of a material on a part; nobody sees less, and MuJoCo refuses it."""


class MjcfExporter(FileExporter):
    """``object.xml`` and ``meshes/`` with one OBJ a material and PNG textures."""

    name = "mjcf"

    def write(
        self, obj: ArticulatedObject, folder: Path, physics: Physics, progress: Progress
    ) -> tuple[Path, ...]:
        """See :class:`~model.io.export.formats.FileExporter`."""
        return _Writer(obj, folder, physics).write(progress)


class _Writer:
    def __init__(self, obj: ArticulatedObject, folder: Path, physics: Physics) -> None:
        self.obj, self.folder, self.physics = obj, folder, physics
        self.origins = link_origins(obj.tree)
        self.root = ET.Element("mujoco", model=xml_name(obj.name))
        ET.SubElement(
            self.root,
            "compiler",
            angle="radian",
            meshdir=MESHES,
            texturedir=MESHES,
            autolimits="true",
        )
        self.assets = ET.SubElement(self.root, "asset")
        self.textures: set[str] = set()
        self.files: list[Path] = []

    def write(self, progress: Progress) -> tuple[Path, ...]:
        (self.folder / MESHES).mkdir(exist_ok=True)
        world = ET.SubElement(self.root, "worldbody")
        tree, inertials = self.obj.tree, self.physics.inertials
        parts = {p.link: p for p in self.obj.parts}
        stems = file_stems(list(parts))
        shapes = write_collision(
            self.physics.collision, self.obj.parts, self.folder, capsules=True, concave=False
        )
        affordances = find_affordances(self.obj, self.physics.collision)
        bodies = {tree.root: world}  # MuJoCo's own body has the name "world"
        if xml_name(tree.root) != WORLD:
            bodies = {tree.root: ET.SubElement(world, "body", name=xml_name(tree.root))}
            if not self.physics.fixed_base:
                ET.SubElement(bodies[tree.root], "freejoint")
        for i, link in enumerate(tree.order):
            progress(i / len(tree.order), f"writing {link}")
            body = bodies.get(link)
            if body is None:
                joint = tree.joint_of[link]
                body = bodies[link] = self._body(bodies[joint.parent], joint)
            if link in inertials and body is not world:
                self._inertial(body, inertials[link], link)
            if link in parts:
                self._geoms(body, part_mesh(parts[link]), link, stems[link])
            for shape in shapes.get(link, []):
                self._collision(body, shape, link)
            write_sites(body, [a for a in affordances if a.link == link])
        self._mimics(tree)
        self._names()
        self._excludes()
        path = self.folder / FILE
        ET.indent(self.root)
        path.write_bytes(ET.tostring(self.root, encoding="utf-8") + b"\n")
        progress(1.0, "written")
        return (path, *self.files)

    def _body(self, parent: ET.Element, joint: Joint) -> ET.Element:
        offset = self.origins[joint.child] - self.origins[joint.parent]
        body = ET.SubElement(parent, "body", name=xml_name(joint.child), pos=vector(offset))
        if joint.moves:
            made = ET.SubElement(
                body,
                "joint",
                name=xml_name(joint.name),
                type=JOINT_KINDS[joint.type].mjcf,
                axis=vector(joint.axis),
            )
            dynamics = self.physics.dynamics.get(joint.name)
            if dynamics is not None:
                made.set("damping", number(dynamics.damping))
                made.set("frictionloss", number(dynamics.friction))
                made.set("solimpfriction", FRICTION_IMPEDANCE)
                if dynamics.effort > 0:
                    made.set("actuatorfrcrange", vector((-dynamics.effort, dynamics.effort)))
            if joint.limited and joint.lower != joint.upper:
                made.set("range", vector((joint.lower or 0.0, joint.upper or 0.0)))
        return body

    def _inertial(self, body: ET.Element, inertial: Inertial, link: str) -> None:
        t = inertial.exact_tensor
        six = (t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2])
        ET.SubElement(
            body,
            "inertial",
            pos=vector(inertial.center - self.origins[link]),
            mass=number(inertial.mass),
            fullinertia=" ".join(map(number, six)),
        )

    def _geoms(self, body: ET.Element, mesh: Mesh, link: str, stem: str) -> None:
        for count, index in enumerate(np.unique(mesh.face_material)):
            piece = mesh.take_faces(mesh.face_material == index)
            if piece.face_areas.sum() < LEAST_AREA:
                continue
            name = f"{stem}_{count}"
            material = self._material(piece, name)
            path = self.folder / MESHES / f"{name}.obj"
            write_mesh(_plain(piece), path)
            path.with_suffix(".mtl").unlink()  # MuJoCo has the material from here
            self.files.append(path)
            # Mass comes from <inertial>; as shells flat meshes are accepted too.
            ET.SubElement(self.assets, "mesh", name=name, file=path.name, inertia="shell")
            ET.SubElement(
                body,
                "geom",
                type="mesh",
                mesh=name,
                material=material,
                pos=vector(-self.origins[link]),
                contype="0",
                conaffinity="0",
                group=str(VISUAL_GROUP),
            )

    def _collision(self, body: ET.Element, shape: str | Primitive, link: str) -> None:
        geom = ET.SubElement(body, "geom", group=str(COLLISION_GROUP))
        if isinstance(shape, str):
            path = self.folder / shape
            self.files.append(path)
            name = f"collision_{path.stem}"
            ET.SubElement(
                self.assets,
                "mesh",
                name=name,
                file=path.relative_to(self.folder / MESHES).as_posix(),
            )
            geom.attrib |= {"type": "mesh", "mesh": name, "pos": vector(-self.origins[link])}
            return
        pose = shape.object_from_shape
        halves = {"box": [s / 2 for s in shape.sizes]}.get(
            shape.kind, [shape.sizes[0], *(s / 2 for s in shape.sizes[1:])]
        )
        geom.attrib |= {
            "type": shape.kind,
            "size": vector(halves),
            "pos": vector(pose[:3, 3] - self.origins[link]),
            "quat": vector(quaternion_wxyz(pose)),
        }

    def _excludes(self) -> None:
        if self.physics.overlapping:
            contact = ET.SubElement(self.root, "contact")
            for a, b in self.physics.overlapping:
                ET.SubElement(contact, "exclude", body1=xml_name(a), body2=xml_name(b))

    def _material(self, piece: Mesh, name: str) -> str:
        look = piece.materials[0]
        color = np.asarray(look.base_color) / 255.0
        if piece.vertex_colors is not None:  # MuJoCo has no vertex colours; their mean is nearest
            color = piece.vertex_colors.mean(axis=0) / 255.0
        made = ET.SubElement(self.assets, "material", name=name, specular="0.2", shininess="0.2")
        texture = None
        if look.texture is not None and piece.uv is not None:
            texture = self._texture(ImageFile(*encode(look.texture)))
            color = np.array([1.0, 1.0, 1.0, color[3]])
        glow = _emission(look.maps, color) if look.maps.emissive is None else 0.0
        surface = {"metallic": look.metallic, "roughness": look.roughness, "emission": glow or None}
        for key, value in surface.items():
            if value is not None:
                made.set(key, f"{value:.4g}")
        made.set("rgba", " ".join(f"{v:.4g}" for v in color))
        layers = {} if piece.uv is None else _layers(look.maps)
        if texture is not None and not layers:
            made.set("texture", texture)
        elif texture is not None:  # MuJoCo takes either the attribute or layers
            ET.SubElement(made, "layer", role="rgb", texture=texture)
        for role, image in layers.items():
            ET.SubElement(made, "layer", role=role, texture=self._texture(image))
        return name

    def _texture(self, image: ImageFile) -> str:
        # Parts that were cut from one mesh have equal textures, not the same ones.
        digest = hashlib.sha256(image.data).hexdigest()[:12]
        name = f"texture_{digest}"
        if name not in self.textures:
            self.textures.add(name)
            path = self.folder / MESHES / f"{name}.png"
            decode(image.data, name).convert("RGB").save(path)
            self.files.append(path)
            ET.SubElement(self.assets, "texture", name=name, type="2d", file=path.name)
        return name

    def _names(self) -> None:
        """Names of the parts; bodies have the names of their links."""
        named = [(xml_name(p.link), p.name) for p in self.obj.parts if p.name]
        if named:
            custom = ET.SubElement(self.root, "custom")
            for link, name in named:
                ET.SubElement(custom, "text", name=PART_NAME + link, data=xml_name(name))

    def _mimics(self, tree: KinematicTree) -> None:
        followers = [j for j in tree.joints if j.moves and j.mimic is not None]
        if not followers:
            return
        equality = ET.SubElement(self.root, "equality")
        for joint in followers:
            assert joint.mimic is not None
            made = ET.SubElement(equality, "joint", joint1=joint.name, joint2=joint.mimic.joint)
            made.set("polycoef", vector([joint.mimic.offset, joint.mimic.multiplier, 0, 0, 0]))


def losses_of(obj: ArticulatedObject) -> tuple[str, ...]:
    """Material properties that MuJoCo can't represent, in words; empty where nothing is lost."""
    left: set[str] = set()
    for part in obj.parts:
        for material in part_mesh(part).materials:
            left |= _left_of(material)
    if not left:
        return ()
    return (f"MJCF has no place for {', '.join(sorted(left))} of its materials",)


def _left_of(material: Material) -> set[str]:
    maps = material.maps
    left = {
        "the scale of normal maps": maps.normal is not None and maps.normal_scale != 1.0,
        "the strength of occlusion maps": maps.occlusion_strength != 1.0,
        "the factor of emissive maps": maps.emissive is not None and set(maps.emission) != {1.0},
    }
    if any(maps.emission) and maps.emissive is None:
        color = np.asarray(material.base_color if material.texture is None else (255,) * 4) / 255.0
        written = _emission(maps, color) * to_linear(color[:3])
        left["light of another colour"] = bool(np.abs(written - maps.emission).max() > 0.02)
    return {what for what, is_lost in left.items() if is_lost}


def _layers(maps: SurfaceMaps) -> dict[str, ImageFile]:
    """Images by the roles that MuJoCo calls them by."""
    roles = {"normal": maps.normal, "occlusion": maps.occlusion, "emissive": maps.emissive}
    return {role: image for role, image in roles.items() if image is not None}


def _emission(maps: SurfaceMaps, color: npt.NDArray[np.float64]) -> float:
    """The share of its own colour that comes nearest to a surface's light; MuJoCo has no more."""
    base = to_linear(color[:3])
    share = float(base @ np.array(maps.emission)) / max(float(base @ base), 1e-9)
    return min(max(share, 0.0), 1.0)


def _plain(piece: Mesh) -> Mesh:
    """The shape and its texture coordinates alone, with the four corners that MuJoCo asks for."""
    bare = replace(
        piece,
        materials=(Material(),),
        vertex_colors=None,
        face_material=np.zeros(len(piece.faces), np.int32),
    )
    short = max(0, 4 - len(bare.vertices))
    if not short:
        return bare
    again = [*range(len(bare.vertices)), *[0] * short]
    uv = None if bare.uv is None else bare.uv[again]
    return replace(bare, vertices=bare.vertices[again], uv=uv)
