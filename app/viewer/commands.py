"""Commands of keys and buttons, for an object or the scene around it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

from app.server.tool_tasks import NEXT_MASK
from app.viewer.input.keys import Binding, KeySheet
from app.viewer.input.pointing import Pointing
from app.viewer.input.views import VIEWS, Views
from app.viewer.navigation import Navigation
from app.viewer.panels.comments import Comments
from app.viewer.panels.part_list import SHOWN
from app.viewer.panels.reviewing import Rejecting
from app.viewer.panels.step_bar import ToolRail
from app.viewer.panels.widgets import predict
from app.viewer.picture.motion import Motion
from app.viewer.picture.object_picture import ObjectPicture, View
from app.viewer.steps.annotate import AnnotateStep
from app.viewer.steps.joints import JointsStep
from app.viewer.steps.prepare import PrepareStep
from app.viewer.steps.review import ReviewStep
from app.viewer.steps.scene import SceneStep
from app.viewer.tab import STEPS, Tab
from app.viewer.words import common
from app.viewer.words import keys as view_words
from app.viewer.words import keys as words
from app.viewer.words.annotate import TOOL_ROWS
from sessions import commands as cmd
from sessions.review import RejectReason

_CANCELLED = ("open", "predict", "save", "segment", "room", "tool", "prepare")
_VIEW_KEYS: Final[dict[int, View]] = {1: "front", 3: "side", 7: "top"}
"""As in Blender."""

TOOL_KEYS: Final[dict[str, str]] = {
    "merge": "M",
    "connected": "O",
    "grow": "U",
    "shrink": "J",
    "same shape": "Z",
}
"""Keys of tools. L and I are handled in the page: a drag may begin before a message arrives."""
_WITHOUT_COMMAND = ("cut", "rectangle", NEXT_MASK)
"""Tools that have commands of their own."""


class Commands:
    """Commands of one tab, for the open object or, where none is open, for the scene.

    Attributes:
        rejecting: asks why something is rejected.
        open_held: opens the first object on hold.
    """

    def __init__(self, tab: Tab, navigation: Navigation) -> None:
        self._tab, self._navigation = tab, navigation
        self.rejecting = Rejecting(tab, self._subject, self._reject_because)

    def connect(
        self,
        steps: tuple[PrepareStep, AnnotateStep, JointsStep, ReviewStep],
        scene: SceneStep | None,
        comments: Comments,
        open_held: Callable[[], None],
    ) -> None:
        """Set what the commands are for; widgets that give them are made before."""
        self.prepare, self._annotate, self._joints, self._review = steps
        self._scene, self._comments, self.open_held = scene, comments, open_held

    @property
    def _overview(self) -> SceneStep | None:
        """The scene while none of its objects is worked on, else None."""
        return self._scene if self._tab.selection.object is None else None

    def _by_step(
        self, preparing: Callable[[], None], otherwise: Callable[[], None]
    ) -> Callable[[], None]:
        """An action for the prepare step, and another one for all others."""

        def act() -> None:
            selection = self._tab.selection
            here = selection.step == "Prepare" and selection.object is not None
            (preparing if here else otherwise)()

        return act

    def _in_joints(
        self, there: Callable[[], None], otherwise: Callable[[], None]
    ) -> Callable[[], None]:
        """An action for the joints step, and another one for all others."""

        def act() -> None:
            (there if self._tab.selection.step == "Joints" else otherwise)()

        return act

    def enter(self) -> None:
        """Prepare what needs it, take the parts that are offered, or edit the selected object of
        the scene.
        """
        selection = self._tab.selection
        if self._scene is not None:
            self._scene.choice.enter()
            return
        obj = selection.object
        if obj is None or selection.step != "Annotate":
            return
        if self._annotate.take_found():
            return
        if self.prepare.noticed(obj):
            selection.set_step("Prepare")
        else:
            self._annotate.take_alike()

    # --- decisions

    def undo(self) -> None:
        """Take back the last decision."""
        if self._overview is not None:
            self._overview.review.undo()
        elif (state := self._tab.selection.need_object().state).can_undo:
            self._tab.do(cmd.Undo())
            self._tab.say(state.undo_label)
        else:
            self._tab.notify(common.UNDO_EMPTY, "", "gray")

    def redo(self) -> None:
        """Do again what was taken back."""
        if self._overview is not None:
            self._overview.review.redo()
        elif (state := self._tab.selection.need_object().state).can_redo:
            self._tab.do(cmd.Redo())
            self._tab.say(state.redo_label)
        else:
            self._tab.notify(common.REDO_EMPTY, "", "gray")

    def cancel(self) -> None:
        """Stop what runs, and don't accept what waits for it. May be called on any thread."""
        obj = self._tab.selection.object
        if obj is not None:
            self._review.withdraw()
            for what in _CANCELLED:
                obj.jobs.cancel(what)

    def accept(self) -> None:
        """Accept the object, or the selected one of the scene."""
        if self._overview is not None:
            self.rejecting.cancel()
            self._overview.review.accept()
        else:
            self._review.accept()

    def _subject(self) -> tuple[Any, ...]:
        """The subject of a decision made now."""
        scene, obj = self._overview, self._tab.selection.object
        if scene is not None:
            return "scene", scene.choice.selected
        return "object", None if obj is None else obj.record.id

    def _title(self) -> str:
        """The name of what a decision made now is about."""
        scene, obj = self._overview, self._tab.selection.object
        name = scene.choice.selected if scene is not None else obj and obj.record.name
        return name or ""

    def reject(self) -> None:
        """Ask why the object goes back to its annotator."""
        if self._overview is not None:
            self._overview.choice.need_work()
        else:
            self._tab.selection.need_object()
            self._tab.selection.set_step("Review")
        self.rejecting.ask(self._title())

    def _reject_because(self, reason: RejectReason) -> None:
        """Send the object back to its annotator."""
        if self._overview is not None:
            self._overview.review.reject(reason)
        else:
            self._review.reject(reason)

    def go_on(self) -> None:
        """Go to the next object to decide."""
        if self._scene is None:
            self._navigation.go_on()
        else:
            self._scene.choice.leave()
            self._scene.choice.step(1)

    # --- numbers and choices

    def number(self, number: int) -> None:
        """A number key: the reason that is asked for, else the part for the next clicks."""
        if self.rejecting.asking:
            self.rejecting.answer(number)
        elif self._tab.selection.step == "Prepare":
            if number in _VIEW_KEYS:
                self.prepare.look(_VIEW_KEYS[number])
        else:
            self._tab.selection.choose_part(number)

    def name_by_key(self, number: int) -> None:
        """Name the selected part by a digit; 0 takes the suggested category."""
        selection = self._tab.selection
        if selection.object is None or selection.picking:
            return
        step = {"Annotate": self._annotate, "Joints": self._joints}.get(selection.step)
        text = common.NAMES_EARLIER if step is None else step.name_by_key(number)
        if text:
            self._tab.say(text)

    def next_choice(self) -> None:
        """Show the next mask, joint or finding (Tab)."""
        step = self._tab.selection.step
        if step == "Prepare":
            self.prepare.next_up(1)
        elif step == "Annotate":
            self._annotate.next_mask(1)
        elif step == "Review":
            self._review.validation_list.show_next()
        else:
            self._joints.choose_next()

    def next_comment(self) -> None:
        """Choose the next comment that is open (Shift+C)."""
        self._comments.next()

    def choice_before(self) -> None:
        """Show the previous mask (Shift+Tab)."""
        step = self._tab.selection.step
        if step == "Prepare":
            self.prepare.next_up(-1)
        elif step == "Annotate":
            self._annotate.next_mask(-1)

    def step(self, by: int) -> None:
        """Go to the next object (1) or to the one before (-1)."""
        if self._scene is None:
            self._navigation.step(by)
        else:
            self._scene.choice.step(by)


def bindings(
    tab: Tab,
    commands: Commands,
    steps: tuple[PrepareStep, AnnotateStep, JointsStep, ReviewStep],
    scene: SceneStep | None,
    view: tuple[Pointing, Motion, ObjectPicture, KeySheet, ToolRail, Views],
) -> Iterator[Binding]:
    """The commands of the palette (Ctrl+K) with their keys, in the palette's order."""
    prepare, annotate, joints, _ = steps
    by_step = commands._by_step
    pointing, motion, picture, sheet, tools, views = view
    for part in range(10):
        yield Binding(words.select_part(part), str(part), _with(commands.number, part))
    yield Binding(words.UNDO, "Z", commands.undo, "cmd/ctrl")
    yield Binding(words.REDO, "Z", commands.redo, "cmd/ctrl+shift")
    yield Binding(words.PREDICT, "P", _with(predict, tab))
    yield Binding(words.PLAY, "space", _playing(tab, scene, motion, False))
    yield Binding(words.PLAY_SCENE, "space", _playing(tab, scene, motion, True), "shift")
    yield Binding(words.RESET_POSE, "R", by_step(prepare.rotate, motion.reset))
    yield Binding(words.NEXT_CHOICE, "tab", commands.next_choice)
    yield Binding(words.PREVIOUS_MASK, "tab", commands.choice_before, "shift")
    yield Binding(words.NEXT_TYPE, "T", joints.editor.next_type)
    yield Binding(words.FLIP_AXIS, "F", by_step(prepare.flip, joints.editor.flip))
    yield Binding(words.HANDLES, "G", by_step(prepare.toggle_handle, motion.toggle_handles))
    yield Binding(words.HIDE, "H", annotate.parts.toggle_hidden)
    # Shift and a digit are handled in the page: the sign depends on the keyboard.
    for number in range(1, SHOWN + 1):
        yield Binding(words.name_part(number), None, _with(commands.name_by_key, number))
    yield Binding(words.TAKE_CATEGORY, None, _with(commands.name_by_key, 0))
    yield Binding(words.DELETE, "delete", by_step(prepare.remove_marked, annotate.delete))
    for row in TOOL_ROWS:
        for tool, label in row.items():
            if tool not in _WITHOUT_COMMAND:
                key = TOOL_KEYS.get(tool)
                use = _with(tools.use, label)
                if tool == "merge":
                    use = commands._in_joints(joints.editor.next_likely, use)
                    use = by_step(prepare.measure, use)
                yield Binding(words.tool(label), key, use)
    yield Binding(words.CUT, "K", pointing.next_cut)
    yield Binding(words.PREVIEW, "V", tools.toggle_preview)
    yield Binding(view_words.MEASURE, "M", _with(pointing.arm, "measure"), "shift")
    # Their keys are handled in the page: a number pad's digits are not those of the parts.
    yield Binding(view_words.ISOLATE, None, views.isolate)
    for name in VIEWS:
        yield Binding(view_words.VIEW_NAMES[name], None, _with(views.look, name))
    yield Binding(view_words.FLAT_OR_NOT, None, views.toggle_flat)
    yield Binding(words.EXCLUDE_ROOM, None, annotate.source.leave_out)
    yield Binding(words.EXTRACT, None, annotate.source.cut_out)
    yield Binding(words.TITLE, None, sheet.toggle)
    yield Binding(words.ACCEPT, "Y", commands.accept, decides=True)
    yield Binding(words.HELD, "Y", commands.open_held, "shift")
    yield Binding(words.REJECT, "X", commands.reject)  # which asks; the answer decides
    yield Binding(words.NEXT, "N", _with(commands.step, 1))
    yield Binding(words.PREVIOUS, "B", _with(commands.step, -1))
    yield Binding(words.INSTRUCTIONS, "I", annotate.instructions.toggle, "shift")
    yield Binding(words.NEXT_COMMENT, "C", commands.next_comment, "shift")
    yield Binding(words.FRAME, "C", _framing(tab, scene, picture))
    enter = words.PREPARE if scene is None else words.EDIT_IN_SCENE
    yield Binding(enter, "enter", by_step(prepare.apply, commands.enter))
    if scene is not None:
        yield Binding(words.BACK, "backspace", scene.choice.leave)
    for step in STEPS if scene is None else STEPS[1:]:
        yield Binding(words.step(step), None, _with(tab.selection.set_step, step))


def _with(action: Callable[[Any], None], value: Any) -> Callable[[], None]:
    return lambda: action(value)


def _playing(
    tab: Tab, scene: SceneStep | None, motion: Motion, everything: bool
) -> Callable[[], None]:
    """Start or stop moving the joints of the object, or of the scene around it."""

    def play() -> None:
        if scene is None or tab.selection.object is not None:
            motion.play()
        elif everything:
            scene.play_all()
        else:
            scene.play()

    return play


def _framing(tab: Tab, scene: SceneStep | None, picture: ObjectPicture) -> Callable[[], None]:
    """Aim at the open object, at the selected one of the scene, or at all of it."""

    def frame() -> None:
        if scene is None or tab.selection.object is not None:
            picture.frame_camera()
        else:
            scene.frame()

    return frame
