"""The kinematic tree, its motion, and the editor of the chosen joint."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import viser

from app import snapping_tasks
from app.judging import JointCheck
from app.open_object import OpenObject
from app.viewer.text import plain
from app.viewer.widgets import differs, put
from model.errors import CommandError
from model.kinematics.joint import JOINT_TYPES, Joint
from model.kinematics.tree import KinematicTree
from sessions import commands as cmd
from sessions.document import Document

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

SNAP_SECONDS = 30.0
AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
DEFAULT_LIMITS = {"revolute": (0.0, math.pi / 2), "prismatic": (0.0, 0.3)}


class JointsPanel:
    """The second step: how the parts move."""

    def __init__(self, app: ClientApp) -> None:
        self._app = app
        self._drawn: Any = None
        self._sliders: dict[str, Any] = {}
        self._motion_key: Any = None
        self._rows: list[Any] = []
        gui = app.client.gui
        self._empty = gui.add_markdown("")
        self._again = gui.add_button("Predict joints (P)", icon=viser.Icon.WAND, color="blue")
        self._here = gui.add_button(
            "Predict on this machine", icon=viser.Icon.CPU, color="gray", visible=False
        )
        self._tree = gui.add_markdown("")
        self._motion = gui.add_folder("Motion")
        with self._motion:
            self._all = gui.add_button_group(
                "All joints", ("Play / stop (Space)", "Reset pose (R)")
            )
        self._editor = gui.add_folder("Joint")
        with self._editor:
            self._build_editor()
        self._again.on_click(lambda _: app.act(app.predict))
        self._here.on_click(lambda _: app.act(app.predict_here))
        self._all.on_click(
            lambda e: app.act(app.play if e.target.value.startswith("Play") else app.reset_pose)
        )

    def _build_editor(self) -> None:
        app, gui = self._app, self._app.client.gui
        self._child = gui.add_dropdown("Moves", ("—",))
        self._note = gui.add_markdown("")
        self._name = gui.add_text("Name", "")
        self._type = gui.add_dropdown("Type", JOINT_TYPES)
        self._parent = gui.add_dropdown("Parent", ("—",))
        self._axis = gui.add_vector3("Axis", (0.0, 0.0, 1.0), step=0.001)
        self._axis_to = gui.add_button_group("Axis to", ("X", "Y", "Z", "Flip (F)"))
        self._axis_box = gui.add_button_group("Part's box", ("Long", "Middle", "Short"))
        self._origin = gui.add_vector3("Origin [mm]", (0.0, 0.0, 0.0), step=0.1)
        self._origin_to = gui.add_button_group("Snap to", ("Box edge", "Contact", "Centre"))
        self._lower = gui.add_number("Lower [°]", 0.0, step=0.1)
        self._upper = gui.add_number("Upper [°]", 0.0, step=0.1)
        self._free = gui.add_button_group("Limits", ("Free range", "Zero is closed"))
        self._gizmo = gui.add_button("Axis handles (G)", icon=viser.Icon.AXIS_X, color="gray")
        self._locked = gui.add_checkbox("Keep when predicting again", False)
        self._reset = gui.add_button("Reset to the prediction", color="gray")
        app.on_update(self._child, self._child_chosen)
        app.on_update(self._name, lambda: self._change(name=self._name.value.strip()))
        app.on_update(self._type, lambda: self.set_type(self._type.value))
        app.on_update(self._parent, lambda: self._change(parent=_link(self._parent.value)))
        app.on_update(self._axis, lambda: self._change(axis=tuple(self._axis.value)))
        app.on_update(
            self._origin, lambda: self._change(origin=tuple(v / 1000 for v in self._origin.value))
        )
        app.on_update(self._lower, lambda: self._limit("lower", self._lower.value))
        app.on_update(self._upper, lambda: self._limit("upper", self._upper.value))
        app.on_update(self._locked, self._lock)
        self._axis_to.on_click(lambda e: app.act(lambda: self._preset(e.target.value)))
        self._axis_box.on_click(lambda e: app.act(lambda: self._snap(f"axis {e.target.value}")))
        self._origin_to.on_click(lambda e: app.act(lambda: self._snap(e.target.value)))
        self._free.on_click(lambda e: app.act(lambda: self._limits(e.target.value)))
        self._gizmo.on_click(lambda _: app.act(app.toggle_gizmo))
        self._reset.on_click(lambda _: app.act(self._reset_joint))

    # --- what a person does

    def _need_joint(self) -> Joint:
        joint = self._app.joint
        if joint is None:
            raise CommandError("choose a joint first: click a part, or press Tab")
        return joint

    def _child_chosen(self) -> None:
        self._app.choose_joint(_link(self._child.value))

    def _change(self, **changes: Any) -> None:
        joint = self._need_joint()
        if any(_differs(getattr(joint, k), v) for k, v in changes.items()):
            self._app.set_joint(replace(joint, **changes))

    def set_type(self, kind: Any) -> None:
        """Give the chosen joint another type, with limits that such a joint usually has."""
        joint = self._need_joint()
        if kind == joint.type:
            return
        lower, upper = DEFAULT_LIMITS.get(kind, (None, None))
        asset = self._app.need_object().asset
        if kind == "prismatic" and asset is not None:
            upper = round(0.3 * asset.diagonal, 3)
        self._app.set_joint(replace(joint, type=kind, lower=lower, upper=upper))

    def next_type(self) -> None:
        """The next type in the list (T)."""
        at = JOINT_TYPES.index(self._need_joint().type)
        self.set_type(JOINT_TYPES[(at + 1) % len(JOINT_TYPES)])

    def flip(self) -> None:
        """Turn the axis round; the limits stay, so the part opens to the other side (F)."""
        joint = self._need_joint()
        axis = tuple(-v if v else 0.0 for v in joint.axis)
        self._app.set_joint(replace(joint, axis=axis))

    def _preset(self, which: str) -> None:
        if which.startswith("Flip"):
            self.flip()
        else:
            self._change(axis=AXES[which])

    def _snap(self, to: str) -> None:
        obj = self._app.need_object()
        joint, tree = self._need_joint(), obj.document.tree
        assert tree is not None
        job = self._app.bench.prediction.submit(
            snapping_tasks.snap_joint, obj.source(), tree, joint.child, to, priority=15
        )
        snapped = job.result(SNAP_SECONDS)
        if snapped == joint:
            self._app.notify("Already there", f"The axis is on its {to.lower()}", "gray")
        else:
            self._app.set_joint(snapped)

    def _limit(self, which: str, value: float) -> None:
        joint = self._need_joint()
        if joint.limited:
            self._change(**{which: math.radians(value) if joint.rotates else value / 1000})

    def _limits(self, what: str) -> None:
        joint = self._need_joint()
        if not joint.limited:
            raise CommandError(f"a {joint.type} joint has no limits; choose another type first")
        assert joint.lower is not None and joint.upper is not None
        if what == "Free range":
            self._snap("free range")
        elif abs(joint.lower) < abs(joint.upper):
            self._change(lower=0.0)
        else:
            self._change(upper=0.0)

    def _lock(self) -> None:
        joint = self._need_joint()
        doc = self._app.need_object().document
        if self._locked.value != (joint.child in doc.locked):
            self._app.do(cmd.LockJoint(joint.child, self._locked.value))

    def _reset_joint(self) -> None:
        self._app.do(cmd.ResetJoint(self._need_joint().child))

    def show_q(self, q: dict[str, float]) -> None:
        """Bring the sliders to ``q`` without moving anything."""
        tree = None if self._app.object is None else self._app.object.document.tree
        if tree is None:
            return
        for name, slider in self._sliders.items():
            joint = tree.by_name.get(name)
            if joint is not None:
                value = _shown(joint, q.get(name, 0.0))
                put(slider, "value", min(max(value, slider.min), slider.max))

    # --- drawing

    def draw(self, obj: OpenObject) -> None:
        """Bring the panel up to date."""
        app, doc = self._app, obj.document
        tree = doc.tree
        wanted = tree is None or doc.prediction_stale
        put(self._here, "visible", obj.backend_away and wanted)
        checks = tuple((c.joint, c.where) for c in obj.checks)
        now = (
            obj.record.id,
            doc.prediction_stale,
            tree,
            doc.parts,
            doc.locked,
            doc.prediction,
            app.child,
            checks,
            app.gizmo_on,
        )
        if now == self._drawn:
            return
        self._drawn = now
        for widget in (self._tree, self._motion, self._editor):
            put(widget, "visible", tree is not None)
        put(self._empty, "visible", tree is None)
        put(self._again, "visible", wanted)
        if tree is None:
            text = "No joints yet. Click the moving parts, then predict."
            put(self._empty, "content", text)
            self._draw_motion(None, doc)
            return
        if app.child not in tree.joint_of:
            app.child = next((j.child for j in tree.joints if j.moves), None)
        put(self._tree, "content", tree_text(tree, doc, obj.checks))
        self._draw_motion(tree, doc)
        self._draw_editor(obj, tree, doc)

    def _draw_motion(self, tree: KinematicTree | None, doc: Document) -> None:
        moving = [] if tree is None else [j for j in tree.joints if j.moves and j.mimic is None]
        key = tuple((j.name, j.type, j.lower, j.upper, part_title(doc, j.child)) for j in moving)
        if key == self._motion_key:
            return
        self._motion_key = key
        for row in self._rows:
            row.remove()
        self._rows, self._sliders = [], {}
        gui, app = self._app.client.gui, self._app
        with self._motion:
            for joint in moving:
                low, high = _range(joint)
                unit = "°" if joint.rotates else "mm"
                step = max((high - low) / 400, 1e-4)
                start = min(max(_shown(joint, app.q.get(joint.name, 0.0)), low), high)
                slider = gui.add_slider(
                    f"{part_title(doc, joint.child)} [{unit}]",
                    min=low,
                    max=high,
                    step=float(f"{step:.2g}"),
                    initial_value=start,
                    hint=f"{joint.name}: {joint.type}",
                )
                slider.on_update(lambda e, j=joint: self._slid(e, j))
                buttons = gui.add_button_group("", ("▶ / ■", "Edit"))
                buttons.on_click(lambda e, j=joint: self._row_clicked(e.target.value, j))
                self._sliders[joint.name] = slider
                self._rows += [slider, buttons]

    def _slid(self, event: Any, joint: Joint) -> None:
        if event.client is None:
            return
        value = event.target.value
        q = math.radians(value) if joint.rotates else value / 1000
        self._app.act(lambda: self._app.set_q(joint.name, q))

    def _row_clicked(self, which: str, joint: Joint) -> None:
        app = self._app
        if which == "Edit":
            app.act(lambda: app.choose_joint(joint.child))
        else:
            app.act(lambda: app.play(joint.name))

    def _draw_editor(self, obj: OpenObject, tree: KinematicTree, doc: Document) -> None:
        titles = tuple(_titled(doc, j.child) for j in tree.joints) or ("—",)
        put(self._child, "options", titles)
        joint = self._app.joint
        if joint is None:
            put(self._note, "content", "No joint.")
            return
        put(self._child, "value", _titled(doc, joint.child))
        put(self._name, "value", joint.name)
        put(self._type, "value", joint.type)
        below = tree.descendants(joint.child)
        put(self._parent, "options", tuple(_titled(doc, k) for k in tree.links if k not in below))
        put(self._parent, "value", _titled(doc, joint.parent))
        _put_vector(self._axis, joint.axis, 5e-4)
        _put_vector(self._origin, tuple(v * 1000 for v in joint.origin), 0.05)
        unit = "°" if joint.rotates else "mm"
        for box, word, value in (
            (self._lower, "Lower", joint.lower),
            (self._upper, "Upper", joint.upper),
        ):
            put(box, "label", f"{word} [{unit}]")
            put(box, "visible", joint.limited)
            if value is not None and abs(box.value - _shown(joint, value)) > 1e-4:
                box.value = round(_shown(joint, value), 3)
        for widget in (
            self._axis,
            self._axis_to,
            self._axis_box,
            self._origin,
            self._origin_to,
            self._gizmo,
        ):
            put(widget, "visible", joint.moves)
        put(self._free, "visible", joint.limited)
        put(self._gizmo, "color", "pink" if self._app.gizmo_on else "gray")
        put(self._locked, "value", joint.child in doc.locked)
        put(self._note, "content", joint_note(joint, doc, obj.checks))


def part_title(doc: Document, link: str) -> str:
    """What people call a link: its part's name, else the link's own."""
    digits = link.removeprefix("link_")
    for part in doc.parts:
        if str(part.id) == digits and part.name:
            return f"{part.name} {part.id}"
    return link


def _titled(doc: Document, link: str) -> str:
    title = part_title(doc, link)
    return link if title == link else f"{link} · {title}"


def _link(title: str) -> str:
    return title.split(" · ", maxsplit=1)[0]


def _differs(a: Any, b: Any) -> bool:
    if isinstance(a, tuple):
        return differs(a, b, 1e-7)
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) > 1e-9
    return a != b


def _put_vector(box: Any, value: tuple[float, ...], tolerance: float) -> None:
    if differs(tuple(box.value), value, tolerance):
        box.value = tuple(round(v, 4) for v in value)


def _shown(joint: Joint, q: float) -> float:
    """Degrees or millimetres."""
    return math.degrees(q) if joint.rotates else 1000 * q


def _range(joint: Joint) -> tuple[float, float]:
    if joint.type == "continuous":
        return -180.0, 180.0
    assert joint.lower is not None and joint.upper is not None
    low, high = _shown(joint, joint.lower), _shown(joint, joint.upper)
    low, high = math.floor(min(low, 0.0) * 10) / 10, math.ceil(max(high, 0.0) * 10) / 10
    return (low, high) if high > low else (low, low + 1e-3)


def range_text(joint: Joint) -> str:
    """The range of a joint with its unit."""
    if joint.type == "continuous":
        return "turns freely"
    if not joint.limited:
        return ""
    assert joint.lower is not None and joint.upper is not None
    unit = "°" if joint.rotates else " mm"
    return f"{_shown(joint, joint.lower):.0f} to {_shown(joint, joint.upper):.0f}{unit}"


def tree_text(tree: KinematicTree, doc: Document, checks: list[JointCheck]) -> str:
    """The tree as a nested list."""
    hits = {c.joint for c in checks}
    depth = {tree.root: 0}
    lines = []
    for link in tree.order:
        joint = tree.joint_of.get(link)
        if joint is not None:
            depth[link] = depth[joint.parent] + 1
        title = plain(part_title(doc, link))
        line = f"{'  ' * depth[link]}- **{title}**"
        if joint is not None:
            sure = None if doc.prediction is None else doc.prediction.confidence.get(link)
            line += f" {joint.type} {range_text(joint)}"
            line += "" if sure is None else f" · {100 * sure:.0f} % sure"
            line += " · locked" if link in doc.locked else ""
            line += " · ⚠ collides" if joint.name in hits else ""
        else:
            line += " base"
        lines.append(line)
    return "\n".join(lines)


def joint_note(joint: Joint, doc: Document, checks: list[JointCheck]) -> str:
    """How the joint was decided, and what its sweep hit."""
    lines = []
    if doc.prediction is not None:
        note = doc.prediction.notes.get(joint.child)
        if note:
            lines.append(f"*{plain(note, 300)}*")
        if joint != doc.prediction.joint(joint.child):
            lines.append("Edited; the grey arrow is the prediction.")
    for check in checks:
        if check.joint == joint.name:
            at = _shown(joint, check.q)
            unit = "°" if joint.rotates else "mm"
            other = f" with {plain(part_title(doc, check.other))}" if check.other else ""
            lines.append(
                f"⚠ Collides{other} at {at:.0f} {unit}: {1000 * check.depth:.1f} mm deep "
                "(red ball)."
            )
    return "\n\n".join(lines) or "Chosen by you."
