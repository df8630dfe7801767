"""Reading URDF into the object's rest frame; see ``urdf`` for the writer and the conventions."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.core.articulated_object import ArticulatedObject
from model.core.composite_joints import LIFT, Composite, composite_joints, free_helpers
from model.core.errors import InputFileError
from model.core.geometry import Material, rotation_from_rpy
from model.core.joint import JOINT_KINDS, JOINT_TYPES, Joint, JointType, Mimic
from model.core.textures import TextureError, open_texture
from model.core.tree import KinematicTree, tree_problems
from model.io.formats.loaded import WHITE, ReferenceRefused
from model.io.robot_xml import URDF, parse
from model.io.urdf.files import ANYMESH, package_root, resolve_mesh, robot_of
from model.io.urdf.meshes import DeclaredCollision, UrdfVisual, repeats
from model.io.urdf.model import UrdfModel, model_from, read_declared_physics
from model.io.urdf.sdf import CENTERED, SDF_SUFFIX, SUBMESH, robot_of_sdf
from model.io.urdf.sdf_frames import LOOKS, is_true, painted

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

FloatArray = npt.NDArray[np.float64]
Poses = Mapping[str, FloatArray]
_LOG = logging.getLogger(__name__)

MOST_LINKS = 5000
"""More are no object; checking that they are a tree would take minutes."""
LARGEST = 1e6
"""Metres of a size, an offset or a limit; with more, numbers are damaged and sums overflow."""
_MOVING: dict[str, JointType] = {kind: kind for kind in JOINT_TYPES if kind != "fixed"}
_TO_FIXED = ("planar", "floating")
_VERTEX = re.compile(rb"(?m)^[ \t]*v[ \t]")
_REMEDIES = {
    "at least one link": "of a xacro file, give the URDF that xacro makes of it",
    " roots instead of one": "join what stands apart by fixed joints",
    "cycle: ": "each link but one hangs on another one by one joint",
    "leads outside": "or put a package.xml there, or the meshes into the file's folder",
    "is an absolute path": "write it as seen from the URDF",
}


def read_urdf(path: str | Path) -> ArticulatedObject:
    """Read a URDF and its meshes into the object's rest frame (all joints at 0).

    Raises:
        InputFileError: naming the file and everything that is wrong in it.
    """
    model = read_urdf_model(path)
    for note in model.notes:
        _LOG.warning("%s: %s", path, note)
    return model.load()


def read_urdf_model(
    path: str | Path,
    *,
    root: str | Path | None = None,
    lenient: bool = False,
    model: Element | None = None,
) -> UrdfModel:
    """Read a URDF without loading meshes.

    - Axes are normalised; limits stay as they are, as other readers have it.
    - Floating joints become fixed, planar ones a chain of three; ``notes`` says so.
    - Numbers that are separated by commas are read; ``notes`` says so.
    - Where no link has a visual, the collision geometry is taken.
    - Meshes that aren't there or are empty are left out where others are there; ``notes`` says so.
    - A link without geometry is a helper; it is renamed where its name begins with ``link_``.

    Args:
        path, root: as :func:`read_urdf`.
        lenient: joints with wrong values become fixed ones and are named in ``faulty``, for
            scoring what others wrote; numbers with commas are wrong there, as simulators don't
            take them. Everything else is an error as ever.
        model: one of the models in an SDF's world, else the file's only one.

    Raises:
        InputFileError: as :func:`read_urdf`.
    """
    path = Path(path)
    root = Path(root) if root is not None else package_root(path)
    return _Reader(path, root, lenient).read(model)


class _Reader:
    """Reads one file; collects problems, so that the user sees them all at once."""

    def __init__(self, path: Path, root: Path, lenient: bool = False) -> None:
        self.path, self.root, self.lenient = path, root, lenient
        self.faulty: list[str] = []
        self.swapped: list[str] = []
        self.rescaled: list[str] = []
        self.problems: list[str] = []
        self.notes: list[str] = []
        self.colors: dict[str, tuple[int, int, int, int]] = {}
        self.textures: dict[str, Material | None] = {}
        self._commas = self.moved = False
        self._planar: set[str] = set()
        self._unlimited: list[str] = []  # mimic joints that take their leader's range
        self._absent: set[Path] = set()  # meshes that aren't there or are empty

    def read(self, model: Element | None = None) -> UrdfModel:
        unread: list[str] = []
        if self.path.name == ANYMESH:
            robot = robot_of(self.path)
        elif model is not None or self.path.suffix.lower() == SDF_SUFFIX:
            robot, self.notes = robot_of_sdf(self.path, model)
        else:
            robot = parse(self.path, ("robot",), "a URDF")
            unread = URDF.unread(robot)
        self._name_looks(robot)
        links = [self._name(e, "link") for e in robot.findall("link")]
        most = max(len(links), len(robot.findall("joint")))
        if most > MOST_LINKS:
            what = f"has {most:,} links or joints"
            raise InputFileError(self.path, what, f"an object has {MOST_LINKS:,} at most")
        locals_: dict[str, FloatArray] = {}
        joints = [j for e in robot.findall("joint") if (j := self._joint(e, locals_)) is not None]
        joints = [self._followed(j, joints) for j in joints]
        joints = [one for j in joints for one in self._in_plane(j, links, locals_)]
        if self.lenient:
            joints += self._joined(links, joints, locals_)
        geometry = self._geometry(robot)
        self.notes += unread
        self.problems += tree_problems(tuple(links), tuple(joints))
        self._raise()
        object_from_link = _compose(KinematicTree(tuple(links), tuple(joints)), locals_)
        joints = [_to_object(j, object_from_link[j.child]) for j in joints]
        visuals = tuple(_in_object(v, object_from_link) for v in geometry)
        name = robot.get("name") or self.path.stem
        declared = read_declared_physics(robot, object_from_link)
        collision = self._collisions(robot, visuals, object_from_link)
        return model_from(
            self.path,
            name,
            links,
            joints,
            visuals,
            self.notes,
            replace(declared, collision=collision),
            **{key: tuple(getattr(self, key)) for key in ("faulty", "swapped", "rescaled")},
        )

    def _raise(self) -> None:
        if self.problems:
            said = "; ".join(dict.fromkeys(self.problems))
            remedies = [remedy for word, remedy in _REMEDIES.items() if word in said]
            raise InputFileError(self.path, said, "; ".join(remedies))

    # -- values ----------------------------------------------------------------------------------

    def _name(self, element: Element, what: str) -> str:
        name = element.get("name", "")
        if not name:
            self.problems.append(f"a <{what}> has no name")
        return name

    def _numbers(
        self,
        element: Element | None,
        attribute: str,
        count: int,
        default: Sequence[float],
        where: str,
    ) -> FloatArray:
        text, word = None if element is None else element.get(attribute), ""
        if element is None or text is None:
            return np.array(default, dtype=np.float64)
        try:
            values = []
            for word in self._words(element, attribute, text, count):
                values.append(float(word))
            if len(values) == count and np.isfinite(values).all():
                return np.array(values)
            self.problems.append(
                f"{where}: {attribute}={text!r} of <{element.tag}> must be {count} finite "
                f"number{'s' if count > 1 else ''}"
            )
        except ValueError:
            self.problems.append(
                f"{where}: {word!r} in {attribute}={text!r} of <{element.tag}> is not a "
                "number; write numbers with blanks between them"
            )
        return np.array(default, dtype=np.float64)

    def _words(self, element: Element, attribute: str, text: str, count: int) -> list[str]:
        """The numbers' texts. A comma after each but the last is taken for a blank, and noted;
        one anywhere else may be a decimal comma or a slip, and stays a mistake."""
        pieces = [piece.strip() for piece in text.split(",")]
        if (
            self.lenient
            or not 1 < count == len(pieces)
            or any(len(piece.split()) != 1 for piece in pieces)
        ):
            return text.split()
        if not self._commas:
            self._commas = True
            self.notes.append(
                f"numbers are separated by commas, as in {attribute}={text!r} of <{element.tag}>; "
                "they were read as if by blanks"
            )
        return pieces

    def _number(self, element: Element | None, attribute: str, default: float, where: str) -> float:
        return float(self._numbers(element, attribute, 1, [default], where)[0])

    def _pose(self, element: Element, where: str) -> FloatArray:
        origin = element.find("origin")
        out = np.eye(4)
        if origin is not None and origin.get("quat_xyzw") is not None:  # URDF 1.1
            turn = self._numbers(origin, "quat_xyzw", 4, [0, 0, 0, 1], where)
            if not np.linalg.norm(turn) > 1e-9:
                self.problems.append(f"{where}: quat_xyzw must not be zero")
                turn = np.array([0.0, 0.0, 0.0, 1.0])
            out[:3, :3] = Rotation.from_quat(turn).as_matrix()
        else:
            out[:3, :3] = rotation_from_rpy(self._numbers(origin, "rpy", 3, [0, 0, 0], where))
        out[:3, 3] = self._numbers(origin, "xyz", 3, [0, 0, 0], where)
        if np.abs(out[:3, 3]).max() > LARGEST:
            self.problems.append(f"{where}: an origin can be {LARGEST:g} m away at most")
            out[:3, 3] = 0.0
        return out

    # -- joints ----------------------------------------------------------------------------------

    def _joint(self, element: Element, locals_: dict[str, FloatArray]) -> Joint | None:
        """The joint with its axis still in the child's frame; its pose goes into ``locals_``.

        A joint with problems comes back as a fixed one, so that the tree can still be checked.
        """
        name = self._name(element, "joint")
        where = f"joint {name!r}"
        before = len(self.problems)
        parent, child = self._end(element, "parent", where), self._end(element, "child", where)
        if not (parent and child):
            return None
        if parent == child:
            self.problems.append(f"{where}: parent and child are both {child!r}")
            return None
        type_ = self._joint_type(element, where)
        locals_[name] = self._pose(element, where)
        x, y, z = self._axis(element, type_, where)
        lower, upper = self._limits(element, type_, where)
        if type_ == "revolute" and upper is None:
            type_, lower = "continuous", None
        mimic = self._mimic(element, type_, where)
        if len(self.problems) > before:
            if self.lenient and name:
                self.notes += self.problems[before:]
                del self.problems[before:]
                self.faulty.append(name)
            return Joint(name or "?", "fixed", parent, child)
        return Joint(name, type_, parent, child, (x, y, z), (0, 0, 0), lower, upper, mimic)

    def _in_plane(
        self, joint: Joint, links: list[str], locals_: dict[str, FloatArray]
    ) -> tuple[Joint, ...]:
        """A planar joint as two slides and a turn, in the child's frame."""
        if joint.name not in self._planar or not joint.moves:
            return (joint,)
        helpers = free_helpers(joint.child, 2, links)
        chain = composite_joints(Composite("planar"), joint, helpers)
        links += helpers
        # The whole way from the parent comes first.
        locals_ |= {chain[0].name: locals_[joint.name]} | {j.name: np.eye(4) for j in chain[1:]}
        self.notes.append(
            f"joint {joint.name!r} is planar: read as two slides, {LIFT:g} m either way as a "
            "guess, and a turn"
        )
        return chain

    def _followed(self, joint: Joint, joints: Sequence[Joint]) -> Joint:
        """A follower without limits has its leader's range times the multiplier."""
        leader = next((j for j in joints if joint.mimic and j.name == joint.mimic.joint), None)
        if joint.name not in self._unlimited or joint.mimic is None or leader is None:
            return joint
        if leader.lower is None or leader.upper is None:
            if joint.type != "revolute":
                return joint
            return replace(joint, type="continuous", lower=None, upper=None)
        ends = [
            joint.mimic.multiplier * q + joint.mimic.offset for q in (leader.lower, leader.upper)
        ]
        return replace(joint, lower=min(ends), upper=max(ends))

    def _joined(
        self, links: list[str], joints: list[Joint], locals_: dict[str, FloatArray]
    ) -> list[Joint]:
        """Fixed joints of what stands apart to the first root: networks leave such parts."""
        children = {j.child for j in joints}
        first, *apart = [link for link in links if link not in children] or [""]
        out = [Joint(f"{first} to {link}", "fixed", first, link) for link in apart]
        locals_.update({j.name: np.eye(4) for j in out})
        self.notes += [f"link {j.child!r} hangs on nothing; it was fixed to {first!r}" for j in out]
        return out

    def _end(self, element: Element, end: str, where: str) -> str:
        found = element.find(end)
        link = "" if found is None else found.get("link", "")
        if not link:
            self.problems.append(f'{where}: needs <{end} link="…"/>')
        return link

    def _axis(self, element: Element, type_: JointType, where: str) -> FloatArray:
        axis = self._numbers(element.find("axis"), "xyz", 3, [1, 0, 0], where)
        length = float(np.linalg.norm(axis))
        if type_ == "fixed":
            return np.array([0.0, 0.0, 1.0])
        if length < 1e-9:
            self.problems.append(f"{where}: the axis must not be zero")
        elif abs(length - 1.0) > 1e-4:
            self.rescaled.append(f"{where}: axis of length {length:g} was normalised")
            self.notes += self.rescaled[-1:]
        return axis

    def _joint_type(self, element: Element, where: str) -> JointType:
        given = element.get("type", "")
        if given == "planar" and not self.lenient:
            self._planar.add(element.get("name", ""))
            return "continuous"
        if given in _TO_FIXED:
            self.notes.append(f"{where}: {given} joints are not supported; it became fixed")
        elif given not in _MOVING and given != "fixed":
            known = ", ".join([*_MOVING, "fixed"])
            self.problems.append(f"{where}: type {given!r} is none of {known}")
        return _MOVING.get(given, "fixed")

    def _limits(
        self, element: Element, type_: JointType, where: str
    ) -> tuple[float | None, float | None]:
        """Lower and upper limit; a revolute joint without an upper one is continuous."""
        if not JOINT_KINDS[type_].limited:
            return None, None
        limit = element.find("limit")
        stated = limit is not None and ("lower" in limit.attrib or "upper" in limit.attrib)
        if not stated and element.find("mimic") is not None:
            self._unlimited.append(element.get("name", ""))
            return 0.0, 0.0
        if limit is not None and not stated:
            why = "<limit> states neither lower nor upper; it doesn't move until a range is set"
            self.notes.append(f"{where}: {why}")
        if limit is None:
            self.problems.append(f"{where}: a {type_} joint needs <limit lower=… upper=…/>")
            return None, None
        texts = [limit.get(side, "0").strip().lstrip("+-").lower() for side in ("lower", "upper")]
        if type_ == "revolute" and any(t in ("inf", "infinity") for t in texts):
            self.notes.append(f"{where}: infinite limits; it became continuous")
            return None, None
        lower = self._number(limit, "lower", 0.0, where)
        upper = self._number(limit, "upper", 0.0, where)
        if max(abs(lower), abs(upper)) > LARGEST:
            if type_ == "revolute":  # people write 1e10 for infinite
                self.notes.append(f"{where}: limits {lower:g}..{upper:g}; it became continuous")
                return None, None
            self.problems.append(f"{where}: a limit can be {LARGEST:g} m at most")
        if lower > upper:
            self.notes.append(f"{where}: limits {lower:g}..{upper:g} were swapped")
            lower, upper = upper, lower
            self.swapped.append(element.get("name", ""))
        return lower, upper

    def _mimic(self, element: Element, type_: JointType, where: str) -> Mimic | None:
        mimic = element.find("mimic")
        if mimic is None or type_ == "fixed":
            return None
        leader = mimic.get("joint", "")
        if not leader:
            self.problems.append(f"{where}: <mimic> must name a joint")
        multiplier = self._number(mimic, "multiplier", 1.0, where)
        return Mimic(leader, multiplier, self._number(mimic, "offset", 0.0, where))

    # -- geometry --------------------------------------------------------------------------------

    def _geometry(self, robot: Element) -> list[UrdfVisual]:
        """Visuals with their pose still in the link's frame."""
        tag = "visual"
        if robot.find("link/visual") is None and robot.find("link/collision") is not None:
            tag = "collision"
            self.notes.append("no link has a visual; collision geometry was taken")
        out: list[UrdfVisual] = []
        for link in robot.findall("link"):
            for element in link.findall(tag):
                visual = self._visual(element, link.get("name", ""))
                if visual is not None:
                    out.append(visual)
        return out if self.lenient else self._present(out)

    def _present(self, visuals: list[UrdfVisual]) -> list[UrdfVisual]:
        """Without meshes that aren't there or are empty, as data sets name some that never were.

        Where none is there, the file stands without its folder: loading them says so.
        """
        files = {v.file: v.link for v in visuals if v.file is not None}
        absent = {file: why for file in files if (why := _absence(file))}
        if len(absent) == len(files):
            return visuals
        for file, why in absent.items():
            self.notes.append(f"mesh {file.name!r} of link {files[file]!r} {why}: left out")
        self._absent |= absent.keys()
        return [v for v in visuals if v.file not in absent]

    def _collisions(
        self, robot: Element, visuals: Sequence[UrdfVisual], object_from_link: Poses
    ) -> dict[str, DeclaredCollision]:
        """Collision shapes by link; a mistake in one is recorded there, not as a problem of the
        file."""
        out: dict[str, DeclaredCollision] = {}
        seen = [v for v in visuals if robot.find("link/visual") is not None]
        for link in robot.findall("link"):
            name, before = link.get("name", ""), len(self.problems)
            found = [self._visual(e, name) for e in link.findall("collision")]
            wrong = self.problems[before:]
            del self.problems[before:]
            kept = [v for v in found if v is not None and v.file not in self._absent]
            pieces = tuple(_in_object(v, object_from_link) for v in kept)
            if kept or wrong:
                same = not wrong and repeats(pieces, [v for v in seen if v.link == name])
                out[name] = DeclaredCollision(pieces, wrong[0] if wrong else "", same)
        return out

    def _visual(self, element: Element, link: str) -> UrdfVisual | None:
        where = f"link {link!r}"
        pose = self._pose(element, where)
        color = self._color(element.find("material"))
        geometry = element.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None:
            self.problems.append(f"{where}: a <{element.tag}> has no geometry")
            return None
        name = element.get("name") or None
        material = self._texture(element.find("material"), where)
        if shape.tag == "mesh":
            file = self._resolve(shape.get("filename", ""), where)
            scale = self._numbers(shape, "scale", 3, [1, 1, 1], where)
            if np.abs(scale).max() > LARGEST:
                self.problems.append(f"{where}: a mesh's scale can be {LARGEST:g} at most")
            if file is None:
                return None
            frame = pose @ np.diag([*scale, 1.0])
            made = UrdfVisual(link, name, frame, file, None, color, material=material)
            return self._as_in_sdf(made, element)
        sizes: tuple[float, ...]
        if shape.tag == "box":
            sizes = tuple(self._numbers(shape, "size", 3, [1, 1, 1], where).tolist())
        elif shape.tag in ("cylinder", "sphere", "capsule"):
            wanted = ("radius",) if shape.tag == "sphere" else ("radius", "length")
            sizes = tuple(self._number(shape, key, 0.0, where) for key in wanted)
        else:
            self.problems.append(
                f"{where}: geometry <{shape.tag}> is none of mesh, box, cylinder, sphere, capsule"
            )
            return None
        if min(sizes) > 0 and max(sizes) <= LARGEST:
            shown = (shape.tag, sizes)
            made = UrdfVisual(link, name, pose, None, shown, color, material=material)
            return self._as_in_sdf(made, element)
        needed = "above 0" if min(sizes) <= 0 else f"of {LARGEST:g} m at most"
        self.problems.append(f"{where}: <{shape.tag}> needs sizes {needed}, got {sizes}")
        return None

    def _as_in_sdf(self, visual: UrdfVisual, element: Element) -> UrdfVisual:
        """With what an SDF says of it that a URDF has no word for."""
        where, looks, mesh = f"link {visual.link!r}", element.find(LOOKS), element.find(".//mesh")
        if mesh is not None and mesh.get(SUBMESH):
            visual = replace(visual, piece=(mesh.get(SUBMESH, ""), is_true(mesh.get(CENTERED, ""))))
        if looks is None:
            return visual
        try:
            found = painted(looks, lambda file: self._resolve(file, where), self.notes, where)
            return replace(visual, material=found)
        except ValueError as error:
            self.notes.append(f"{where}: material not used: {error}")
            return visual

    def _resolve(self, filename: str, where: str) -> Path | None:
        """``filename`` inside the allowed folder, or None with a problem noted."""
        refused: ReferenceRefused | None = None
        # Data sets of symbolic links: beside where the URDF really lies, too.
        for root in dict.fromkeys((self.root, self.path.resolve().parent)):
            try:
                found, elsewhere = resolve_mesh(filename, self.path.parent, root)
                if elsewhere and not self.moved:
                    self.moved = True
                    what = "mesh paths of another machine or folder"
                    self.notes.append(f"{what}: {filename!r} is {found}")
                return found
            except ReferenceRefused as error:
                refused = refused or error
        self.problems.append(f"{where}: mesh {refused}")
        return None

    def _texture(self, material: Element | None, where: str) -> Material | None:
        """The material of a ``<texture>``, by its own element or by name; None without one."""
        if material is None:
            return None
        texture, name = material.find("texture"), material.get("name", "")
        if texture is None or name in self.textures:
            return self.textures.get(name)
        file = self._resolve(texture.get("filename", ""), where)
        if file is None:
            return None
        try:
            return Material("urdf", WHITE, open_texture(file))
        except TextureError as error:
            self.notes.append(f"{where}: texture not used: {error}")
            return None

    def _name_looks(self, robot: Element) -> None:
        """Materials by name: those of the robot, then of its links, the first of a name."""
        used = robot.findall("link/visual/material")
        for material in (*robot.findall("material"), *used):
            name, color = material.get("name", ""), self._color(material)
            if color is not None and name:
                self.colors.setdefault(name, color)
            if name and len(material) and name not in self.textures:
                self.textures[name] = self._texture(material, f"material {name!r}")
        named = dict.fromkeys(m.get("name", "") for m in used)
        if lost := [repr(name) for name in named if name and name not in self.textures]:
            self.notes.append(f"materials that nothing describes: {', '.join(lost)}")

    def _color(self, material: Element | None) -> tuple[int, int, int, int] | None:
        color = None if material is None else material.find("color")
        if material is None or color is None:
            return None if material is None else self.colors.get(material.get("name", ""))
        where = f"material {material.get('name', '')!r}"
        r, g, b, a = np.clip(self._numbers(color, "rgba", 4, [0.8, 0.8, 0.8, 1], where), 0, 1)
        return round(255 * r), round(255 * g), round(255 * b), round(255 * a)


def _absence(file: Path) -> str:
    """Why a mesh file has no geometry, as far as a glance can tell; "" where it may have some."""
    if not file.is_file():
        return "isn't there"
    text = file.read_bytes() if file.suffix.lower() == ".obj" else b"v "
    return "" if file.stat().st_size and _VERTEX.search(text) else "is empty"


def _compose(tree: KinematicTree, locals_: Poses) -> dict[str, FloatArray]:
    """Link → (4, 4) ``object_from_link`` at rest."""
    out = {tree.root: np.eye(4)}
    for link in tree.order[1:]:
        joint = tree.joint_of[link]
        out[link] = out[joint.parent] @ locals_[joint.name]
    return out


def _in_object(visual: UrdfVisual, object_from_link: Poses) -> UrdfVisual:
    pose = object_from_link[visual.link] @ visual.object_from_geometry
    return replace(visual, object_from_geometry=pose)


def _to_object(joint: Joint, object_from_link: FloatArray) -> Joint:
    axis = object_from_link[:3, :3] @ np.asarray(joint.axis)
    axis[np.abs(axis) < 1e-15] = 0.0
    ox, oy, oz = object_from_link[:3, 3]
    return replace(joint, axis=tuple(axis.tolist()), origin=(ox, oy, oz))
