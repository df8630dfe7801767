"""The pose of the open object, set by sliders, played, or that of a finding; and joints of a scene
that move: one, those of an object, or all at once.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from app.server.names import moved_part
from app.server.scene_state import Work
from app.viewer.picture.joint_handles import AxisHandles, LimitHandles
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.tab import AT_REST, Step, Tab
from app.viewer.words import common as words
from app.viewer.words.joints import SELECT_JOINT
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.validation.report import Finding

TICKS_PER_SECOND = 25.0
PERIOD_SECONDS = 3.2


class Animation:
    """Plays joints over their range until stopped; ``show(q)`` is called at every tick."""

    def __init__(self, show: Callable[[dict[str, float]], None]) -> None:
        self._show = show
        self._lock = threading.Lock()
        self._joints: dict[str, tuple[Joint, float]] = {}
        self._thread: threading.Thread | None = None

    @property
    def playing(self) -> frozenset[str]:
        """Names of the joints that move now."""
        return frozenset(self._joints)

    def toggle(self, joints: Sequence[Joint], q: dict[str, float]) -> None:
        """Stop ``joints`` where all of them play, else play them from where they are."""
        with self._lock:
            names = {j.name for j in joints}
            if names and names <= set(self._joints):
                for name in names:
                    del self._joints[name]
                return
            now = time.monotonic()
            for joint in joints:
                phase = phase_at(joint, q.get(joint.name, 0.0))
                self._joints[joint.name] = (joint, now - phase * PERIOD_SECONDS)
            if self._thread is None or not self._thread.is_alive():
                self._thread = threading.Thread(target=self._run, name="animation", daemon=True)
                self._thread.start()

    def stop(self) -> None:
        """Stop all; joints stay where they are."""
        with self._lock:
            self._joints.clear()

    def wait(self) -> None:
        """Wait until the last tick was shown."""
        thread = self._thread
        if thread is not None:
            thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            now = time.monotonic()
            with self._lock:
                if not self._joints:
                    self._thread = None
                    return
                q = {
                    name: value_at(joint, (now - start) / PERIOD_SECONDS)
                    for name, (joint, start) in self._joints.items()
                }
            self._show(q)
            time.sleep(max(0.0, 1 / TICKS_PER_SECOND - (time.monotonic() - now)))


def value_at(joint: Joint, phase: float) -> float:
    """q at ``phase`` periods: limited joints swing smoothly between limits, others turn on."""
    if joint.type == "continuous":
        return (phase * 2 * math.pi + math.pi) % (2 * math.pi) - math.pi
    assert joint.lower is not None and joint.upper is not None
    swing = 0.5 - 0.5 * math.cos(2 * math.pi * phase)
    return joint.lower + swing * (joint.upper - joint.lower)


def phase_at(joint: Joint, q: float) -> float:
    """The phase in [0, 1) at which :func:`value_at` is ``q``."""
    if joint.type == "continuous":
        return (q / (2 * math.pi)) % 1.0
    assert joint.lower is not None and joint.upper is not None
    span = joint.upper - joint.lower
    share = min(max((q - joint.lower) / span, 0.0), 1.0) if span > 0 else 0.0
    return math.acos(1 - 2 * share) / (2 * math.pi)


class Motion:
    """Joint motion in one tab.

    Attributes:
        q: joint name → radians or metres; a joint that isn't in it rests.
        handles: of the selected joint's axis.
        limits: handles of its limits.
    """

    def __init__(self, tab: Tab, picture: ObjectPicture) -> None:
        self._tab, self._picture = tab, picture
        self.q: dict[str, float] = {}
        self.handles = AxisHandles(tab, self._parent_pose, self.stop)
        self.limits = LimitHandles(tab, self._parent_pose, self._points_of, self._try)
        self._moment: dict[str, float] | None = None
        self._tried: Joint | None = None
        self._animation = Animation(self._animate)
        self._listeners: list[Callable[[Mapping[str, float]], None]] = []
        tab.selection.on_open(self._begin)
        tab.selection.on_step(self._step_begins)

    def on_move(self, listener: Callable[[Mapping[str, float]], None]) -> None:
        """Call ``listener`` with ``q`` where something else than a slider changed it."""
        self._listeners.append(listener)

    def _moved(self) -> None:
        for listener in self._listeners:
            listener(self.q)

    def _begin(self) -> None:
        """Let another object rest."""
        self.stop()
        self.q, self.handles.on = {}, False

    def _step_begins(self, step: Step) -> None:
        if step in AT_REST:
            self.stop()
            self.q = {}
        if step != "Review":
            self.clear_moment()

    def stop(self) -> None:
        """End the animation where it is."""
        self._animation.stop()

    def forget(self) -> None:
        """Note that the picture was cleared, and handles and marks with it."""
        self.handles.forget()
        self.limits.forget()
        self._tried = None
        self._moment = None

    def set_q(self, name: str, value: float) -> None:
        """Move one joint; radians or metres."""
        if abs(self.q.get(name, 0.0) - value) > 1e-9:
            self.q[name] = value
            self.pose()

    def _animate(self, q: dict[str, float]) -> None:
        self.q.update(q)
        self.pose()
        self._moved()

    def reset(self) -> None:
        """Bring all joints back to the scanned pose."""
        self.stop()
        self.q = {}
        self._moved()
        self.pose()

    def play(self, name: str | None = None) -> None:
        """Start or stop moving one joint, or all of them."""
        selection = self._tab.selection
        tree = selection.need_object().document.tree
        if tree is None:
            self._tab.notify(words.NO_JOINTS, words.PREDICT_FIRST, "gray")
            return
        if selection.step in AT_REST:
            selection.set_step("Joints")
        chosen = [j for j in tree.joints if j.moves and j.mimic is None]
        self._animation.toggle([j for j in chosen if name in (None, j.name)], self.q)

    def pose(self) -> None:
        """Draw the links where ``q`` has them."""
        tree = self._tree
        if tree is None:
            return
        names = tree.by_name
        kept = {k: _within(names[k], v) for k, v in self.q.items() if k in names}
        if kept != self.q:  # limits were changed below the pose that is shown
            self.q = kept
            self._moved()
        if self._moment is not None and self.q != self._moment:
            self.clear_moment()
        poses = tree.pose(self.q)
        # While the screen is drawn, handles come and go.
        with self._tab.selection.lock, self._tab.client.atomic():
            self._picture.parts.pose(poses)
            self._picture.marks.pose(poses)
            self.handles.place(poses)
            self.limits.place(poses)

    def _try(self, joint: Joint | None, value: float = 0.0) -> None:
        """Show a joint with other limits at a value, before they are decided; None ends that."""
        self.stop()
        self._tried = joint
        if joint is not None:
            self.q = {**self.q, joint.name: value}
            self.pose()
        self._moved()

    @property
    def _tree(self) -> KinematicTree | None:
        """The joints of the open object, with the limits that are tried."""
        obj, tried = self._tab.selection.object, self._tried
        tree = None if obj is None else obj.document.tree
        if tree is None or tried is None or tried.name not in tree.by_name:
            return tree
        return tree.with_joint(tried)

    def _points_of(self, joint: Joint) -> npt.NDArray[np.floating] | None:
        """(N, 3) of the part that a joint moves, at rest; None until the parts are drawn."""
        tree = self._tree
        if tree is None or joint.child not in tree.joint_of:
            return None
        part = moved_part(tree, joint.child).removeprefix("link_")
        return self._picture.parts.points(int(part)) if part.isdigit() else None

    def show_moment(self, moment: Finding | None, text: str) -> None:
        """Pose everything as in a finding, and mark it until the pose changes; None is rest."""
        self.reset()
        self.clear_moment()
        if moment is None:
            return
        tree = self._tab.selection.need_object().document.tree
        names = {} if tree is None else tree.by_name
        self.q = {k: v for k, v in moment.q.items() if k in names}
        self._moved()
        self.pose()
        self._picture.marks.show_moment(moment.where, text)
        self._moment = dict(self.q)

    def clear_moment(self) -> None:
        """Remove the mark of a finding."""
        if self._moment is not None:
            self._moment = None
            self._picture.marks.show_moment(None, "")

    def toggle_handles(self) -> None:
        """Show or hide the handles for the selected joint's axis."""
        tab, joint = self._tab, self._tab.selection.joint
        if joint is None or not joint.moves:
            tab.notify(*SELECT_JOINT, "gray")
            return
        on = not self.handles.on
        if on:
            self.reset()
            tab.selection.set_step("Joints")
        self.handles.on = on
        tab.invalidate()

    def _parent_pose(self, joint: Joint) -> npt.NDArray[np.float64]:
        """(4, 4) posed_from_rest of a joint's parent, as it is now."""
        tree = self._tree
        if tree is None or joint.parent not in tree.links:
            return np.eye(4)
        names = tree.by_name
        return tree.pose({k: v for k, v in self.q.items() if k in names})[joint.parent]


def _within(joint: Joint, q: float) -> float:
    """The value within the joint's range; rest is always in it."""
    if joint.lower is None or joint.upper is None:
        return q
    return min(max(q, min(joint.lower, 0.0)), max(joint.upper, 0.0))


Poses = Mapping[int, Mapping[str, npt.NDArray[np.float64]]]


class SceneMotion:
    """Swings joints over their range until stopped; then everything rests.

    Args:
        show: gets session id → link → posed_from_rest at every tick.
    """

    def __init__(self, show: Callable[[Poses], None]) -> None:
        self._show = show
        self._moving: dict[int, tuple[KinematicTree, list[Joint], frozenset[str]]] = {}
        self._animation = Animation(self._pose)

    @property
    def playing(self) -> bool:
        """True while the joints move."""
        return bool(self._animation.playing)

    def play(self, works: list[Work], joint: str | None = None) -> int:
        """Start, with all joints or the one of that name; returns how many move."""
        self._moving = {}
        named: list[Joint] = []
        for work in works:
            tree = work.document.tree
            if tree is None:
                continue
            free = [j for j in tree.joints if j.moves and j.mimic is None]
            chosen = [j for j in free if joint in (None, j.name)]
            links = frozenset(link for j in chosen for link in tree.descendants(j.child))
            self._moving[work.id] = tree, chosen, links
            named += [replace(j, name=f"{work.id} {j.name}") for j in chosen]
        self._animation.toggle(named, {})
        return len(named)

    def stop(self) -> None:
        """End, with every joint at rest."""
        if self.playing:
            self._animation.stop()
            self._animation.wait()
            self._show({})

    def _pose(self, q: Mapping[str, float]) -> None:
        poses: dict[int, dict[str, npt.NDArray[np.float64]]] = {}
        for id, (tree, joints, links) in self._moving.items():
            posed = tree.pose({j.name: q.get(f"{id} {j.name}", 0.0) for j in joints})
            poses[id] = {link: posed[link] for link in links}  # the others rest
        self._show(poses)
