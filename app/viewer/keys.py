"""Keys, as the field's habits have them. W A S D Q E and the arrows belong to the camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

KEYS: Final[tuple[tuple[str, str], ...]] = (
    ("Click", "prompt point on the chosen part"),
    ("Shift + click", "negative prompt point: not this part"),
    ("Alt + drag", "box: everything visible in it joins the part (with Shift: leaves it)"),
    ("1 … 9", "choose the part (0 is the base)"),
    ("P", "predict joints"),
    ("Space", "play or stop all joints"),
    ("R", "reset the pose"),
    ("Tab", "next joint; while annotating: the next mask for the part"),
    ("T", "next joint type"),
    ("F", "flip the axis"),
    ("G", "axis handles on or off"),
    ("H", "hide or show the chosen part"),
    ("Y", "accept"),
    ("X", "reject"),
    ("N / B", "next / previous object"),
    ("C", "frame the object"),
    ("Ctrl+Z / Ctrl+Shift+Z", "undo / redo"),
    ("Ctrl+K", "all commands by name"),
    ("W A S D Q E, arrows", "move the camera"),
)


def add_keys(app: ClientApp) -> None:
    """Register every command with its key; they also stand in the palette (Ctrl+K)."""
    gui = app.client.gui

    def add(label: str, key: Any, action: Callable[[], None], modifier: Any = None) -> None:
        command = gui.add_command(label, hotkey=key, modifier=modifier)
        command.on_trigger(lambda _: app.act(action))

    for part in range(10):
        name = "the base" if part == 0 else f"part {part}"
        add(f"Choose {name}", str(part), lambda part=part: app.choose_part(part))
    add("Undo", "Z", app.undo, "cmd/ctrl")
    add("Redo", "Z", app.redo, "cmd/ctrl+shift")
    add("Predict joints", "P", app.predict)
    add("Play all joints", "space", app.play)
    add("Reset the pose", "R", app.reset_pose)
    add("Next joint or mask", "tab", app.next_choice)
    add("Next joint type", "T", app.joints_panel.next_type)
    add("Flip the axis", "F", app.joints_panel.flip)
    add("Axis handles", "G", app.toggle_gizmo)
    add("Hide or show the part", "H", app.annotate_panel.toggle_hidden)
    add("Accept", "Y", app.accept)
    add("Reject", "X", app.reject)
    add("Next object", "N", lambda: app.step(1))
    add("Previous object", "B", lambda: app.step(-1))
    add("Frame the object", "C", app.scene.frame_camera)
    for stage in ("Annotate", "Joints", "Review"):
        add(f"Step: {stage}", None, lambda stage=stage: app.set_stage(stage))
