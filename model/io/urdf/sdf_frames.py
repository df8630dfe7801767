"""Frames of an SDF model: nested and included models, and poses that hang on each other; looks of
its visuals.

A name counts in its own model; ``front::door`` is the link ``door`` of the nested model ``front``
(sdformat.org, *Pose frame semantics* and *Model composition*).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET  # only makes elements; reading is defusedxml's

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.core.errors import InputFileError
from model.core.geometry import Material, affine, rotation_from_rpy, rpy_from_rotation
from model.core.textures import TextureError, open_texture
from model.io.formats.loaded import ReferenceRefused, resolve
from model.io.robot_xml import parse
from model.io.urdf.files import MODEL_URI, gazebo_model, package_root, upwards

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


FloatArray = npt.NDArray[np.float64]
WORLD = "world"
_MODEL = "__model__"
_MOST_MODELS, _MOST_AHEAD = 200, 200


def said(element: Element, path: str) -> str:
    """The text of an element below, without white space around; "" where there is none."""
    return (element.findtext(path) or "").strip()


def numbers_in(text: str, count: int, what: str) -> FloatArray:
    """(count,) finite numbers.

    Raises:
        ValueError: naming ``what`` is wrong.
    """
    words = text.split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        raise ValueError(f"{what} is {text[:80]!r}; numbers are needed") from None
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"{what} is {text[:80]!r}; it needs {count} finite numbers")
    return values


def pose_of(element: Element) -> FloatArray:
    """(4, 4) of an element's ``<pose>``: Euler angles, in degrees where it says so, or x y z w.

    Raises:
        ValueError: saying what is wrong with it.
    """
    given = element.find("pose")
    text = "" if given is None else (given.text or "").strip()
    if given is None or not text:
        return np.eye(4)
    style = given.get("rotation_format", "euler_rpy")
    counts = {"euler_rpy": 6, "quat_xyzw": 7}
    if style not in counts:
        raise ValueError(f"its rotation_format {style!r} is unknown")
    values = numbers_in(text, counts[style], "pose")
    if style == "quat_xyzw":
        if np.linalg.norm(values[3:]) < 1e-9:
            raise ValueError(f"its quaternion {values[3:].tolist()} (x y z w) is zero")
        return affine(Rotation.from_quat(values[3:]).as_matrix(), values[:3])
    if is_true(given.get("degrees", "")):
        values[3:] = np.radians(values[3:])
    return affine(rotation_from_rpy(values[3:]), values[:3])


def is_true(text: str) -> bool:
    """True if an SDF's boolean says so."""
    return text.strip().lower() in ("true", "1")


class Frames:
    """Links, joints, frames and nested models of a model by their full names.

    Included models are put into their places; the pose of each is that of its origin.

    Args:
        model: changed.
        path: of the file, beside which included models are looked for.

    Attributes:
        links, joints: full name → element.
        prefix: element → prefix of the model that it stands in, as ``front::``.
        notes: human-readable remarks on what isn't read.
    """

    def __init__(self, model: Element, path: Path) -> None:
        self.links: dict[str, Element] = {}
        self.joints: list[Element] = []
        self.prefix: dict[Element, str] = {}
        self.notes: list[str] = []
        self._path, self._count = path, 0
        self._named: dict[str, Element] = {}
        self._models: dict[str, Element] = {}
        self._places: dict[str, FloatArray] = {_MODEL: np.eye(4)}
        self._add(model, "", "")

    def _add(self, model: Element, prefix: str, above: str) -> None:
        self._one_more()
        self._models[prefix], self.prefix[model] = model, above
        while (include := model.find("include")) is not None:
            self._include(model, include)
        for tag in ("link", "frame", "joint"):  # the first counts of those with one name
            for element in model.findall(tag):
                name = prefix + element.get("name", "")
                self.prefix[element] = prefix
                self._named.setdefault(name, element)
                if tag == "link":
                    self.links[name] = element
                elif tag == "joint":
                    self.joints.append(element)
        for inner in model.findall("model"):
            placed_at_origin(inner, self._path)
            self._add(inner, f"{prefix}{inner.get('name', '')}::", prefix)

    def _one_more(self) -> None:
        self._count += 1
        if self._count > _MOST_MODELS:
            raise ValueError(f"more than {_MOST_MODELS} models in it, or one that includes itself")

    def _include(self, model: Element, include: Element) -> None:
        """Put the model in the place of its ``<include>``; a merged one's content stands in the
        frame ``_merged__…``."""
        model.remove(include)
        self._one_more()
        uri = said(include, "uri")
        file = find_model(uri, self._path)
        if file is None:
            self.notes.append(f"<include> of {uri!r} is left out: no model is there")
            return
        found = _included(include, file, self._path.parent)
        if not is_true(include.get("merge", "")):
            model.append(found)
            return
        placed_at_origin(found, self._path)
        proxy = f"_merged__{found.get('name')}__model__"
        ET.SubElement(model, "frame", name=proxy).extend(found.findall("pose"))
        for element in found:
            if element.tag not in ("link", "model", "frame", "joint", "include"):
                continue
            if element.tag != "joint" and not element.get("attached_to"):
                own = element.find("pose")
                own = ET.SubElement(element, "pose") if own is None else own
                own.set("relative_to", own.get("relative_to") or proxy)
            for each in element.iter() if element.tag != "model" else element.findall("pose"):
                for key in ("relative_to", "attached_to", "expressed_in"):
                    if each.get(key) == _MODEL:
                        each.set(key, proxy)
            model.append(element)

    def place(self, name: str, prefix: str = "", ahead: tuple[str, ...] = ()) -> FloatArray:
        """(4, 4) model_from_frame of what is called ``name`` in the model at ``prefix``.

        Raises:
            ValueError: where there is no such frame, or poses hang on each other.
        """
        key = self._key(name, prefix)
        if key not in self._places:
            if key in ahead:
                raise ValueError(f"the poses of {' → '.join((*ahead, key))} hang on each other")
            if len(ahead) > _MOST_AHEAD:
                raise ValueError(f"poses hang on more than {_MOST_AHEAD} others")
            ahead = (*ahead, key)
            if key not in self._named:
                self._places[key] = self.within(self._models[key.removesuffix(_MODEL)], "", ahead)
            else:
                self._places[key] = self.place_of(self._named[key], ahead)
        return self._places[key]

    def place_of(self, element: Element, ahead: tuple[str, ...] = ()) -> FloatArray:
        """(4, 4) model_from_frame of a link, joint or frame."""
        above = element.get("attached_to", "")
        if element.tag == "joint":
            above = said(element, "child")
        return self.within(element, "" if above == WORLD else above, ahead)

    def within(self, element: Element, above: str, ahead: tuple[str, ...] = ()) -> FloatArray:
        """(4, 4) of an element's pose, relative to ``above`` where it says nothing else."""
        given = element.find("pose")
        declared = "" if given is None else given.get("relative_to", given.get("frame", ""))
        try:
            own = pose_of(element)
        except ValueError as error:
            raise ValueError(f"<{element.tag}> {element.get('name', '')!r}: {error}") from None
        return self.place(declared or above, self.prefix[element], ahead) @ own

    def _key(self, name: str, prefix: str) -> str:
        full = prefix + (name or _MODEL)
        if full in self._named or full.removesuffix(_MODEL) in self._models:
            return full
        if f"{full}::" in self._models:
            return f"{full}::{_MODEL}"
        raise ValueError(f"a pose is relative to {name!r}, which is no frame of the model")

    def link_of(self, name: str, prefix: str, ahead: tuple[str, ...] = ()) -> str:
        """Full name of the link that a link, frame, joint or nested model stands for.

        What isn't there stays as it is.
        """
        if name == WORLD and prefix + name not in self._named:
            return WORLD
        try:
            key = self._key(name, prefix)
        except ValueError:
            return prefix + name
        if key in ahead or key in self.links:
            return key
        if key not in self._named:
            return self._canonical(key.removesuffix(_MODEL), (*ahead, key))
        element = self._named[key]
        above = said(element, "child") if element.tag == "joint" else element.get("attached_to", "")
        return self.link_of(above, self.prefix[element], (*ahead, key))

    def _canonical(self, prefix: str, ahead: tuple[str, ...]) -> str:
        given = self._models[prefix].get("canonical_link")
        if given:
            return self.link_of(given, prefix, ahead)
        return next((name for name in self.links if name.startswith(prefix)), "")


def frame_from_model(model: Element, path: Path, frame: str) -> FloatArray:
    """(4, 4) frame_from_model of a frame of the model, which stays as it is.

    Raises:
        ValueError: where it has no such frame.
    """
    return np.asarray(np.linalg.inv(Frames(deepcopy(model), path).place(frame)), np.float64)


def placed_at_origin(model: Element, path: Path) -> None:
    """Give a model that is placed by one of its frames the pose of its origin instead.

    Raises:
        ValueError: where it has no such frame.
    """
    frame = model.attrib.pop("placement_frame", "")
    if not frame:
        return
    place = pose_of(model) @ frame_from_model(model, path, frame)
    pose = model.find("pose")
    pose = ET.SubElement(model, "pose") if pose is None else pose
    pose.attrib = {k: v for k, v in pose.attrib.items() if k == "relative_to"}
    rpy = np.asarray(rpy_from_rotation(place[:3, :3]))
    pose.text = " ".join(map(repr, [*place[:3, 3].tolist(), *rpy.tolist()]))


def model_in(path: Path) -> Element:
    """The first ``<model>`` of an SDF.

    Raises:
        InputFileError: where the file can't be read, or holds none.
    """
    model = parse(path, ("sdf",), "an SDF").find("model")
    if model is None:
        raise InputFileError(path, "holds no <model>", "include a model")
    return model


def _included(include: Element, file: Path, folder: Path) -> Element:
    """The included model with what ``<include>`` says of it; files as seen from ``folder``."""
    model = model_in(file)
    for key in ("name", "placement_frame"):
        given = include.get(key) or said(include, key)
        if given:
            model.set(key, given)
    pose = include.find("pose")
    if pose is not None or said(include, "placement_frame"):
        for own in model.findall("pose"):
            model.remove(own)
    if pose is not None:
        model.append(pose)
    for element in model.iter():
        text = (element.text or "").strip()
        if text and (element.tag == "uri" or element.tag.endswith("_map")) and "://" not in text:
            element.text = os.path.relpath(file.parent / text, folder)
    return model


def find_model(uri: str, path: Path) -> Path | None:
    """The SDF of a model that the file at ``path`` includes: beside it, or beside a folder above
    that its files may lie in."""
    text = uri.removeprefix(MODEL_URI).removeprefix("file://").strip("/")
    root = package_root(path)
    for start in upwards(path.parent, root):
        for name in (text, f"models/{text}"):
            try:
                found = resolve(name, start, root)
            except ReferenceRefused:
                continue
            file = gazebo_model(found) if found.is_dir() else found
            if file is not None and file.suffix.lower() == ".sdf" and file.is_file():
                return file
    return None


LOOKS = "{sdf}material"
"""The ``<material>`` of an SDF within a URDF's visual, which has the transparency, too."""
ALBEDO = "albedo_map"
"""What is read of ``<metal>`` and ``<specular>``."""


def painted(
    looks: Element, resolve: Callable[[str], Path | None], notes: list[str], where: str
) -> Material | None:
    """The material of a visual; None where it tells no colour and no picture.

    Args:
        looks: a :data:`LOOKS`.
        resolve: finds a file that it names; None where it can't.
        notes: gets what isn't read.
        where: of the visual, for the notes.

    Raises:
        ValueError: for a colour of anything but three or four numbers.
    """
    script = said(looks, "script/name")
    color = _rgba(looks, "diffuse") or _rgba(looks, "ambient")
    if script:
        notes.append(f"{where}: the material script {script!r} is not read")
    if any(_rgba(looks, "emissive")[:3]):
        notes.append(f"{where}: its emissive colour is not read")
    picture = None
    text = said(looks, f"pbr/metal/{ALBEDO}") or said(looks, f"pbr/specular/{ALBEDO}")
    file = resolve(text) if text else None
    if file is not None:
        try:
            picture = open_texture(file)
        except TextureError as error:
            notes.append(f"{where}: {error}")
    clear = said(looks, "transparency")
    opacity = 1 - float(np.clip(numbers_in(clear, 1, "transparency")[0], 0, 1)) if clear else 1.0
    if not color and picture is None:
        if opacity < 1:
            notes.append(f"{where}: transparency without a colour is not read")
        return None
    if not color or (picture is not None and not any(color[:3])):  # the default is black
        color = (1.0, 1.0, 1.0)
    r, g, b, a = (round(255 * v) for v in (*color, 1.0)[:4])
    return Material(script or "sdf", (r, g, b, round(a * opacity)), picture)


def _rgba(looks: Element, key: str) -> tuple[float, ...]:
    """Three or four numbers from 0 to 1; none where it says no colour."""
    text = said(looks, key)
    count = 4 if len(text.split()) > 3 else 3
    return tuple(np.clip(numbers_in(text, count, key), 0, 1).tolist()) if text else ()
