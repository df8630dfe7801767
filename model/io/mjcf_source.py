"""An MJCF file with all that it includes, as one text that MuJoCo compiles without touching a disk.

MuJoCo opens whatever path a file names. Here includes are put in place and meshes are read within
the file's folder first, and only what tells bodies, joints, geoms and looks is handed on: no
plug-ins, soft bodies, sensors or actuators.

Affordances are sites: boxes as wide as what is held, z the approach, x the closing axis. They are
named ``affordance_<kind>_<rank>_<joint>`` and lie on the joint's child body, so that a robot finds
with MuJoCo alone what it can do. Scenes put the object's id and a slash before.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET  # only writes; reading is MuJoCo's

import numpy as np
from scipy.spatial.transform import Rotation

from model.core.articulated_object import AFFORDANCE_KINDS, Affordance
from model.core.errors import InputFileError
from model.core.geometry import quaternion_wxyz
from model.io.formats.loaded import DEFAULT_MAX_BYTES, ReferenceRefused, read_bytes, resolve
from model.io.robot_xml import (
    ASSETS,
    DEFAULTS,
    KEPT,
    LOST,
    LOST_VALUES,
    MAX_BYTES,
    MJCF,
    ROOTS,
    WORLD,
    begins,
    parse,
)
from model.io.urdf.files import package_root
from model.io.urdf.writer import vector, xml_name

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


GROUP = 4
"""MuJoCo's viewers show sites of the groups 0 to 2 unless they are told to."""
LEAST = 5e-4
"""Metres of a site's half size; MuJoCo refuses none."""
_NAME = re.compile(rf"(?:.*/)?affordance_({'|'.join(AFFORDANCE_KINDS)})_(\d+)_")


def write_sites(body: ET.Element, affordances: Sequence[Affordance]) -> None:
    """Add those of one link to its body, best first."""
    for rank, affordance in enumerate(affordances, 1):
        z, x = -np.asarray(affordance.normal), np.asarray(affordance.closing)
        turn = np.stack([x, np.cross(z, x), z], axis=1)
        ET.SubElement(
            body,
            "site",
            name=xml_name(f"affordance_{affordance.kind}_{rank}_{affordance.joint}"),
            type="box",
            group=str(GROUP),
            rgba="0.1 0.6 0.2 0.5",
            pos=vector(affordance.center),
            quat=vector(quaternion_wxyz(turn)),
            size=vector([max(affordance.width / 2, LEAST), 0.006, 0.001]),
        )


def sites_of(model: Any, links: Sequence[str]) -> Iterator[Affordance]:
    """Affordances of a compiled model, with the joint of their body, best first.

    Args:
        model: ``MjModel``. links: name of each body.
    """
    found: list[tuple[int, Affordance]] = []
    for k in range(model.nsite):
        match = _NAME.match(model.site(k).name)
        body = int(model.site_bodyid[k])
        if match is None or not model.body_jntnum[body]:
            continue
        joint = model.joint(int(model.body_jntadr[body] + model.body_jntnum[body]) - 1).name
        w, *xyz = model.site_quat[k].tolist()
        turn = Rotation.from_quat([*xyz, w]).as_matrix()
        wide = 2 * float(model.site_size[k][0]) if match[1] in ("grasp", "turn") else 0.0
        vectors = [tuple(v.tolist()) for v in (model.site_pos[k], -turn[:, 2], turn[:, 0])]
        found.append((int(match[2]), Affordance(joint, links[body], match[1], *vectors, wide)))  # type: ignore[arg-type]
    yield from (a for _, a in sorted(found, key=lambda each: each[0]))


MJCF_SUFFIXES = (".xml", ".mjcf")
MOST_BODIES = 5000
"""More are no object; as for a URDF's links."""
MOST_GEOMS = 20_000
MOST_CELLS = 100_000_000
"""Cells of a height field: 400 MB in MuJoCo, a square kilometre by the decimetre."""
MOST_FILES = 100
"""Included ones."""
DEEPEST = 200
"""Nested elements; MuJoCo's parser calls itself for each level."""
PART_NAME = "part_name_"
"""Begins the names of the ``<custom><text>`` entries in which exports say what a link is called."""
_BEGINS = re.compile(rb"(?:\xef\xbb\xbf)?(?:\s|<\?.*?\?>|<!--.*?-->)*<mujoco[\s>/]", re.DOTALL)
_NAMED = re.compile(r"""\b(file|meshdir|assetdir|texturedir)\s*=\s*["']([^"'<>]{1,1000})["']""")
_TEXTS = ("name", "class", "childclass", "mesh", "material", "texture", "hfield", "file", "model")


@dataclass(frozen=True, eq=False)
class MjcfSource:
    """Input of MuJoCo's compiler, and the files' other content.

    Attributes:
        name: of the model.
        text: the XML, whose meshes are keys of ``assets``.
        assets: key → a mesh file's bytes.
        meshes: mesh name → its file.
        textures: texture name → its image, which may be missing.
        couplings: follower → the joint that it follows, and the coefficients of the polynomial.
        part_names: body → display name.
        files: that were included.
        notes: human-readable remarks on skipped content.
        flat: ``text`` without frames, whose content MuJoCo 4.0 doesn't compare with its schema;
            "" where there are none.
    """

    name: str
    text: str
    assets: dict[str, bytes] = field(default_factory=dict)
    meshes: dict[str, Path] = field(default_factory=dict)
    textures: dict[str, Path] = field(default_factory=dict)
    couplings: dict[str, tuple[str, list[float]]] = field(default_factory=dict)
    part_names: dict[str, str] = field(default_factory=dict)
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    flat: str = ""


def is_mjcf(path: Path) -> bool:
    """True if ``path`` is an XML file that begins with ``<mujoco>`` and isn't hidden."""
    return begins(path, MJCF_SUFFIXES, _BEGINS)


def named_files(path: Path) -> list[Path]:
    """Possible places of the files that an MJCF names, absolute; as ``urdf_model.named_meshes``, to
    find which files belong together."""
    own, root = Path(os.path.abspath(path)).parent, package_root(path)
    out: dict[Path, None] = {}
    ahead = [path.absolute()]
    for file in ahead:
        try:
            if file.stat().st_size > MAX_BYTES:
                continue
            said = _NAMED.findall(file.read_text("utf-8", "replace"))
        except OSError:
            continue
        folders = dict.fromkeys(["", *(text for key, text in said if key != "file")])
        names = dict.fromkeys(text for key, text in said if key == "file")
        for name in names:
            for start, folder in ((s, f) for s in {own, file.parent} for f in folders):
                try:
                    target = resolve(f"{folder}/{name}" if folder else name, start, root)
                except ReferenceRefused:
                    continue
                # Symbolic links aren't resolved: paths are compared with those that a search finds.
                plain = Path(os.path.normpath(Path(start, folder, name.replace("\\", "/"))))
                if target.is_file() and plain not in out:
                    out[plain] = None
                    if plain.suffix.lower() in MJCF_SUFFIXES and len(ahead) < MOST_FILES:
                        ahead.append(plain)
    return list(out)


def read_source(path: Path, root: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> MjcfSource:
    """Read an MJCF, what it includes, and its mesh files.

    Args:
        path: the file.
        root: the folder that no reference may leave.
        max_bytes: refuse larger meshes.

    Raises:
        InputFileError: naming the file and what is wrong in it.
    """
    return _Source(path, root, max_bytes).read()


class _Source:
    def __init__(self, path: Path, root: Path, max_bytes: int) -> None:
        self.path, self.root, self.max_bytes = path, root, max_bytes
        self.files: list[Path] = []
        self.notes: list[str] = []
        self.home: dict[Element, Path] = {}  # of elements that an included file brought

    def read(self) -> MjcfSource:
        top = parse(self.path, ROOTS[:1], "an MJCF")
        self._expand(top)
        self._check(top)
        said = _said(top)
        couplings = self._couplings(top)
        lost = dict.fromkeys(
            LOST[e.tag] for e in top.iter() if e.tag in LOST and len(e) + len(e.attrib)
        )
        values = ((e.tag, key) for e in top.iter() for key in e.attrib)
        lost |= dict.fromkeys(LOST_VALUES[value] for value in values if value in LOST_VALUES)
        if lost:
            self.notes.append(f"not kept: {', '.join(lost)}")
        self.notes += MJCF.unread(top)
        kept = [e for e in top if e.tag in KEPT]
        top[:] = kept
        folders = self._folders(kept)
        for element in kept:
            allowed = {"worldbody": WORLD, "default": DEFAULTS, "asset": ASSETS}
            _prune(element, allowed.get(element.tag, ()))
        name = top.get("model") or self.path.stem
        source = MjcfSource(name, "", couplings=couplings, part_names=said)
        self.pictured = {e.get("texture") for e in top.iter() if e.tag in ("material", "layer")}
        for element in (e for section in kept if section.tag == "asset" for e in section):
            self._asset(element, folders, source)
        self._count(kept)
        text, flat = ET.tostring(top, encoding="unicode"), _without_frames(top)
        files, notes = tuple(self.files), tuple(self.notes)
        return replace(source, text=text, files=files, notes=notes, flat=flat)

    # -- includes --------------------------------------------------------------------------------

    def _expand(self, top: Element) -> None:
        """Put the children of included files where these are named."""
        ahead = [top]
        read = self.path.stat().st_size
        while ahead:
            parent = ahead.pop()
            for i in reversed(range(len(parent))):
                child = parent[i]
                if child.tag != "include":
                    ahead.append(child)
                    continue
                file = self._found(child.get("file", ""), [""], self.home.get(child), "include")
                if not file.is_file():
                    what = f"is included by {self.path.name} and isn't there"
                    raise InputFileError(file, what, "put it there")
                self.files.append(file)
                read += file.stat().st_size
                if len(self.files) > MOST_FILES or read > MAX_BYTES:
                    what = f"includes more than {MOST_FILES} files or 64 MiB"
                    raise InputFileError(self.path, what, "a file can't include itself")
                brought = parse(file, ROOTS, "what an MJCF includes")
                self.home |= dict.fromkeys(brought.iter(), file.parent)
                parent[i : i + 1] = list(brought)
                ahead.append(parent)
                break

    def _found(self, name: str, folders: list[str], home: Path | None, what: str) -> Path:
        """A file inside the root: seen from the model's folder, else from that of the file that
        names it; the first place where none is there."""
        try:
            tried = [
                resolve(f"{folder}/{name}" if folder else name, start, self.root)
                for start in (self.path.parent, home)
                if start is not None
                for folder in folders
            ]
        except ReferenceRefused as error:
            remedy = "write it as seen from the model"
            if "outside" in str(error):
                remedy = "or keep it in the model's folder"
            raise InputFileError(self.path, f"{what} {error}", remedy) from None
        return next((p for p in tried if p.is_file()), tried[0])

    # -- what is in it ---------------------------------------------------------------------------

    def _check(self, top: Element) -> None:
        """Refuse NaN, endless nesting, and other models."""
        level = [top]
        for _ in range(DEEPEST):
            level = [child for element in level for child in element]
        if level:
            raise InputFileError(self.path, f"nests more than {DEEPEST} elements in each other")
        for element in top.iter():
            if element.tag == "attach":
                remedy = "have MuJoCo write it as one file"
                raise InputFileError(self.path, "attaches another model", remedy)
            for key, text in element.attrib.items():
                if key not in _TEXTS and not _finite(text):
                    name = f" {element.get('name')!r}" if element.get("name") else ""
                    what = f"{key}={text[:80]!r} of <{element.tag}>{name} is not a number"
                    raise InputFileError(self.path, what, "write finite numbers")
            element.text = element.tail = "\n"  # stray words that MuJoCo passes over

    def _couplings(self, top: Element) -> dict[str, tuple[str, list[float]]]:
        out: dict[str, tuple[str, list[float]]] = {}
        for element in top.findall("equality/*"):
            if element.get("active") == "false":
                continue
            follower, leader = element.get("joint1"), element.get("joint2")
            if element.tag != "joint" or not follower or not leader or follower == leader:
                self.notes.append(f"not kept: an equality of kind {element.tag!r}")
                continue
            try:
                terms = [float(word) for word in element.get("polycoef", "0 1").split()]
            except ValueError:
                what = f"polycoef of joint {follower!r} is not made of numbers"
                raise InputFileError(self.path, what) from None
            out[follower] = (leader, terms)
        return out

    def _folders(self, kept: list[Element]) -> dict[str, list[str]]:
        """Take over the folders of meshes and textures, and drop options that would drop or merge
        bodies and geoms."""
        out = {"mesh": "", "texture": ""}
        strip = False
        for compiler in (e for e in kept if e.tag == "compiler"):
            attributes = compiler.attrib
            both = attributes.pop("assetdir", None)
            for kind, before in out.items():
                own = attributes.pop(f"{kind}dir", both)
                out[kind] = before if own is None else own
            strip = attributes.pop("strippath", str(strip).lower()) == "true"
            for key in ("discardvisual", "fusestatic"):
                attributes.pop(key, None)
        self.strip = strip
        return {kind: [folder] for kind, folder in out.items()}

    def _asset(self, element: Element, folders: dict[str, list[str]], source: MjcfSource) -> None:
        home, name = self.home.get(element), element.get("file")
        if name is not None and self.strip:
            name = name.replace("\\", "/").rpartition("/")[2]
        if element.tag == "texture":
            self._texture(element, name, folders["texture"], source)
            return
        if element.tag == "hfield":
            self._height_field(element, name, folders["mesh"])
        if element.tag != "mesh" or name is None:
            return
        mesh = element.get("name") or Path(name.replace("\\", "/")).stem
        file = self._found(name, folders["mesh"], home, f"mesh {mesh!r}:")
        if not file.is_file():
            what = f"the mesh {mesh!r} of {self.path.name} isn't there"
            raise InputFileError(file, what, "put it there")
        key = next((k for k, f in source.meshes.items() if f == file), mesh)
        key = f"{key}{file.suffix.lower()}"
        if key not in source.assets:
            source.assets[key] = read_bytes(file, self.max_bytes)
        source.meshes[mesh] = file
        element.attrib |= {"name": mesh, "file": key}

    def _height_field(self, element: Element, name: str | None, folders: list[str]) -> None:
        """Shrink a height field, as it is left out; refuse one that MuJoCo couldn't hold."""
        sides = [_whole(element.get(key, "0")) for key in ("nrow", "ncol")]
        own = element.get("name") or Path(name or "").stem
        if name is not None and not name.lower().endswith(".png"):
            file = self._found(name, folders, self.home.get(element), f"hfield {own!r}:")
            with suppress(OSError), file.open("rb") as data:
                sides = [max(int.from_bytes(data.read(4), "little", signed=True), 0) for _ in sides]
        if math.prod(sides) > MOST_CELLS:
            what = f"the height field {own!r} has {sides[0]:,} x {sides[1]:,} cells"
            raise InputFileError(self.path, what, f"{MOST_CELLS:,} are the most")
        size = element.get("size", "1 1 1 1")
        element.attrib = {"name": own, "nrow": "2", "ncol": "2", "size": size}

    def _texture(
        self, element: Element, name: str | None, folders: list[str], source: MjcfSource
    ) -> None:
        """Replace a texture by a plain one: MuJoCo would read pixels that aren't needed."""
        stem = Path((name or "").replace("\\", "/")).stem
        own = element.get("name") or stem or f"texture_{len(source.textures)}"
        if name is None and own in self.pictured:
            self.notes.append(f"not kept: the built-in texture {own!r}")
        if name is not None:
            home = self.home.get(element)
            source.textures[own] = self._found(name, folders, home, f"texture {own!r}:")
        element.attrib = {"name": own, "type": "2d", "builtin": "flat", "width": "1", "height": "1"}

    def _count(self, kept: list[Element]) -> None:
        """Bodies and geoms, with those that are repeated."""
        found = {"body": 0, "geom": 0}
        ahead = [(e, 1) for e in kept if e.tag == "worldbody"]
        while ahead:
            element, times = ahead.pop()
            if element.tag == "replicate":
                times *= max(_whole(element.get("count", "1")), 1)
            if element.tag in found:
                found[element.tag] += times
            ahead += ((child, times) for child in element)
        if found["body"] > MOST_BODIES or found["geom"] > MOST_GEOMS:
            what = f"has {found['body']:,} bodies and {found['geom']:,} geoms"
            most = f"an object has {MOST_BODIES:,} bodies and {MOST_GEOMS:,} geoms at most"
            raise InputFileError(self.path, what, most)


def _said(top: Element) -> dict[str, str]:
    """Part names in ArtiWorld's own exports."""
    texts = ((e.get("name", ""), e.get("data", "")) for e in top.findall("custom/text"))
    return {n.removeprefix(PART_NAME): said for n, said in texts if n.startswith(PART_NAME)}


def _whole(text: str) -> int:
    """A whole number; 0 for anything else, which MuJoCo refuses."""
    return int(text) if text.strip().isdecimal() and len(text) < 20 else 0


def _finite(text: str) -> bool:
    """True unless ``text`` is made of numbers with a NaN or an infinity among them."""
    for word in text.split():
        try:
            if not math.isfinite(float(word)):
                return False
        except ValueError:
            return True
    return True


def _without_frames(top: Element) -> str:
    """The text with what frames hold in their places, "" where there are none; ``top`` is used
    up."""
    frames = ("frame", "replicate")
    if not any(element.tag in frames for element in top.iter()):
        return ""
    for parent in list(top.iter()):
        children, ahead = [], [*reversed(parent)]
        while ahead:
            child = ahead.pop()
            if child.tag in frames:
                ahead += reversed(child)
            else:
                children.append(child)
        parent[:] = children
    return ET.tostring(top, encoding="unicode")


def _prune(top: Element, allowed: tuple[str, ...]) -> None:
    """Leave out all children whose tags aren't ``allowed``; materials keep their layers, and
    bodies the sites that are affordances."""

    def keeps(parent: Element, child: Element) -> bool:
        if child.tag == "site":
            return allowed == WORLD and bool(_NAME.match(child.get("name") or ""))
        return child.tag in allowed or (parent.tag == "material" and child.tag == "layer")

    for parent in list(top.iter()):
        parent[:] = [child for child in parent if keeps(parent, child)]
