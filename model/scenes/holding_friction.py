"""Joint friction that keeps a tilted object closed under gravity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from model.core.articulated_object import Inertial
from model.core.joint import JOINT_KINDS, JOINT_TYPES, Joint, JointType, Mimic
from model.core.tree import KinematicTree
from model.physics.simulation_values import resisting
from model.scenes.readers.lisdf import parse_xml
from model.scenes.scene import FloatArray

UPRIGHT = 1e-3
"""Share of a unit vector's length: less is no tilt, but rounding."""


def frictions(
    asset: Path, world_from_asset: FloatArray, limits: Mapping[str, Sequence[float]]
) -> dict[str, float]:
    """Joint → N or N m of friction with which it holds itself as it stands.

    Args:
        asset: MJCF of the asset, by :class:`~model.io.export.mjcf.MjcfExporter`, whose friction is
            that of the upright asset.
        world_from_asset: (4, 4) how it stands.
        limits: joint → (lower, upper) where they were shortened.

    Returns:
        Empty where it stands upright: what the asset says holds.
    """
    up = world_from_asset[2, :3]
    if np.linalg.norm(up - (0.0, 0.0, 1.0)) < UPRIGHT:
        return {}
    tree, inertials = _moving(parse_xml(asset), limits)
    return {j.name: resisting(tree, inertials, j, up=up).friction for j in tree.joints if j.moves}


def _moving(
    root: ET.Element, limits: Mapping[str, Sequence[float]]
) -> tuple[KinematicTree, dict[str, Inertial]]:
    """Tree and masses of an asset; its bodies all have the asset's axes."""
    mimics = {
        e.get("joint1", ""): Mimic(e.get("joint2", ""), slope, offset)
        for e in root.findall("equality/joint")
        for offset, slope in [_numbers(e.get("polycoef"), (0.0, 1.0))[:2]]
    }
    links: list[str] = []
    joints: list[Joint] = []
    inertials: dict[str, Inertial] = {}

    def take(body: ET.Element, parent: str | None, at: FloatArray) -> None:
        link = body.get("name", "")
        links.append(link)
        at = at + _numbers(body.get("pos"), (0.0, 0.0, 0.0))
        weighed = body.find("inertial")
        if weighed is not None:
            center = at + _numbers(weighed.get("pos"), (0.0, 0.0, 0.0))
            inertials[link] = Inertial(float(weighed.get("mass", 0.0)), center, np.zeros((3, 3)))
        if parent is not None:
            joints.append(_joint(body.find("joint"), parent, link, at, limits, mimics))
        for child in body.findall("body"):
            take(child, link, at)

    for body in root.findall("worldbody/body"):
        take(body, None, np.zeros(3))
    return KinematicTree(tuple(links), tuple(joints)), inertials


def _joint(
    made: ET.Element | None,
    parent: str,
    link: str,
    at: FloatArray,
    limits: Mapping[str, Sequence[float]],
    mimics: Mapping[str, Mimic],
) -> Joint:
    if made is None:
        return Joint(f"fixed_{link}", "fixed", parent, link)
    name = made.get("name", "")
    axis = tuple(_numbers(made.get("axis"), (0.0, 0.0, 1.0)))
    ends = limits.get(name)
    if ends is None and made.get("range") is not None:
        ends = _numbers(made.get("range"), (0.0, 0.0))
    tag = made.get("type", "hinge")
    kind: JointType = next(k for k in JOINT_TYPES if JOINT_KINDS[k].mjcf == tag)
    if ends is None and JOINT_KINDS[kind].rotates:
        return Joint(name, "continuous", parent, link, axis, tuple(at), mimic=mimics.get(name))
    low, high = (0.0, 0.0) if ends is None else (float(v) for v in ends)
    return Joint(name, kind, parent, link, axis, tuple(at), low, high, mimics.get(name))


def _numbers(text: str | None, otherwise: Sequence[float]) -> FloatArray:
    return np.array(otherwise if text is None else [float(v) for v in text.split()], np.float64)
