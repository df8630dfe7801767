"""Strict parsing of values in scene files: invalid ones are reported, never guessed.

Poses become (4, 4) in metres, right-handed, +z up.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from model.core.errors import InputFileError
from model.core.files import free_name
from model.core.geometry import about, affine, rotation_from_rpy
from model.io.formats.loaded import read_bytes
from model.scenes.scene import FloatArray, SceneObject, SceneObjectError, SceneProblem

MAX_BYTES = 256 * 2**20
"""Far beyond any honest scene description; geometry lies beside it."""
MAX_OBJECTS = 20_000
_SHOWN = 60
BOX_CORNERS = np.array([[i >> k & 1 for k in range(3)] for i in range(8)])
_FACES = "021 123 456 576 014 154 263 367 042 246 135 375"
BOX_FACES = np.array([[int(corner) for corner in face] for face in _FACES.split()], np.int32)
_UNWRITABLE = re.compile("[\x00-\x1f\ud800-\udfff\ufffe\uffff]")

Place = tuple[str | int, ...]


def read_text(path: Path) -> str:
    """The file's text.

    Raises:
        InputFileError: where it can't be read, is too large or no text.
    """
    try:
        return read_bytes(path, MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputFileError(
            path, f"is not text: byte {error.start} is not UTF-8", "a scene description is needed"
        ) from None


def read_json(path: Path) -> Any:
    """The file as JSON.

    Raises:
        InputFileError: naming the place where it stops being JSON.
    """
    text = read_text(path)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputFileError(
            path,
            f"is not JSON: line {error.lineno}, column {error.colno}: {error.msg}",
            "give the scene's JSON file as it was written",
        ) from None
    except ValueError as error:  # thousands of digits
        raise InputFileError(path, f"its JSON can't be read: {error}", "it is no scene") from None
    except RecursionError:
        raise InputFileError(path, "its JSON is nested too deeply", "it is no scene") from None


def shown(value: Any) -> str:
    """A value in a message, cut short."""
    text = repr(value)
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "…"


def numbers(value: Any, count: int, what: str) -> FloatArray:
    """``count`` finite numbers from a list, or from ``{"x", "y", "z"}``.

    Raises:
        SceneObjectError: naming what is there instead.
    """
    if value is None:
        raise SceneObjectError(f"{what} is missing ({count} numbers are needed)")
    if isinstance(value, dict) and count == 3:
        value = [value.get(k) for k in "xyz"]
    good = isinstance(value, (list, tuple)) and len(value) == count
    if not good or any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in value):
        raise SceneObjectError(f"{what} is {shown(value)}; {count} numbers are needed")
    try:
        out = np.array(value, dtype=np.float64)
    except OverflowError:
        out = np.full(count, np.inf)
    if not np.isfinite(out).all():
        raise SceneObjectError(f"{what} is {shown(value)}; its numbers must be finite")
    return out


def text(value: Any, what: str) -> str:
    """A text that is not empty.

    Raises:
        SceneObjectError: where it is none.
    """
    if not isinstance(value, str) or not value.strip():
        raise SceneObjectError(f"{what} is {shown(value)}; a text is needed")
    # XML can't hold some characters: the written scene has the names, too.
    return _UNWRITABLE.sub("\ufffd", " ".join(value.splitlines()).replace("\t", " ")).strip()


def maybe_text(value: Any) -> str | None:
    """A text, or None for anything else."""
    return text(value, "") if isinstance(value, str) and value.strip() else None


class JsonReader:
    """Base of the readers of JSON files.

    Attributes:
        marks: texts in the beginning of a file, one of which it has.
    """

    marks: tuple[bytes, ...] = ()

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.scene.SceneReader`."""
        return path.suffix.lower() == ".json" and any(mark in head for mark in self.marks)


def table(value: Any, needed: str) -> dict[str, Any]:
    """A JSON object.

    Raises:
        SceneObjectError: where it is none; ``needed`` names its entries.
    """
    if not isinstance(value, dict):
        raise SceneObjectError(f"is {shown(value)}; an object with {needed} is needed")
    return value


def collect(
    entries: Iterable[tuple[Place, Any]],
    make: Callable[[Place, Any], SceneObject],
    name_of: Callable[[Any], str | None],
) -> tuple[tuple[SceneObject, ...], tuple[SceneProblem, ...]]:
    """Make an object of each entry; a broken one is reported and left out.

    A second object of the same id stays in the scene under an id of its own, which is reported too.

    Args:
        entries: place in the file and what is there.
        make: raises :class:`SceneObjectError` where the entry is broken.
        name_of: the entry's id, for messages.
    """
    objects: list[SceneObject] = []
    problems: list[SceneProblem] = []
    taken: set[str] = set()
    for place, entry in entries:
        label = _label(place, entry, name_of)
        if len(objects) >= MAX_OBJECTS:
            problems.append(SceneProblem(label, f"and all after it: over {MAX_OBJECTS} objects"))
            break
        try:
            made = make(place, entry)
        except SceneObjectError as error:
            problems.append(SceneProblem(label, str(error)))
            continue
        if made.id in taken:
            fresh = free_name(made.id, taken)
            problems.append(
                SceneProblem(made.id, f"the id is there twice; this one is now {fresh!r}", False)
            )
            made = replace(made, id=fresh)
        taken.add(made.id)
        objects.append(made)
    return tuple(objects), tuple(problems)


def _label(place: Place, entry: Any, name_of: Callable[[Any], str | None]) -> str:
    try:
        name = name_of(entry)
    except (AttributeError, KeyError, TypeError):
        name = None
    return name or " ".join(str(p) for p in place)


_SWAP = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])
"""Unity's (x, y up, z), left-handed, to (x, y, z up), right-handed: its own inverse."""


def pose(position: FloatArray, rotation: FloatArray | None = None) -> FloatArray:
    """(4, 4) from (3,) metres and a (3, 3) rotation."""
    return affine(rotation, position)


def from_rpy(values: FloatArray) -> FloatArray:
    """(4, 4) from (6,) x y z roll pitch yaw, radians, as URDF and SDF have them."""
    return pose(values[:3], rotation_from_rpy(values[3:]))


def rotation_from_quaternion(xyzw: FloatArray) -> FloatArray:
    """(3, 3) from a quaternion x, y, z, w of any length but zero.

    Raises:
        SceneObjectError: for one of zeros, which turns nothing.
    """
    if np.linalg.norm(xyzw) < 1e-9:
        raise SceneObjectError(
            f"its quaternion {xyzw.tolist()} (x y z w) is zero; one of length 1 is needed"
        )
    return Rotation.from_quat(xyzw).as_matrix()


def from_unity(position: FloatArray, degrees: FloatArray) -> FloatArray:
    """(4, 4) from Unity: metres, y up, left-handed; Euler angles applied z, then x, then y."""
    x, y, z = np.radians(degrees)
    turn = about(1, y) @ about(0, x) @ about(2, z)
    return pose(_SWAP @ position, _SWAP @ turn @ _SWAP)


def about_z(angle: float) -> FloatArray:
    """(3, 3) turn about +z by radians."""
    return about(2, angle)
