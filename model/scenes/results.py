"""Writing a converted scene: its own JSON, MJCF, the source with the URDFs' paths, a summary.

Each object has an outcome. Holding friction of joints keeps tilted objects closed under gravity.
"""

from __future__ import annotations

import copy
import json
import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from model.core.files import draft_of, write_json
from model.core.geometry import quaternion_wxyz
from model.core.joint import Joint, JointType
from model.io.assets.reader import URDF
from model.io.export.manifest import ABOUT, write_scene_about
from model.io.robot_xml import parse
from model.io.urdf.reader import read_urdf_model
from model.io.urdf.writer import number, xml_name
from model.physics.simulation_values import resisting
from model.scenes.jobs import ASSETS, MISSING, MOVING
from model.scenes.native_format import scene_to_json
from model.scenes.neighbours import at_rest
from model.scenes.readers.gltf_usd import articulation_layer, with_articulation
from model.scenes.readers.layouts import find_design
from model.scenes.scene import Decision, FloatArray, Scene, SceneObject
from model.scenes.scene_usd import write_scene_usd
from model.scenes.scene_xml import Stand, pose_text, write_scene_mjcf, write_scene_sdf
from model.scenes.values import read_json, read_text


@dataclass(eq=False)
class Outcome:
    """The outcome of one object; filled in step by step.

    Attributes:
        obj: the object.
        decision: of the finder.
        path: its asset, or None.
        truth: whether the asset is known to move; None where nobody knows.
        key: of its asset's job, or None.
        state, reason: what became of it.
        report: of its asset's job.
        changes: joints whose limits were shortened.
        by, at: who decided on it, and when (ISO 8601, UTC); "" where nobody did.
    """

    obj: SceneObject
    decision: Decision
    path: Path | None = None
    truth: bool | None = None
    key: str | None = None
    state: str = MISSING
    reason: str = ""
    report: dict[str, Any] = field(default_factory=dict)
    changes: list[dict[str, Any]] = field(default_factory=list)
    by: str = ""
    at: str = ""


UPRIGHT = 1e-3
"""Share of a unit vector's length: less is no tilt, but rounding."""


def frictions(
    asset: Path, world_from_asset: FloatArray, limits: Mapping[str, Sequence[float]]
) -> dict[str, float]:
    """Joint → N or N m of friction with which it holds itself as it stands.

    Args:
        asset: folder of the asset, whose friction is that of the upright one.
        world_from_asset: (4, 4) how it stands.
        limits: joint → (lower, upper) where they were shortened.

    Returns:
        Empty where it stands upright: what the asset says holds.
    """
    up = world_from_asset[2, :3]
    if np.linalg.norm(up - (0.0, 0.0, 1.0)) < UPRIGHT:
        return {}
    model = read_urdf_model(asset / URDF)
    joints = (_within(j, limits.get(j.name)) for j in model.tree.joints)
    tree, inertials = replace(model.tree, joints=tuple(joints)), model.declared.inertials
    return {j.name: resisting(tree, inertials, j, up=up).friction for j in tree.joints if j.moves}


def _within(joint: Joint, limits: Sequence[float] | None) -> Joint:
    if limits is None:
        return joint
    kind: JointType = "revolute" if joint.rotates else joint.type
    return replace(joint, type=kind, lower=float(limits[0]), upper=float(limits[1]))


SCENE_JSON, SCENE_MJCF, SUMMARY = "scene.json", "scene.xml", "summary.json"
SCENE_SDF, SCENE_USD = "scene.sdf", "scene.usda"


def write_results(
    scene: Scene,
    outcomes: Sequence[Outcome],
    out: Path,
    *,
    free_bases: bool,
    ambiguous: Collection[str] = (),
    formats: Sequence[str] = (),
) -> dict[str, Any]:
    """Write everything but the assets into ``out`` and return the summary.

    Args:
        free_bases: whether bases that may move do so in MJCF.
        ambiguous: ids that several assets have.
        formats: what the scene is written as besides MJCF; the assets are there in them already.
    """
    stands, held = at_rest(_stands(outcomes, free_bases, out), out)
    standing = {s.id: s for s in stands}
    urdfs = {
        o.obj.id: standing_urdf(
            o, i, out, standing[o.obj.id].friction if o.obj.id in standing else {}
        )
        for i, o in enumerate(outcomes)
        if o.state in MOVING
    }
    said = {
        o.obj.id: _said(o, urdfs.get(o.obj.id), standing.get(o.obj.id), held.get(o.obj.id))
        for o in outcomes
    }
    write_json(out / SCENE_JSON, scene_to_json(scene, said), indent=1)
    write_scene_mjcf(scene.name, stands, out, SCENE_MJCF)
    files = [SCENE_JSON, SCENE_MJCF]
    for name, write, file in (
        ("sdf", write_scene_sdf, SCENE_SDF),
        ("usd", write_scene_usd, SCENE_USD),
    ):
        if name in formats:
            write(scene.name, stands, out, file)
            files.append(file)
    back = _write_back(scene, said, out)
    files += [back] if back is not None else []
    _write_about(scene, outcomes, files, out)
    files.append(ABOUT)
    return _summary(scene, outcomes, files, ambiguous)


def _write_about(
    scene: Scene, outcomes: Sequence[Outcome], files: Sequence[str], out: Path
) -> None:
    assets: dict[str, list[str]] = {}
    notes = [f"{p.object}: {p.reason}" for p in scene.problems]
    for o in outcomes:
        if o.key is not None and o.report.get("bounds") is not None:
            assets.setdefault(f"{ASSETS}/{o.key}", []).append(o.obj.id)
        notes += [f"{o.obj.id}: {note}" for note in o.report.get("notes", [])]
    write_scene_about(out, scene.path, scene.reader, files, assets, notes)


def standing_urdf(o: Outcome, index: int, out: Path, friction: Mapping[str, float]) -> str:
    """The object's URDF below ``out``; its own one where its limits were shortened, or where its
    joints need another friction as it stands."""
    folder = f"{ASSETS}/{o.key}"
    if not (o.changes or friction):
        return f"{folder}/{URDF}"
    root = parse(out / folder / URDF)
    if not (_resist(root, friction) or o.changes):
        return f"{folder}/{URDF}"
    changes = {xml_name(c["joint"]): c["limits"] for c in o.changes}
    for joint in root.findall("joint"):
        limits = changes.get(xml_name(joint.get("name", "")))
        if limits is None:
            continue
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit", effort="100", velocity="1")
        limit.set("lower", number(limits[0]))
        limit.set("upper", number(limits[1]))
    name = f"scene_{index}.urdf"
    data = ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"
    _write_bytes(out / folder / name, data)
    return f"{folder}/{name}"


def _resist(root: ET.Element, friction: Mapping[str, float]) -> bool:
    """Give joints their friction, and the effort that still moves them; whether any has changed."""
    changed = False
    for joint in root.findall("joint"):
        asked = friction.get(joint.get("name", ""))
        resists, limit = joint.find("dynamics"), joint.find("limit")
        if asked is None or resists is None:
            continue
        if math.isclose(asked, float(resists.get("friction", 0.0)), rel_tol=1e-6):
            continue
        changed = True
        resists.set("friction", number(asked))
        if limit is not None:
            limit.set("effort", number(max(float(limit.get("effort", 0.0)), 2 * asked)))
    return changed


def _said(o: Outcome, urdf: str | None, stand: Stand | None, held: str | None) -> dict[str, Any]:
    out: dict[str, Any] = {
        "state": o.state,
        "reason": o.reason or None,
        "articulable": o.decision.articulable,
        "why": o.decision.reason,
        "kind": o.decision.kind,
        "expected_parts": list(o.decision.parts),
        "base": "fixed" if held else base_of(o),
        "urdf": urdf,
    }
    if o.by:
        out["decided"] = {"by": o.by, "at": o.at}
    if held:
        out["held"] = held
    if stand is not None and stand.passes:
        out["passes"] = [asdict(p) for p in stand.passes]
    bounds = o.report.get("bounds")
    if bounds is not None:
        world = o.obj.placed(bounds).world_from_asset
        out["world_from_urdf"] = {
            "position": world[:3, 3].tolist(),
            "quaternion_wxyz": quaternion_wxyz(world),
        }
        out["asset_folder"] = f"{ASSETS}/{o.key}"
        out["joints"] = [
            {k: j[k] for k in ("name", "type", "child", "lower", "upper", "confidence")}
            for j in o.report["joints"]
        ]
    if o.changes:
        out["shortened"] = o.changes
    return out


def base_of(o: Outcome) -> str:
    """``fixed`` or ``free``: as the scene says of its base, else as the object's kind demands,
    else as the scene says of the object, else fixed."""
    if o.obj.base is not None:
        return o.obj.base
    if o.decision.base is not None:
        return o.decision.base
    return "free" if o.obj.static is False else "fixed"


def _stands(outcomes: Sequence[Outcome], free_bases: bool, out: Path) -> list[Stand]:
    stands: list[Stand] = []
    for o in outcomes:
        if o.obj.box is not None:
            stands.append(Stand(o.obj.id, None, o.obj.world_from_object, box=o.obj.box))
        elif o.report.get("bounds") is not None:
            world = o.obj.placed(o.report["bounds"]).world_from_asset
            limits = {c["joint"]: c["limits"] for c in o.changes}
            friction = {}
            if o.state in MOVING and o.key is not None:
                friction = frictions(out / ASSETS / o.key, world, limits)
            free = free_bases and base_of(o) == "free"
            stands.append(Stand(o.obj.id, o.key, world, free, limits, friction))
    return stands


def _write_back(scene: Scene, said: dict[str, dict[str, Any]], out: Path) -> str | None:
    """The source as it came, with the URDFs' paths in it; None for a kind that can't hold them."""
    name = scene.path.name
    if name in (SCENE_JSON, SCENE_MJCF, SUMMARY, SCENE_SDF, SCENE_USD):
        name = f"source_{name}"
    urdf_of = {o.id: said[o.id]["urdf"] for o in scene.objects if said[o.id].get("urdf")}
    entries = {
        o.place: {"urdf": urdf_of[o.id], "base": said[o.id]["base"]}
        for o in scene.objects
        if o.id in urdf_of and o.place
    }
    if scene.reader == "gltf":
        nodes = {int(place[1]): entry for place, entry in entries.items()}
        _write_bytes(out / name, with_articulation(scene.path, nodes))
        return name
    if scene.reader == "usd":
        name = f"{scene.path.stem}_articulated.usda"
        prims = {str(place[0]): entry for place, entry in entries.items()}
        articulation_layer(scene.path, out / name, prims)
        return name
    if scene.reader == "optiscene":
        return _write_optiscene(scene, entries, out / name)
    if scene.path.suffix.lower() == ".json":
        data = copy.deepcopy(read_json(scene.path))
        _add_articulation(data, entries)
        write_json(out / name, data, indent=1, allow_nan=True)
        return name
    if scene.reader == "lisdf":
        _write_lisdf(scene, urdf_of, out / name)
        return name
    return None


def _add_articulation(data: Any, entries: Mapping[tuple[str | int, ...], Any]) -> None:
    for place, standing in entries.items():
        entry = data
        for step in place:
            entry = entry[step]
        entry["articulation"] = standing


def _write_optiscene(
    scene: Scene, entries: Mapping[tuple[str | int, ...], Any], path: Path
) -> str | None:
    """The text as it came, with the design's JSON written anew."""
    whole = read_text(scene.path)
    found = find_design(whole)
    if found is None:
        return None
    design, _, (begin, end) = found
    _add_articulation(design, entries)
    standing = json.dumps(design, indent=1, ensure_ascii=False)
    _write_bytes(path, (whole[:begin] + standing + whole[end:]).encode())
    return path.name


def _write_bytes(path: Path, data: bytes) -> None:
    with draft_of(path) as draft:
        draft.write_bytes(data)


def _write_lisdf(scene: Scene, urdf_of: dict[str, str], path: Path) -> None:
    root = parse(scene.path)
    world = root.find("world")
    assert world is not None
    elements = {tag: world.findall(tag) for tag in ("include", "model")}
    for obj in scene.objects:
        if obj.id not in urdf_of or not obj.place:
            continue
        tag, index = obj.place
        element = elements[str(tag)][int(index)]
        if tag == "model":
            for child in [c for c in element if c.tag not in ("pose", "static")]:
                element.remove(child)
            element.tag = "include"
            ET.SubElement(element, "uri")
            ET.SubElement(element, "name").text = element.attrib.pop("name", obj.id)
        uri, scale = element.find("uri"), element.find("scale")
        assert uri is not None
        uri.text = urdf_of[obj.id]
        framed = bool(element.attrib.pop("placement_frame", ""))
        for frame in element.findall("placement_frame"):
            element.remove(frame)
            framed = True
        was = ["1"] if scale is None else (scale.text or "1").split()
        if scale is not None:  # the URDF is at its size in the scene
            scale.text = " ".join(["1.0"] * len(was))
        # Where it is mirrored, a part of that is a turn; without a pose the model's own counted.
        if framed or element.find("pose") is None or any(float(word) < 0 for word in was):
            pose = _pose_of(element)
            pose.attrib.clear()
            pose.text = pose_text(obj.world_from_object)
    _write_bytes(path, ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _pose_of(element: ET.Element) -> ET.Element:
    found = element.find("pose")
    return ET.SubElement(element, "pose") if found is None else found


def _summary(
    scene: Scene, outcomes: Sequence[Outcome], files: list[str], ambiguous: Collection[str]
) -> dict[str, Any]:
    seconds = {o.key: o.report.get("seconds", 0.0) for o in outcomes if o.report}
    used = {(o.obj.asset or "").lower().rsplit("/", 1)[-1] for o in outcomes}
    return {
        "format": 1,
        "scene": scene.name,
        "reader": scene.reader,
        "objects": len(outcomes),
        "states": dict(Counter(o.state for o in outcomes)),
        "articulable": sum(o.decision.articulable for o in outcomes),
        "sim_id": dict(sim_id(outcomes)),
        "sim_us": dict(sim_us(outcomes)),
        "missing_assets": sorted({o.obj.asset or "" for o in outcomes if o.state == MISSING}),
        "ambiguous_assets": sorted(set(ambiguous) & used),
        "shortened_joints": sum(len(o.changes) for o in outcomes),
        "seconds_an_asset": round(float(np.mean(list(seconds.values()))), 3) if seconds else None,
        "problems": [asdict(p) for p in scene.problems],
        "results": [
            {
                "id": o.obj.id,
                "state": o.state,
                "kind": o.decision.kind,
                "reason": o.reason,
                "joints": len(o.report.get("joints", ())),
                "shortened": len(o.changes),
                "notes": o.report.get("notes", []),
            }
            for o in outcomes
        ],
        "files": files,
    }


def sim_id(outcomes: Sequence[Outcome]) -> Mapping[str, int | float | None]:
    """Sim-Id (ArtiWorld, metrics): articulable objects found, of those whose asset says.

    Returns:
        ``articulable``, ``found``, ``wrongly_found``, ``unknown`` (no URDF says) and ``share``.
    """
    known = [o for o in outcomes if o.truth is not None]
    there = [o for o in known if o.truth]
    found = sum(o.decision.articulable for o in there)
    return {
        "articulable": len(there),
        "found": found,
        "wrongly_found": sum(o.decision.articulable for o in known if not o.truth),
        "unknown": len(outcomes) - len(known),
        "share": found / len(there) if there else None,
    }


def sim_us(outcomes: Sequence[Outcome]) -> Mapping[str, int | float | None]:
    """Sim-Us (ArtiWorld, metrics): objects that work, of the articulable ones whose asset says.

    One works where every joint is right in type, axis, origin and range (usability), compared with
    the asset's own URDF, before neighbours shorten its limits. One that wasn't found doesn't work.

    Returns:
        ``articulable``, ``usable`` and ``share``.
    """
    there = [o for o in outcomes if o.truth]
    usable = sum(o.report.get("usable") is True for o in there)
    return {
        "articulable": len(there),
        "usable": usable,
        "share": usable / len(there) if there else None,
    }
