"""The tools' buttons, and the switch of the preview."""

from __future__ import annotations

from app.server.tool_tasks import ToolRequest
from app.viewer.input.pointing import Pointing
from app.viewer.tab import Tab

TOOL_ROWS: tuple[tuple[str, tuple[str, ...], str], ...] = (
    (
        "Draw",
        ("Lasso", "Brush"),
        "Lasso (L) and brush (I): drag, Shift takes away",
    ),
    (
        "Cut",
        ("Line", "Rectangle"),
        "Line (K): click two places, and the part is cut along the line between them. Rectangle "
        "(K again): click two opposite corners of a door or drawer that no gap parts. Where a "
        "mesh's faces are large, they are split",
    ),
    (
        "Mask",
        ("Next", "Connected"),
        "Next (Tab, Shift+Tab back): another mask for the last click. Connected (O): all that "
        "hangs together with it",
    ),
    ("Size", ("Grow", "Shrink"), "Grow (U) and shrink (J) by one neighbour; never over a gap"),
    (
        "Find",
        ("Same shape", "Mirror", "All parts"),
        "Same shape (Z): the other knobs, handles, … become parts of their own. Mirror: the "
        "counterpart across the plane of symmetry. All parts: a first guess of everything",
    ),
    (
        "Tidy",
        ("Merge", "Split", "Leftovers"),
        "Merge (M): click the part that joins the chosen one. Split: each separate piece becomes "
        "a part. Leftovers: crumbs go to the part that they touch",
    ),
)
"""Label, buttons and tooltip of each row of tools."""

_TOOL_OF = {"All parts": "propose"}


class ToolButtons:
    """A row of buttons for each kind of tool."""

    def __init__(self, tab: Tab, pointing: Pointing) -> None:
        self._tab, self._pointing = tab, pointing
        gui = tab.client.gui
        with gui.add_folder("Tools"):
            rows = [
                gui.add_button_group(label, options, hint=hint)
                for label, options, hint in TOOL_ROWS
            ]
            self._preview = gui.add_checkbox(
                "Preview (V)", True, hint="Dots show what a click would take, before it is made"
            )
        for row in rows:
            row.on_click(lambda e: tab.act(lambda: self.use(e.target.value)))
        tab.on_update(self._preview, self._preview_set)

    def use(self, label: str) -> None:
        """Begin what a tool's button says, on the chosen part."""
        selection, pointing = self._tab.selection, self._pointing
        if selection.step != "Annotate":
            selection.set_step("Annotate")
        match label:
            case "Lasso" | "Brush":
                pointing.set_tool(label.lower())  # type: ignore[arg-type]
            case "Merge" | "Rectangle":
                pointing.arm(label.lower())  # type: ignore[arg-type]
            case "Line":
                pointing.arm("cut")
            case "Next":
                pointing.tools.next_mask(1)
            case _:
                tool = _TOOL_OF.get(label, label.lower())
                pointing.tools.use(ToolRequest(tool, selection.part), label)

    def toggle_preview(self) -> None:
        """Switch the preview under the pointer on or off."""
        self._preview.value = not self._preview.value
        self._preview_set()

    def _preview_set(self) -> None:
        self._pointing.hover.on = self._preview.value
        self._pointing.hover.forget()
        self._tab.invalidate()
