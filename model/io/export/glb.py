"""One GLB file with the joints as animations, for browsers, Blender and game engines.

Link nodes sit where URDF link frames sit (``model.io.urdf.writer``) below one node that turns
+z up to glTF's +y up. The first animation moves all joints, then there is one for each joint.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part
from model.core.joint import Joint
from model.core.progress import Progress
from model.io.export.formats import FileExporter
from model.io.urdf.writer import link_origins
from model.io.write import GlbBuilder
from model.physics.part_mesh import part_mesh
from model.physics.simulation_values import Physics

FILE = "object.glb"
SECONDS = 4.0
"""From rest to the upper limit, the lower one, and back."""
KEYS = 8
"""Keyframes a stretch: viewers turn the shorter way between two, so a turn needs several."""
_HALF = float(np.sqrt(0.5))

FloatArray = npt.NDArray[np.float64]


class GlbExporter(FileExporter):
    """``object.glb``: textures inside, joints as animations; glTF has no place for physics."""

    name = "glb"

    def write(
        self, obj: ArticulatedObject, folder: Path, physics: Physics, progress: Progress
    ) -> tuple[Path, ...]:
        """See :class:`~model.io.export.formats.FileExporter`."""
        scene = _Scene(obj)
        for i, part in enumerate(obj.parts):
            progress(i / len(obj.parts), f"writing {part.link}")
            scene.add(part)
        scene.animate()
        path = folder / FILE
        path.write_bytes(scene.finish())
        progress(1.0, "written")
        return (path,)


class _Scene(GlbBuilder):
    """The parts' meshes under the nodes of their links."""

    def __init__(self, obj: ArticulatedObject) -> None:
        super().__init__()
        self.obj = obj
        self.origins = link_origins(obj.tree)
        self.node: dict[str, int] = {}
        self.append(
            "nodes", {"name": obj.name, "rotation": [-_HALF, 0.0, 0.0, _HALF], "children": []}
        )
        for link in obj.tree.order:
            joint = obj.tree.joint_of.get(link)
            above = 0 if joint is None else self.node[joint.parent]
            base = np.zeros(3) if joint is None else self.origins[joint.parent]
            offset = self.origins[link] - base
            self.node[link] = self._node(above, {"name": link, "translation": offset.tolist()})

    def _node(self, above: int, node: dict[str, Any]) -> int:
        number = self.append("nodes", node)
        self.tree["nodes"][above].setdefault("children", []).append(number)
        return number

    def add(self, part: Part) -> None:
        """Add a part below the node of its link.

        Its node and mesh are called after the part, "door", so that people and programs that open
        the file know it; the nodes that move are called after their links.
        """
        link = part.link
        called = part.name or ("base" if link == self.obj.tree.root else link)
        mesh = self.mesh(part_mesh(part), name=called)
        node: dict[str, Any] = {"mesh": mesh, "translation": (-self.origins[link]).tolist()}
        if called not in self.node:  # link nodes are identified by their names
            node["name"] = called
        self._node(self.node[link], node)

    def animate(self) -> None:
        """An animation of all joints, and one of each."""
        leaders = [j for j in self.obj.tree.joints if j.moves and j.mimic is None]
        if not leaders:
            return
        self._animation("all joints", leaders)
        for joint in leaders if len(leaders) > 1 else []:
            self._animation(joint.name, [joint])

    def _animation(self, name: str, joints: list[Joint]) -> None:
        tree = self.obj.tree
        tracks = [joint_track(j) for j in joints]
        times = np.linspace(0.0, SECONDS, len(tracks[0]))
        named = [j.name for j in joints]
        values = [
            tree.joint_values(dict(zip(named, row, strict=True)))
            for row in np.stack(tracks, axis=1).tolist()
        ]
        at = self._keys(times[:, None], "SCALAR", bounds=True)
        samplers: list[dict[str, Any]] = []
        channels: list[dict[str, Any]] = []
        for joint in tree.joints:
            if not joint.moves or not (joint in joints or _follows(self.obj, joint, named)):
                continue
            q = np.array([v[joint.name] for v in values])
            offset = self.origins[joint.child] - self.origins[joint.parent]
            axis = np.asarray(joint.axis)
            if joint.rotates:
                keys = np.column_stack([np.sin(q / 2)[:, None] * axis, np.cos(q / 2)])
            else:
                keys = offset + q[:, None] * axis
            kind, path = ("VEC4", "rotation") if joint.rotates else ("VEC3", "translation")
            sampler = {"input": at, "output": self._keys(keys, kind), "interpolation": "LINEAR"}
            target = {"node": self.node[joint.child], "path": path}
            channels.append({"sampler": len(samplers), "target": target})
            samplers.append(sampler)
        self.append("animations", {"name": name, "samplers": samplers, "channels": channels})

    def _keys(self, values: FloatArray, kind: str, bounds: bool = False) -> int:
        data = np.ascontiguousarray(values, "<f4")
        more = {"min": data.min(0).tolist(), "max": data.max(0).tolist()} if bounds else {}
        return self.accessor(data, kind, 5126, self.view(data.tobytes()), **more)


def joint_track(joint: Joint) -> FloatArray:
    """(3 * KEYS + 1,) values from rest to the upper limit, the lower one, and back to rest."""
    if joint.type == "continuous":
        return np.linspace(0.0, 2 * np.pi, 3 * KEYS + 1)
    lower, upper = joint.lower or 0.0, joint.upper or 0.0
    rest = min(max(0.0, lower), upper)
    return np.interp(
        np.arange(3 * KEYS + 1), np.array([0, 1, 2, 3]) * KEYS, [rest, upper, lower, rest]
    )


def _follows(obj: ArticulatedObject, joint: Joint, leaders: list[str]) -> bool:
    while joint.mimic is not None:
        joint = obj.tree.by_name[joint.mimic.joint]
        if joint.name in leaders:
            return True
    return False
