"""``prompts.json``: clicks and regions for scripts.

Either an object::

    {"format": 1, "category": "cabinet",
     "parts": [{"id": 1, "name": "door"}],
     "clicks": [{"position": [x, y, z], "part": 1, "positive": true, "element": 17}],
     "regions": [{"part": 1, "elements": [3, 4, 5], "positive": true}]}

or the bare list of clicks. Positions are metres in the object frame, +z up, as the scan is after
reading. ``point`` may stand for ``position``, and ``label`` 1 or 0 for ``positive``. Part 0 is the
base. Where no click names its part, all are clicks on part 1. Regions count after the clicks.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from model.core.asset import Asset
from model.core.errors import ArtiworldError, InputFileError
from model.segmentation.prompts import MAX_PARTS, Click, Prompts, Region
from sessions.checks import NAME_LIMIT, clean_text

FORMAT = 1
BESIDE = ".prompts.json"
"""Suffix of a prompt file beside an asset."""
MAX_BYTES = 64 * 2**20
FAR_OF_DIAGONAL = 0.05
"""Largest distance of a click from the surface, as a share of the object's diagonal."""

_EXAMPLE = 'as in {"clicks": [{"position": [0.1, 0.2, 0.3], "part": 1}]}'


@dataclass(frozen=True)
class PromptFile:
    """The content of a prompt file.

    Attributes:
        path: the file.
        prompts: clicks, then regions.
        names: part id → name.
        category: of the object, or None.
    """

    path: Path
    prompts: Prompts
    names: Mapping[int, str]
    category: str | None = None


def beside(path: Path) -> Path | None:
    """Return the prompt file beside an asset, or None."""
    kept = path.with_name(path.stem + BESIDE)
    return kept if path.is_file() and kept.is_file() else None


def read_prompts(path: str | Path) -> PromptFile:
    """Read and check a prompt file.

    Raises:
        InputFileError: with the first error and its place in the file.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputFileError(path, "is far too large for a list of clicks")
        tree: Any = json.loads(path.read_text("utf-8-sig"))
    except FileNotFoundError:
        raise InputFileError(path, "no such file", "give a JSON file of clicks") from None
    except OSError as error:
        raise InputFileError(path, f"can't be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise InputFileError(path, f"is not JSON: {error}", _EXAMPLE) from None
    try:
        return _parse(path, tree)
    except _Fault as fault:
        raise InputFileError(path, f"{fault.place}: {fault.problem}", fault.remedy) from None


def check_prompts(file: PromptFile, asset: Asset) -> None:
    """Check the prompts against their object.

    Raises:
        InputFileError: where a position is far from the surface or an element doesn't exist.
    """
    count, kind = asset.element_count, asset.element_kind
    for i, click in enumerate(file.prompts.clicks):
        if click.element is not None and click.element >= count:
            raise InputFileError(
                file.path,
                f"clicks[{i}].element: there is no {kind} {click.element}",
                f"{asset.name} has {count}, counted from 0",
            )
    regions = [p for p in file.prompts.items if isinstance(p, Region)]
    for i, region in enumerate(regions):
        if len(region.elements) and region.elements[-1] >= count:
            raise InputFileError(
                file.path,
                f"regions[{i}].elements: there is no {kind} {region.elements[-1]}",
                f"{asset.name} has {count}, counted from 0",
            )
    if not file.prompts.clicks:
        return
    distances = distance_to_surface(asset, np.array([c.position for c in file.prompts.clicks]))
    limit = FAR_OF_DIAGONAL * asset.diagonal
    for i, distance in enumerate(distances):
        if distance > limit:
            low, high = asset.bounds
            raise InputFileError(
                file.path,
                f"clicks[{i}].position: {distance:.3g} m away from the surface of {asset.name}",
                f"the object lies between {_point(low)} and {_point(high)} (metres, +z up)",
            )


def distance_to_surface(asset: Asset, positions: np.ndarray) -> np.ndarray:
    """Return the (K,) metres from (K, 3) positions to the nearest face, or point of a cloud."""
    if asset.mesh is None:
        from scipy.spatial import KDTree

        assert asset.cloud is not None
        return np.asarray(KDTree(asset.cloud.points).query(positions)[0])
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    middle = asset.bounds.mean(axis=0)  # Embree uses float32: stay near the origin
    tensor = o3d.core.Tensor.from_numpy
    scene.add_triangles(
        tensor((asset.mesh.vertices - middle).astype(np.float32)),
        tensor(asset.mesh.faces.astype(np.uint32)),
    )
    query = tensor((positions - middle).astype(np.float32))
    return scene.compute_distance(query).numpy().astype(np.float64)


class _Fault(Exception):
    def __init__(self, place: str, problem: str, remedy: str = "") -> None:
        self.place, self.problem, self.remedy = place, problem, remedy
        super().__init__(place, problem, remedy)


def _parse(path: Path, tree: Any) -> PromptFile:
    if isinstance(tree, list):
        tree = {"clicks": tree}
    if not isinstance(tree, dict):
        raise _Fault("the file", f"needs an object or a list, not {_seen(tree)}", _EXAMPLE)
    _only(tree, "the file", ("format", "category", "parts", "clicks", "regions"))
    version = tree.get("format", FORMAT)
    if version != FORMAT or isinstance(version, bool):
        raise _Fault("format", f"{_seen(version)} is unknown", f"this version reads {FORMAT}")
    category = tree.get("category")
    if category is not None:
        category = _name(category, "category") or None
    names: dict[int, str] = {}
    for i, part in enumerate(_list(tree, "parts")):
        number, name = _parse_part(part, f"parts[{i}]")
        if number in names:
            raise _Fault(f"parts[{i}].id", f"{number} is there twice")
        names[number] = name
    clicks = _list(tree, "clicks")
    one_part = not any(isinstance(c, dict) and "part" in c for c in clicks)
    items: list[Click | Region] = []
    for i, click in enumerate(clicks):
        items.append(_parse_click(click, f"clicks[{i}]", 1 if one_part else None))
    for i, region in enumerate(_list(tree, "regions")):
        items.append(_parse_region(region, f"regions[{i}]"))
    if not items:
        raise _Fault("the file", "has no clicks and no regions", _EXAMPLE)
    return PromptFile(path, Prompts(tuple(items)), {k: v for k, v in names.items() if v}, category)


def _parse_part(value: Any, place: str) -> tuple[int, str]:
    part = _object(value, place, ("id", "name"))
    if "id" not in part:
        raise _Fault(f"{place}.id", "is missing", 'as in {"id": 1, "name": "door"}')
    name = _name(part.get("name", ""), f"{place}.name")
    return _part_id(part["id"], f"{place}.id"), name


def _name(value: Any, place: str) -> str:
    """Return a clean name of the length that the app allows."""
    if not isinstance(value, str):
        raise _Fault(place, f"needs text, got {_seen(value)}")
    text = clean_text(value, len(value), place)
    if len(text) > NAME_LIMIT:
        raise _Fault(place, f"has {len(text):,} characters", f"at most {NAME_LIMIT} are allowed")
    return text


def _parse_click(value: Any, place: str, default_part: int | None) -> Click:
    click = _object(value, place, ("position", "point", "part", "positive", "label", "element"))
    keys = [k for k in ("position", "point") if k in click]
    if len(keys) != 1:
        problem = "is missing" if not keys else "is given twice, as position and as point"
        raise _Fault(f"{place}.position", problem, _EXAMPLE)
    part = click.get("part", default_part)
    if part is None:
        raise _Fault(f"{place}.part", "is missing", "other clicks name theirs")
    element = click.get("element")
    if element is not None and (not _is_int(element) or element < 0):
        raise _Fault(f"{place}.element", f"needs a whole number from 0, got {_seen(element)}")
    position = _position(click[keys[0]], f"{place}.{keys[0]}")
    return _made(
        place,
        lambda: Click(position, _part_id(part, f"{place}.part"), _positive(click, place), element),
    )


def _parse_region(value: Any, place: str) -> Region:
    region = _object(value, place, ("part", "elements", "positive", "label"))
    for key in ("part", "elements"):
        if key not in region:
            raise _Fault(f"{place}.{key}", "is missing")
    elements = region["elements"]
    if not isinstance(elements, list) or not elements:
        raise _Fault(f"{place}.elements", f"needs a list of numbers, got {_seen(elements)}")
    for i, element in enumerate(elements):
        if not _is_int(element) or not 0 <= element < 2**31:
            raise _Fault(
                f"{place}.elements[{i}]", f"needs a whole number from 0, got {_seen(element)}"
            )
    part = _part_id(region["part"], f"{place}.part")
    return _made(
        place, lambda: Region(part, np.array(elements, np.int64), _positive(region, place))
    )


def _made(place: str, make: Any) -> Any:
    try:
        return make()
    except ArtiworldError as error:
        raise _Fault(place, str(error)) from None


def _position(value: Any, place: str) -> tuple[float, float, float]:
    good = isinstance(value, list) and len(value) == 3
    if not good or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in value):
        raise _Fault(place, f"needs three numbers, got {_seen(value)}", "metres, +z up")
    try:
        x, y, z = (float(v) for v in value)
    except OverflowError:
        x = y = z = math.inf
    if not all(math.isfinite(v) and abs(v) < 1e9 for v in (x, y, z)):
        raise _Fault(place, f"needs three finite numbers, got {_seen(value)}", "metres, +z up")
    return x, y, z


def _positive(item: dict[str, Any], place: str) -> bool:
    if "positive" in item and "label" in item:
        raise _Fault(f"{place}.label", "is given besides positive", "give one of them")
    if "label" in item:
        if item["label"] not in (0, 1):
            raise _Fault(
                f"{place}.label",
                f"needs 1 (belongs to the part) or 0, got {_seen(item['label'])}",
                "the part's number goes into part",
            )
        return bool(item["label"])
    positive = item.get("positive", True)
    if not isinstance(positive, bool):
        raise _Fault(f"{place}.positive", f"needs true or false, got {_seen(positive)}")
    return positive


def _part_id(value: Any, place: str) -> int:
    if not _is_int(value) or not 0 <= value < MAX_PARTS:
        raise _Fault(place, f"needs a whole number from 0 to {MAX_PARTS - 1}, got {_seen(value)}")
    return value


def _is_int(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _list(tree: dict[str, Any], key: str) -> list[Any]:
    value = tree.get(key)
    if value is None:
        return []
    if not isinstance(value, list):
        raise _Fault(key, f"needs a list, got {_seen(value)}")
    return value


def _object(value: Any, place: str, keys: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise _Fault(place, f"needs an object with {', '.join(keys)}, got {_seen(value)}")
    _only(value, place, keys)
    return value


def _only(value: dict[str, Any], place: str, keys: tuple[str, ...]) -> None:
    for key in value:
        if key not in keys:
            raise _Fault(place, f"has an unknown key {key!r}", f"known are {', '.join(keys)}")


def _seen(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."


def _point(value: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.3g}" for v in value) + ")"
