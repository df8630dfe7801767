"""The kinematic tree and its motion, with the editor of the selected joint."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from app.server.jobs import WorkerProcess
from app.server.names import joint_title, moved_part, part_title
from app.server.open_object import OpenObject
from app.viewer.input.pointing import Pointing
from app.viewer.panels.joint_editor import JointEditor
from app.viewer.panels.joint_tree import JointTree, shown
from app.viewer.panels.part_list import CategoryGuess, NameStrip, name_part
from app.viewer.panels.widgets import PredictButtons, Presses, offered, predict, put
from app.viewer.picture.motion import Motion
from app.viewer.picture.palette import CATEGORIES, PART_NAMES
from app.viewer.tab import Tab
from app.viewer.words import joints as words
from app.viewer.words.annotate import NO_SUGGESTION, category_set, name_set
from app.viewer.words.common import NONE, PLAY_ONE
from model.core.joint import Joint
from model.core.tree import KinematicTree
from sessions import commands as cmd
from sessions.database import ObjectRecord
from sessions.document import Document, PartInfo
from sessions.project_settings import Project


class JointsStep:
    """The second step: how the parts move.

    Attributes:
        tree: of all joints.
        editor: of the selected joint.
    """

    def __init__(
        self,
        tab: Tab,
        motion: Motion,
        pointing: Pointing,
        presses: Presses,
        worker: WorkerProcess,
        records: Callable[[], Sequence[ObjectRecord]],
        project: Project,
    ) -> None:
        """Make the widgets.

        Args:
            worker: snaps joints to the geometry.
            records: the queue.
            project: whose names are offered first.
        """
        self._tab, self._motion, self._pointing = tab, motion, pointing
        self._project = project
        self._drawn: Any = None
        self._sliders: dict[str, Any] = {}
        self._motion_key: Any = None
        self._rows: list[Any] = []
        self._pose: tuple[Any, list[Any]] = None, []
        gui = tab.client.gui
        self._empty = gui.add_markdown("")
        self._predict = PredictButtons(tab)
        self.tree = JointTree(
            tab, presses, lambda: pointing.armed == "parent", lambda: pointing.arm("parent")
        )
        self._what = gui.add_markdown("")
        self._strip = NameStrip(tab, presses, "name", self._named)
        self._name = gui.add_dropdown(words.PART_NAME, (NONE, *PART_NAMES), initial_value=NONE)
        self._guess = CategoryGuess(tab, records, self._set_category, project)
        self._category = gui.add_dropdown(words.CATEGORY, (NONE, *CATEGORIES), initial_value=NONE)
        self._folder = gui.add_folder(words.FOLDER)
        with self._folder:
            self.editor = JointEditor(tab, motion, worker, self._forget)
        self._all = gui.add_folder(words.ALL_JOINTS)
        tab.on_update(self._name, self._name_chosen)
        tab.on_update(self._category, self._categorised)
        motion.on_move(self._show_q)

    def _show_q(self, q: Mapping[str, float], but: Any = None) -> None:
        """Bring the sliders, ``but`` one, to ``q`` without moving anything."""
        obj = self._tab.selection.object
        tree = None if obj is None else obj.document.tree
        if tree is None:
            return
        mine = self._pose[1][:1]
        for name, slider in [*self._sliders.items(), *((self._pose_of, s) for s in mine)]:
            joint = tree.by_name.get(name)
            if joint is not None and slider is not but:
                value = round(shown(joint, q.get(name, 0.0)), 1)
                put(slider, value=min(max(value, slider.min), slider.max))

    @property
    def _pose_of(self) -> str:
        """The joint that the slider in the editor moves."""
        key = self._pose[0]
        return "" if key is None else key[0]

    # --- drawing

    def _forget(self) -> None:
        """Draw everything again, as fields may hold what was refused."""
        self._drawn = None

    def draw(self, obj: OpenObject) -> None:
        """Bring the panel up to date."""
        selection, doc = self._tab.selection, obj.document
        tree = doc.tree
        wanted = tree is None or doc.prediction_stale
        self._predict.show_here(obj.backend_away and wanted)
        checks = tuple((c.joint, c.where) for c in obj.checks)
        now = (
            obj.record.id,
            doc.prediction_stale,
            tree,
            doc.parts,
            doc.locked,
            doc.prediction,
            selection.child,
            checks,
            self._motion.handles.on,
            doc.category,
            doc.review.state,
            self._pointing.armed,
            self._project.settings,
        )
        if now == self._drawn:
            return
        self._drawn = now
        self._choose(doc, wanted)  # first: what is asked is about the joint that is shown
        self.tree.draw(doc, obj.checks)
        put(self._folder, visible=tree is not None)
        put(self._empty, visible=tree is None)
        self._draw_names(doc, wanted)
        self._predict.show(wanted)
        if tree is None:
            put(self._empty, content=words.EMPTY)
            self._draw_motion(None, doc)
            self._draw_pose(None)
            return
        self._draw_motion(tree, doc)
        self._draw_pose(selection.joint)
        self.editor.draw(obj, tree)

    def _choose(self, doc: Document, wanted: bool) -> None:
        """Select a joint if none is: the first with an unnamed part, else the first that moves."""
        selection, tree = self._tab.selection, doc.tree
        if tree is None or selection.child in tree.joint_of:
            return
        unnamed = [] if wanted else self._unknown(doc)[0]
        moving = (j.child for j in tree.joints if j.moves)
        selection.child = unnamed[0].link if unnamed else next(moving, None)
        if selection.child is not None:
            self._tab.invalidate()  # the picture, which was drawn before, shows its axis

    def _unknown(self, doc: Document) -> tuple[list[PartInfo], bool]:
        """Parts without a name, the selected joint's first, and whether there is no category."""
        if doc.tree is None or doc.prediction is None or doc.review.state == "accepted":
            return [], False
        found = [p for p in doc.parts if p.name is None and p.link in doc.tree.joint_of]
        chosen = self._chosen_part(doc.tree)
        return sorted(found, key=lambda p: p.link != chosen), doc.category is None

    def _chosen_part(self, tree: KinematicTree) -> str | None:
        """The link of the part that the selected joint moves."""
        child = self._tab.selection.child
        return moved_part(tree, child) if child is not None and child in tree.joint_of else None

    def _draw_names(self, doc: Document, wanted: bool) -> None:
        unnamed, uncategorised = ([], False) if wanted else self._unknown(doc)
        put(self._what, visible=bool(unnamed) or uncategorised)
        put(self._category, visible=uncategorised)
        self._guess.show(uncategorised)
        put(self._category, value=NONE)
        settings = self._project.settings
        own = settings.part_names(doc.category)
        names = offered(own, PART_NAMES, settings.strict)
        put(self._name, options=(NONE, *names))
        names = offered(settings.categories, CATEGORIES, settings.strict)
        put(self._category, options=(NONE, *names))
        self._strip.show(bool(unnamed), doc.category or self._guess.first, names=own)
        put(self._name, visible=bool(unnamed), value=NONE)  # the next one has none yet
        what = words.ASK_CATEGORY
        if unnamed:
            assert doc.tree is not None
            link = unnamed[0].link
            what = words.ask_name(part_title(doc, link), link != self._chosen_part(doc.tree))
        put(self._what, content=f"{what} {words.ask_why(_settled(doc))}")

    def _name_chosen(self) -> None:
        if self._name.value != NONE:
            self._named(self._name.value)

    def _categorised(self) -> None:
        if self._category.value != NONE:
            self._set_category(self._category.value)

    def _set_category(self, category: str) -> None:
        self._tab.do(cmd.SetCategory(category))
        self._predict_what_is_known()

    def choose_next(self) -> None:
        """Choose the next joint of the tree."""
        selection = self._tab.selection
        tree = selection.need_object().document.tree
        if tree is None or not tree.joints:
            return
        children = [j.child for j in tree.joints]
        at = children.index(selection.child) if selection.child in children else -1
        selection.choose_joint(children[(at + 1) % len(children)])

    def name_by_key(self, number: int) -> str:
        """Name the part that is asked for by a digit; 0 takes the suggested category.

        Returns:
            The result, for the user.
        """
        if number == 0:
            category = self._guess.take_first()
            return category_set(category) if category else NO_SUGGESTION
        doc = self._tab.selection.need_object().document
        unnamed = [] if doc.prediction_stale else self._unknown(doc)[0]
        if not unnamed:
            return words.ALL_NAMED
        name = self._strip.name(number)
        if name is None:
            return ""
        self._named(name)
        return name_set(unnamed[0].id, name)

    def _named(self, name: str) -> None:
        unnamed, _ = self._unknown(self._tab.selection.need_object().document)
        if unnamed:
            name_part(self._tab, unnamed[0].id, name)
            # Others of the same shape have the name as well now.
            unnamed, _ = self._unknown(self._tab.selection.need_object().document)
            if unnamed:
                self._tab.selection.choose_joint(unnamed[0].link)
            self._predict_what_is_known()

    def _predict_what_is_known(self) -> None:
        """Predict again once all names and the category are set.

        Where the user has settled joints, they are not predicted in passing.
        """
        doc = self._tab.selection.need_object().document
        if self._unknown(doc) == ([], False) and not _settled(doc):
            predict(self._tab)

    def _draw_motion(self, tree: KinematicTree | None, doc: Document) -> None:
        moving = [] if tree is None else [j for j in tree.joints if j.moves and j.mimic is None]
        key = tuple((j.name, j.type, j.lower, j.upper, joint_title(doc, j.child)) for j in moving)
        if key == self._motion_key:
            return
        self._motion_key = key
        for row in self._rows:
            row.remove()
        self._rows, self._sliders = [], {}
        sliders: dict[str, Any] = {}
        gui = self._tab.client.gui
        put(self._all, visible=len(moving) > 1)
        with self._all:
            for joint in moving:
                unit = "°" if joint.rotates else "mm"
                label = words.pose(joint_title(doc, joint.child), unit)
                slider = self._slider(label, joint)
                buttons = gui.add_button_group("", (PLAY_ONE, words.ROW_EDIT))
                buttons.on_click(lambda e, j=joint: self._row_clicked(e.target.value, j))
                sliders[joint.name] = slider
                self._rows += [slider, buttons]
        self._sliders = sliders

    def _draw_pose(self, joint: Joint | None) -> None:
        """The slider of the selected joint, beside what is edited."""
        if joint is not None and (not joint.moves or joint.mimic is not None):
            joint = None
        key = None if joint is None else (joint.name, joint.type, joint.lower, joint.upper)
        if key == self._pose[0]:
            return
        for row in self._pose[1]:
            row.remove()
        self._pose = key, []
        if joint is None:
            return
        tab, gui = self._tab, self._tab.client.gui
        with self.editor.pose_box:
            slider = self._slider(words.pose("", "°" if joint.rotates else "mm"), joint)
            play = gui.add_button_group("", (PLAY_ONE,))
        play.on_click(lambda _: tab.act(lambda: self._motion.play(joint.name)))
        self._pose = key, [slider, play]

    def _slider(self, label: str, joint: Joint) -> Any:
        """A slider that moves a joint."""
        low, high = _range(joint)
        start = round(shown(joint, self._motion.q.get(joint.name, 0.0)), 1)
        slider = self._tab.client.gui.add_slider(
            label,
            min=low,
            max=high,
            step=max(round((high - low) / 400, 1), 0.1),
            initial_value=min(max(start, low), high),
            hint=joint.type,
        )
        slider.on_update(lambda e: self._slid(e, joint))
        return slider

    def _slid(self, event: Any, joint: Joint) -> None:
        if event.client is None:
            return
        value, slider = event.target.value, event.target
        q = math.radians(value) if joint.rotates else value / 1000

        def moved() -> None:
            self._motion.set_q(joint.name, q)
            self._show_q(self._motion.q, but=slider)

        self._tab.act(moved)

    def _row_clicked(self, which: str, joint: Joint) -> None:
        tab = self._tab
        if which == words.ROW_EDIT:
            tab.act(lambda: tab.selection.choose_joint(joint.child))
        else:
            tab.act(lambda: self._motion.play(joint.name))


def _settled(doc: Document) -> bool:
    """True if the user has edited or locked a joint, or the joints come from a file."""
    return bool(doc.joints_file or doc.locked or doc.edited_joints)


def _range(joint: Joint) -> tuple[float, float]:
    if joint.type == "continuous":
        return -180.0, 180.0
    assert joint.lower is not None and joint.upper is not None
    low, high = shown(joint, joint.lower), shown(joint, joint.upper)
    low, high = round(min(low, 0.0), 1), round(max(high, 0.0), 1)
    return (low, high) if high > low else (low, low + 0.1)
