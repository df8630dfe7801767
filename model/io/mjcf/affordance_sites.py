"""Affordances as sites of MJCF: boxes as wide as what is held, z the approach, x the closing axis.

They are named ``affordance_<kind>_<rank>_<joint>`` and lie on the joint's child body, so that a
robot finds with MuJoCo alone what it can do. Scenes put the object's id and a slash before.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any
from xml.etree import ElementTree as ET  # only writes; reading is MuJoCo's

import numpy as np
from scipy.spatial.transform import Rotation

from model.core.affordance import AFFORDANCE_KINDS, Affordance
from model.core.rotations import quaternion_wxyz
from model.io.urdf.writer import vector, xml_name

GROUP = 4
"""MuJoCo's viewers show sites of the groups 0 to 2 unless they are told to."""
LEAST = 5e-4
"""Metres of a site's half size; MuJoCo refuses none."""
_NAME = re.compile(rf"(?:.*/)?affordance_({'|'.join(AFFORDANCE_KINDS)})_(\d+)_")


def is_affordance(name: str | None) -> bool:
    """True if a site of this name is an affordance."""
    return bool(name and _NAME.match(name))


def write_sites(body: ET.Element, affordances: Sequence[Affordance]) -> None:
    """Add those of one link to its body, best first."""
    for rank, affordance in enumerate(affordances, 1):
        z, x = -np.asarray(affordance.normal), np.asarray(affordance.closing)
        turn = np.stack([x, np.cross(z, x), z], axis=1)
        ET.SubElement(
            body, "site", name=xml_name(f"affordance_{affordance.kind}_{rank}_{affordance.joint}"),
            type="box", group=str(GROUP), rgba="0.1 0.6 0.2 0.5",
            pos=vector(affordance.center), quat=vector(quaternion_wxyz(turn)),
            size=vector([max(affordance.width / 2, LEAST), 0.006, 0.001]),
        )  # fmt: skip


def sites_of(model: Any, links: Sequence[str]) -> Iterator[Affordance]:
    """Those of a compiled model, with the joint of their body, best first.

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
