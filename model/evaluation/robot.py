"""``artiworld bench robot``: whether a gripper can open what is exported, and short films of it.

Each object is exported as MJCF and opened again by MuJoCo with a free-flying parallel gripper
(:mod:`model.evaluation.gripper`), which reads where to take hold from the file. A joint counts as
opened once its measured position has covered 60 % of the way from rest to its farther limit. Films
are drawn without a graphics card.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import InputFileError
from model.core.geometry import Mesh, affine
from model.core.joint import Joint
from model.core.pool import OutOfTimeError, time_limit
from model.core.progress import Progress, no_progress
from model.core.tables import finite, mean
from model.core.tree import KinematicTree
from model.evaluation.bench import SECONDS, ObjectBench
from model.evaluation.gripper import GripperBench, Try
from model.geometry.drawing import View, draw, part_colors
from model.geometry.units import unusual_height
from model.io.export.mjcf import FILE, MjcfExporter
from model.physics.part_mesh import part_mesh
from model.physics.simulation_values import physics_of

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
        self._bounds = obj.bounds
        posed = bench.bodies_from_world()
        self._shown: list[tuple[str, int, Mesh]] = [
            (p.link, bodies[p.link], part_mesh(p).moved(posed[bodies[p.link]]))
            for p in obj.parts
            if p.link in bodies
        ]
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
            parts[f"p{k}"] = Part(f"p{k}", mesh.moved(world), name=link)
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


JointKind = Literal["hinge", "slide", "knob or wheel", "button"]
KINDS: tuple[JointKind, ...] = ("hinge", "slide", "knob or wheel", "button")
BUTTON = 0.015
"""Metres of travel up to which a slide counts as a button."""


@dataclass(frozen=True)
class RobotConfig(ObjectBench):
    """Objects and joints to measure.

    Attributes:
        most: joints of an object, spread over all of them.
        usual: whether objects of unusual height get the height that the app proposes.
        pictures: folder of one GIF an object, or None.
    """

    most: int = 6
    usual: bool = True
    pictures: Path | None = None


@dataclass(frozen=True)
class JointScore:
    """Result for one joint.

    Attributes:
        joint: name. kind: for the table. tries: of its affordances, best first, until one opens it.
        jams: whether a motor in the joint fails too, so that the object is to blame.
    """

    joint: str
    kind: JointKind
    tries: tuple[Try, ...] = ()
    jams: bool = False

    @property
    def opened(self) -> bool:
        """True if one of the tries opened it."""
        return bool(self.tries) and not self.tries[-1].why

    @property
    def why(self) -> str:
        """Why the last try failed, or ""."""
        if self.jams:
            return "jams under a motor, too"
        return self.tries[-1].why if self.tries else "no affordance"


@dataclass(frozen=True)
class RobotScore:
    """Result for one object.

    Attributes:
        id: of the object. joints: those that were tried. seconds: of shapes and affordances, and
            of the robot, by the clock. problem: why nothing was tried, or "".
    """

    id: str
    joints: tuple[JointScore, ...] = ()
    seconds: tuple[float, float] = (0.0, 0.0)
    problem: str = ""


def run(config: RobotConfig, progress: Progress = no_progress) -> list[RobotScore]:
    """Measure; an object whose process dies is a problem."""
    return config.scores(
        partial(score_object, config), lambda n, why: RobotScore(n, problem=why), progress
    )


def score_object(config: RobotConfig, name: str) -> RobotScore:
    """Let the robot open one object; never raises but for a lack of memory."""
    obj: ArticulatedObject | None = None
    try:
        with time_limit(SECONDS):
            obj = object_of(config, name)
            return _scored(config, name, obj)
    except (Exception, OutOfTimeError) as error:  # the boundary: any geometry may come here
        joints = () if obj is None else tuple(_spread(_moving(obj), config.most))
        lost = tuple(JointScore(j.name, kind_of(j)) for j in joints)
        return RobotScore(name, lost, problem=f"{type(error).__name__}: {error}"[:300])


def object_of(config: RobotConfig, name: str) -> ArticulatedObject:
    """The object with its true or predicted joints, at a usual height."""
    obj = config.object(name)
    height = float(np.ptp(obj.bounds[:, 2]))
    odd = unusual_height(obj.category, height) if config.usual else None
    if odd is None:
        return obj
    return obj.moved(affine(np.eye(3) * (odd.proposed / height)))


def _scored(config: RobotConfig, name: str, obj: ArticulatedObject) -> RobotScore:
    start = time.perf_counter()
    with TemporaryDirectory(prefix="artiworld-") as folder:
        MjcfExporter().export(obj, Path(folder), physics=physics_of(obj))
        bench = GripperBench(Path(folder, FILE))
    ready = time.perf_counter()
    film = None if config.pictures is None else Film(obj, bench)
    chosen = {j.name for j in _spread(_moving(obj), config.most)}
    scores = [s for s in open_all(bench, [n for n in bench.joints() if n in chosen], film)]
    kinds = {j.name: kind_of(j) for j in obj.tree.joints}
    done = time.perf_counter()
    if film is not None and config.pictures is not None:
        film.save(config.pictures / f"{name}_{config.joints}.gif")
    scores = [replace(s, kind=kinds[s.joint]) for s in scores]
    return RobotScore(name, tuple(scores), (round(ready - start, 2), round(done - ready, 2)))


def open_all(
    bench: GripperBench, joints: Sequence[str], film: Film | None = None
) -> list[JointScore]:
    """Try each joint, each from the object at rest, with its affordances until one opens it."""
    out: list[JointScore] = []
    for joint in joints:
        tries: list[Try] = []
        for affordance in (a for a in bench.affordances if a.joint == joint):
            watch = None if film is None else film.watch
            tries.append(bench.open(affordance, watch))
            if film is not None:
                film.keep(not tries[-1].why)
            if not tries[-1].why:
                break
        opened = bool(tries) and not tries[-1].why
        jams = not opened and bench.jams(joint)
        out.append(JointScore(joint, _kind_in(bench, joint), tuple(tries), jams))
    return out


def open_scene(path: Path, most: int, progress: Progress = no_progress) -> RobotScore:
    """Let the robot open joints of a scene in MJCF, spread over those that say where to take hold.

    Raises:
        InputFileError: where MuJoCo refuses the file, or it has no affordances.
    """
    start = time.perf_counter()
    bench = GripperBench(path)
    progress(0.2, f"opening joints of {path.name}")
    able = {a.joint for a in bench.affordances}
    if not able:
        raise InputFileError(
            path, "says of no joint where to take hold", "write it by scene convert --collision"
        )
    ready = time.perf_counter()
    scores = open_all(bench, _spread([n for n in bench.joints() if n in able], most))
    seconds = (round(ready - start, 2), round(time.perf_counter() - ready, 2))
    return RobotScore(path.name, tuple(scores), seconds)


def _moving(obj: ArticulatedObject) -> list[Joint]:
    own = [j for j in obj.tree.joints if j.moves and j.mimic is None]
    return [j for j in own if np.ptp(j.motion_range) > 1e-6]


def _spread(items: Sequence[Any], most: int) -> list[Any]:
    if not most or len(items) <= most:
        return list(items)
    return [items[int(k)] for k in np.linspace(0, len(items) - 1, most)]


def kind_of(joint: Joint) -> JointKind:
    """The row of a joint."""
    if joint.slides:
        return "button" if np.ptp(joint.motion_range) <= BUTTON else "slide"
    return "hinge" if joint.limited else "knob or wheel"


def _kind_in(bench: GripperBench, joint: str) -> JointKind:
    found = bench.model.joint(joint)
    if int(found.type[0]) == 2:  # mjJNT_SLIDE
        return "button" if np.ptp(found.range) <= BUTTON else "slide"
    return "hinge" if bench.model.jnt_limited[found.id] else "knob or wheel"


def row(label: str, scores: Sequence[RobotScore]) -> dict[str, float | str]:
    """Shares of joints in 0..1; NaN where there is none."""
    joints = [j for s in scores for j in s.joints]
    out: dict[str, float | str] = {"objects": label, "n": len(scores), "joints": len(joints)}
    out["opened"] = mean([j.opened for j in joints])
    out["at first"] = mean([j.opened and len(j.tries) == 1 for j in joints])
    out["of those that a motor moves"] = mean([j.opened for j in joints if not j.jams])
    for kind in KINDS:
        of = [j.opened for j in joints if j.kind == kind]
        out[f"{kind} ({len(of)})"] = mean(of)
    out["whole objects"] = mean([all(j.opened for j in s.joints) for s in scores if s.joints])
    for k, what in enumerate(("export s", "robot s")):
        out[what] = float(np.median([s.seconds[k] for s in scores] or [float("nan")]))
    return out


def reasons(scores: Sequence[RobotScore]) -> dict[str, int]:
    """Why joints were not opened, most frequent first."""
    return dict(Counter(j.why for s in scores for j in s.joints if not j.opened).most_common())


def to_json(runs: Sequence[tuple[str, Sequence[RobotScore]]]) -> dict[str, Any]:
    """The table, the reasons of failure and all scores; ``NaN`` is null."""
    return {
        "table": finite([row(label, scores) for label, scores in runs]),
        "reasons": {label: reasons(scores) for label, scores in runs},
        "objects": {label: [asdict(s) for s in scores] for label, scores in runs},
    }
