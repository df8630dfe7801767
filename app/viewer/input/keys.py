"""Keys, as the field's habits have them. W A S D Q E and the arrows belong to the camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from app.viewer.panels.quick_names import NUMBERED

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

KEYS: Final[tuple[tuple[str, str], ...]] = (
    ("Click", "this belongs to the chosen part"),
    ("Shift + click", "this does not belong to it"),
    ("1 … 9, 0", "choose the part; 0 is the base"),
    ("Shift + 1 … 6, 0", "name the part; 0: the guessed category"),
    ("Tab, Shift+Tab", "next mask and back; next joint"),
    ("Alt + drag", "box (Shift: takes away)"),
    ("L + drag", "lasso (Shift: takes away)"),
    ("I + drag", "brush, [ ] its size; Shift as well"),
    ("K", "cut along a line, click by click"),
    ("K, K", "cut out a rectangle by two corners"),
    ("M", "merge with the part clicked next"),
    ("O", "add all that is connected"),
    ("U, J", "grow, shrink"),
    ("Z", "same shape: the other knobs, …"),
    ("V", "preview of a click on or off"),
    ("H, Delete", "hide or show, delete the part"),
    ("Esc", "plain clicks; take back a waiting Y"),
    ("P", "predict joints"),
    ("Space, Shift+Space", "play or stop; the whole scene"),
    ("R, C", "reset the pose, frame the object"),
    ("T, F", "next joint type, flip the axis"),
    ("G", "axis handles on or off"),
    ("Y", "accept; again: as it is"),
    ("X, then 1 … 6", "reject, and why"),
    ("N, B", "next, previous object"),
    ("Enter, Backspace", "scene: into the object, and back"),
    ("Ctrl+Z, Ctrl+Shift+Z", "undo, redo"),
    ("Ctrl+K", "all commands by name"),
    ("Drag, right drag, wheel", "turn, shift, zoom the view"),
    ("W A S D Q E, arrows", "move the camera"),
)
"""Each fits a line of the sheet, and all of them a small screen."""

TOOL_KEYS: Final[tuple[tuple[str, str | None], ...]] = (
    ("Merge", "M"),
    ("Connected", "O"),
    ("Grow", "U"),
    ("Shrink", "J"),
    ("Same shape", "Z"),
    ("Mirror", None),
    ("Split", None),
    ("Leftovers", None),
    ("All parts", None),
    # The page itself hears L and I, since the drag may begin before a message is here.
    ("Lasso", None),
    ("Brush", None),
)


def add_keys(app: ClientApp) -> None:
    """Register every command with its key; they also stand in the palette (Ctrl+K)."""
    gui = app.client.gui

    def add(
        label: str,
        key: Any,
        action: Callable[[], None],
        modifier: Any = None,
        *,
        decides: bool = False,
    ) -> None:
        command = gui.add_command(label, hotkey=key, modifier=modifier)
        carry_out = app.decide if decides else app.act
        command.on_trigger(lambda _: carry_out(action))

    for part in range(10):
        name = "the base" if part == 0 else f"part {part}"
        add(f"Choose {name}", str(part), lambda part=part: app.commands.number(part))
    add("Undo", "Z", app.commands.undo, "cmd/ctrl")
    add("Redo", "Z", app.commands.redo, "cmd/ctrl+shift")
    add("Predict joints", "P", app.commands.predict)
    add("Play the joints", "space", app.commands.play)
    add("Play all joints of the scene", "space", app.commands.play_all, "shift")
    add("Reset the pose", "R", app.motion.reset)
    add("Next joint or mask", "tab", app.commands.next_choice)
    add("Mask before this one", "tab", app.commands.choice_before, "shift")
    add("Next joint type", "T", app.joints_panel.editor.next_type)
    add("Flip the axis", "F", app.joints_panel.editor.flip)
    add("Axis handles", "G", app.motion.toggle_gizmo)
    add("Hide or show the part", "H", app.annotate_panel.toggle_hidden)
    # The page hears Shift and a number: which sign that writes depends on the keyboard.
    for number, name in enumerate(NUMBERED, 1):
        add(f"Name: {name}", None, lambda number=number: app.commands.answer(number))
    add("Take the guessed category", None, lambda: app.commands.answer(0))
    panel = app.annotate_panel
    add("Delete the part", "delete", panel.delete_part)
    for label, key in TOOL_KEYS:
        add(f"Tool: {label}", key, lambda label=label: panel.use_tool(label))
    add("Tool: Cut along a line, or a rectangle", "K", app.pointing.next_cut)
    add("Preview under the pointer", "V", panel.toggle_hover)
    add("Leave out floor and walls", None, app.source_panel.leave_out)
    add("Cut this part out as an object", None, app.source_panel.cut_out)
    add("Keys and mouse", None, app.commands.show_keys)
    add("Accept", "Y", app.commands.accept, decides=True)
    add("Reject", "X", app.commands.reject, decides=True)
    add("Next object", "N", lambda: app.step(1))
    add("Previous object", "B", lambda: app.step(-1))
    add("Frame the object", "C", app.commands.frame)
    if app.app_state.scene is not None:
        add("Work on the chosen object", "enter", app.in_scene.enter)
        add("Back to the scene", "backspace", app.in_scene.leave)
    for stage in ("Annotate", "Joints", "Review"):
        add(f"Step: {stage}", None, lambda stage=stage: app.set_stage(stage))
