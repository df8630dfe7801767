"""Short films of the gripper, drawn without a graphics card."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import Mesh
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.evaluation.gripper import GripperBench
from model.evaluation.render import View, draw, part_colors
from model.io.urdf.meshes import moved_mesh
from model.physics.part_mesh import part_mesh

EVERY = 0.15
"""Seconds of simulated time between pictures; a GIF shows them as fast."""
VIEW = View(width=360, height=320)

Array = npt.NDArray[np.float64]


class Film:
    """Collects pictures of one object; the first try of each joint that opens it is kept."""

    def __init__(self, obj: ArticulatedObject, bench: GripperBench) -> None:
        model = bench.model
        bodies = {model.body(k).name: k for k in range(model.nbody)}
        colors = part_colors([p.link for p in obj.parts], obj.tree.root)
        self._colors = {**colors, "robot": (60, 64, 72)}
        self._bounds = np.stack([
            np.min([p.bounds[0] for p in obj.parts], 0), np.max([p.bounds[1] for p in obj.parts], 0)
        ])  # fmt: skip
        posed = bench.bodies_from_world()
        self._shown: list[tuple[str, int, Mesh]] = [
            (p.link, bodies[p.link], moved_mesh(part_mesh(p), posed[bodies[p.link]]))
            for p in obj.parts if p.link in bodies
        ]  # fmt: skip
        self._shown += [("robot", body, box) for body, box in bench.robot_boxes()]
        self._try: list[Image.Image] = []
        self._kept: list[Image.Image] = []
        self._next = 0.0

    def watch(self, data: Any) -> None:
        """Draw where it is time; for :meth:`GripperBench.open`."""
        if data.time < self._next - 2 * EVERY:
            self._next = 0.0  # a new try
        if data.time < self._next:
            return
        self._next = data.time + EVERY
        parts: dict[str, Part] = {}
        for k, (link, body, mesh) in enumerate(self._shown):
            world = np.eye(4)
            world[:3, :3], world[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
            parts[f"p{k}"] = Part(f"p{k}", moved_mesh(mesh, world), name=link)
        whole = ArticulatedObject("frame", tuple(parts.values()), _loose(tuple(parts)))
        colors = {
            k: self._colors.get(p.name or "", self._colors["robot"]) for k, p in parts.items()
        }
        self._try.append(draw(whole, colors=colors, joints=False, bounds=self._bounds, view=VIEW))

    def keep(self, opened: bool) -> None:
        """End a try; its pictures stay where it opened the joint."""
        self._kept += self._try if opened or not self._kept else []
        self._try, self._next = [], 0.0

    def save(self, path: Path) -> None:
        """Write the GIF; none where nothing was tried."""
        if not self._kept:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        first, *others = (image.quantize(64) for image in self._kept)
        first.save(path, save_all=True, append_images=others, duration=int(1000 * EVERY), loop=0)


def _loose(links: tuple[str, ...]) -> KinematicTree:
    fixed = tuple(Joint(f"j{k}", "fixed", links[0], link) for k, link in enumerate(links[1:]))
    return KinematicTree(links, fixed)
