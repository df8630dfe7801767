"""Parts, their names, and the prompts that made them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import viser

from app.server.open_object import OpenObject
from app.server.pointer_messages import tell_page
from app.server.tool_tasks import NEXT_MASK, ToolRequest
from app.viewer.panels.category_guess import CategoryGuess, guesses_of
from app.viewer.panels.prompt_list import PromptEntry, prompt_entries
from app.viewer.panels.quick_names import NUMBERED, QuickNames
from app.viewer.panels.unit_hint import UnitHint
from app.viewer.panels.widgets import NONE, put
from app.viewer.picture import palette
from app.viewer.picture.stage import may_be_a_room
from model.core.progress import Cancelled
from model.segmentation.prompts import BASE, Click
from sessions import commands as cmd
from sessions.document import Document, RegionRef

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

OTHER = "other…"
LEAVE_OUT = "Leave out floor and walls"
PROMPTS_SHOWN = 12
PARTS_SHOWN = 200

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
_NEW_PARTS = ("same shape", "mirror", "propose", "split")
_NOTHING = {
    "split": "The part is one piece",
    "same shape": "Nothing else looks like this part",
    "leftovers": "There are no crumbs",
    "mirror": "Nothing lies on the other side, or it is a part already",
    "propose": "Nothing more shows by itself: click on a part",
    NEXT_MASK: "There is no other mask: click on the part first",
    "merge": "That is the chosen part itself: choose the part to keep, then click the other",
}


class AnnotatePanel:
    """The first step: which parts are there."""

    def __init__(self, app: ClientApp) -> None:
        self._app = app
        self._drawn: Any = None
        gui = app.client.gui
        self._hint = gui.add_markdown("")
        self._unit = UnitHint(app)
        self._room = gui.add_button("", icon=viser.Icon.SCISSORS, color="gray", visible=False)
        # Above the parts: however many these are, it stays where it is.
        self._predict = gui.add_button("Predict joints (P)", icon=viser.Icon.WAND, color="blue")
        self._here = gui.add_button(
            "Predict on this machine", icon=viser.Icon.CPU, color="gray", visible=False
        )
        self._category = gui.add_dropdown(
            "Category", (NONE, *palette.CATEGORIES, OTHER), initial_value=NONE
        )
        self._category_text = gui.add_text("Other category", "", visible=False)
        self._guess = CategoryGuess(app, lambda category: app.do(cmd.SetCategory(category)))
        with gui.add_folder("Parts"):
            self._parts_box = gui.add_folder(None)
            self._buttons: dict[int, Any] = {}
            self._part_actions = gui.add_button_group("Part", ("Add", "Hide", "Delete"))
            self._name = gui.add_dropdown(
                "Part is a", (NONE, *palette.PART_NAMES, OTHER), initial_value=NONE
            )
            self._name_text = gui.add_text("Other name", "", visible=False)
            self._quick = QuickNames(app, self._rename)
        with gui.add_folder("Tools"):
            self._tools = [
                gui.add_button_group(label, options, hint=hint)
                for label, options, hint in TOOL_ROWS
            ]
            self._hover = gui.add_checkbox(
                "Preview (V)", True, hint="Dots show what a click would take, before it is made"
            )
        with gui.add_folder("Prompts", expand_by_default=True):
            self._prompt_note = gui.add_markdown("")
            self._prompt_box = gui.add_folder(None)
            self._prompt_buttons: list[tuple[Any, PromptEntry]] = []
            self._prompt_actions = gui.add_button_group("Remove", ("Last", "Of this part", "All"))
        self._wire()

    def _wire(self) -> None:
        app = self._app
        app.on_update(self._category, self._category_chosen)
        app.on_update(self._category_text, self._category_typed)
        app.on_update(self._name, self._name_chosen)
        app.on_update(self._name_text, self._name_typed)
        app.on_update(self._hover, self._hover_set)
        self._part_actions.on_click(lambda e: app.act(lambda: self._part_action(e.target.value)))
        for group in self._tools:
            group.on_click(lambda e: app.act(lambda: self.use_tool(e.target.value)))
        self._prompt_actions.on_click(
            lambda e: app.act(lambda: self._prompt_action(e.target.value))
        )
        self._room.on_click(lambda _: app.act(self._room_clicked))
        self._predict.on_click(lambda _: app.act(app.commands.predict))
        self._here.on_click(lambda _: app.act(app.commands.predict_here))

    # --- what a person does

    def _document(self) -> Document:
        return self._app.need_object().document

    def _room_clicked(self) -> None:
        if self._room.label == LEAVE_OUT:
            self._app.source_panel.leave_out()
        else:
            self._app.source_panel.cut_out()

    def _category_chosen(self) -> None:
        value = self._category.value
        self._category_text.visible = value == OTHER
        if value == OTHER:
            return
        category = None if value == NONE else value
        if value != _listed(self._document().category, palette.CATEGORIES):
            self._app.do(cmd.SetCategory(category))

    def _category_typed(self) -> None:
        if self._category_text.value.strip():
            self._app.do(cmd.SetCategory(self._category_text.value))

    def answer(self, number: int) -> str:
        """What Shift and a number says: 0 the guessed category, else a name of the chosen part.

        Returns:
            What came of it, for people.
        """
        app = self._app
        if number == 0:
            category = self._guess.take_first()
            return f"The object is: {category}" if category else "There is no guess of the category"
        if number > len(NUMBERED):
            return ""
        if app.part == BASE:
            return "Part 0 is the base: choose another one"
        name = NUMBERED[number - 1]
        self._rename(name)
        return f"Part {app.part} is: {name}"

    def _name_chosen(self) -> None:
        value = self._name.value
        self._name_text.visible = value == OTHER
        if value == OTHER:
            return
        self._rename(None if value == NONE else value)

    def _name_typed(self) -> None:
        if self._name_text.value.strip():
            self._rename(self._name_text.value)

    def _rename(self, name: str | None) -> None:
        part = self._app.part
        if name != _part_name(self._document(), part):
            if part and part not in {p.id for p in self._document().parts}:
                self._app.do(cmd.AddPart(part, name))
            else:
                before = len(self._document().part_names)
                self._app.do(cmd.NamePart(part, name))
                more = len(self._document().part_names) - before - 1
                if name and more > 0:
                    what = (
                        f"{more} more part{'s'[: more != 1]} of the same shape; undo takes all back"
                    )
                    self._app.notify(f"{name.capitalize()}, too", what, "green")

    def _part_clicked(self, part: int) -> None:
        if self._app.pointing.armed == "merge":
            self._app.pointing.merge(part)
        else:
            self._app.choose_part(part)

    def _part_action(self, action: str) -> None:
        app = self._app
        if action == "Add":
            app.choose_part(self._document().next_part)
        elif action == "Hide":
            self.toggle_hidden()
        else:
            self.delete_part()

    def delete_part(self) -> None:
        """Take the chosen part away with all its prompts, and choose another one."""
        app = self._app
        if app.stage != "Annotate":
            app.notify("Delete", "Parts are deleted in the Annotate step", "gray")
            return
        if not app.part:
            app.notify("Delete", "Part 0 is the base, which stays", "gray")
            return
        if self._document().part(app.part) is not None:
            app.do(cmd.DeletePart(app.part))
        app.part = min((p.id for p in self._document().parts if p.id), default=1)
        app.invalidate()

    def toggle_hidden(self) -> None:
        """Hide the chosen part (its joint's part in the other steps), or show it again."""
        app = self._app
        part = app.part
        if app.stage != "Annotate" and app.child is not None:
            digits = app.child.removeprefix("link_")
            part = int(digits) if digits.isdigit() else part
        app.hidden = app.hidden ^ {part}
        app.pointing.hover.forget()
        app.invalidate()

    def use_tool(self, label: str) -> None:
        """Begin what a tool's button says, on the chosen part."""
        app = self._app
        if app.stage != "Annotate":
            app.set_stage("Annotate")
        match label:
            case "Lasso" | "Brush":
                app.pointing.set_tool(label.lower())  # type: ignore[arg-type]
                return
            case "Merge" | "Rectangle":
                app.pointing.arm(label.lower())  # type: ignore[arg-type]
                return
            case "Line":
                app.pointing.arm("cut")
                return
        if label == "Next":
            self.next_mask(1)
        else:
            self.use(ToolRequest(_TOOL_OF.get(label, label.lower()), app.part), label)

    def next_mask(self, step: int) -> None:
        """Another mask for the last click: the next one, or with -1 the one before."""
        self.use(ToolRequest(NEXT_MASK, self._app.part, step), "Next mask")

    def use(self, request: ToolRequest, label: str) -> None:
        """Let a tool work, and say what came of it."""
        app = self._app
        app.pointing.hover.forget()
        before = {p.part for p in self._document().prompts}
        try:
            found = app.need_object().segmenting.use_tool(request, app.who)
        except Cancelled:
            app.notify(label, "Cancelled: nothing was changed", "gray")
            return
        cut_off = {p.part for p in self._document().prompts} - before
        if request.tool in ("cut", "rectangle") and cut_off and not app.picking_out:
            app.choose_part(min(cut_off))  # what is named next is what was cut off
        if not found:
            app.notify(label, _NOTHING.get(request.tool, "It found nothing to change"), "gray")
        elif request.tool in _NEW_PARTS:
            app.notify(label, f"{found} new part{'s'[: found != 1]}; undo takes them back", "green")
        elif request.tool == "connected":
            self._tell_taken()

    def _tell_taken(self) -> None:
        """Below the picture: how much joined the part with the last prompt."""
        asset = self._app.need_object().need_asset()
        last = self._document().prompts[-1]
        if isinstance(last, RegionRef):
            share = _percent(last.count / asset.element_count)
            kind = f"{asset.element_kind}{'s'[: last.count != 1]}"
            said = f"Took what is connected: {last.count:,} {kind}, {share} of all"
            tell_page(self._app.client, said=said)

    def toggle_hover(self) -> None:
        """Preview under the pointer: on or off."""
        self._hover.value = not self._hover.value
        self._hover_set()

    def _hover_set(self) -> None:
        self._app.pointing.hover.on = self._hover.value
        self._app.pointing.hover.forget()
        self._app.invalidate()

    def _prompt_action(self, action: str) -> None:
        app, prompts = self._app, self._document().prompts
        mine = [entry for entry in prompt_entries(prompts) if entry.part == app.part]
        if action == "All" and prompts:
            app.do(cmd.ClearPrompts())
        elif not mine:
            app.notify("Remove", "This part has no prompts" if prompts else "None yet", "gray")
        elif action == "Last":  # of those that are listed
            app.do(cmd.RemovePrompt(mine[-1].index, mine[-1].count))
        else:
            app.do(cmd.ClearPrompts(app.part))

    # --- drawing

    def draw(self, obj: OpenObject) -> None:
        """Bring the panel up to date."""
        app, doc = self._app, obj.document
        put(self._here, "visible", obj.backend_away and not app.picking_out)
        shares = obj.segmenting.shares
        now = (
            obj.record.id,
            doc.parts,
            doc.prompts,
            doc.category,
            doc.review.state,
            doc.left_out,
            tuple(shares.items()),
            app.part,
            app.hidden,
            id(obj.asset),
            app.picking_out,
            doc.segmentation is None,
        )
        if now == self._drawn:
            return
        self._drawn = now
        put(self._predict, "visible", not app.picking_out)
        self._draw_hint(obj, doc)
        ready = doc.segmentation is not None
        put(self._predict, "color", "blue" if ready and not self._room.visible else "gray")
        self._draw_parts(doc, shares)
        self._draw_names(doc)
        self._draw_prompts(doc, "face" if obj.asset is None else obj.asset.element_kind)

    def _draw_hint(self, obj: OpenObject, doc: Document) -> None:
        wide = obj.asset is not None and may_be_a_room(obj.asset.bounds)
        room = wide and self._app.app_state.scene is None and doc.placement is None
        whole = room and doc.left_out is None and not doc.prompts
        odd = self._unit.draw(obj)
        mine = [p for p in doc.prompts if p.part == self._app.part]
        put(self._room, "label", LEAVE_OUT if whole else "Cut this part out as an object")
        put(self._room, "color", "blue" if whole or doc.segmentation is not None else "gray")
        put(self._room, "visible", room and odd is None)
        if self._app.picking_out:
            text = (
                f"**Part {self._app.part}** is what is taken out. Things side by side with one "
                "front: **K**, then two clicks, one above the other, cut them apart."
            )
        elif odd is not None:
            text = f"**{odd}**"
        elif doc.review.state == "accepted":
            text = "**Accepted.** To change it, reopen it in the Review step."
        elif whole:
            text = (
                "**A room?** Leave out the floor and the walls first. "
                "Then click or box one thing and cut it out as an object."
            )
        elif room:
            text = (
                "**Click or box (Alt+drag) one thing** and cut it out as an object. "
                "Shift+click says *not this*; **Tab** shows other masks."
            )
        elif not mine and (self._app.part or not doc.prompts):
            text = (
                "**Click a part that moves** (a door, a drawer, a knob). "
                "Press **2**, **3**, … for the next part; Shift+click says *not this*."
            )
        elif not any(isinstance(p, Click) for p in mine):
            text = "Tint wrong? Click what is missing, Shift+click what is too much."
            text += " **Delete** takes the part away." if self._app.part else ""
        else:
            text = (
                "Tint wrong? **Tab** shows other masks; or click what is missing, Shift+click what "
                "is too much."
            )
        put(self._hint, "content", text)

    def _draw_parts(self, doc: Document, shares: dict[int, float]) -> None:
        app = self._app
        ids = parts_listed((p.id for p in doc.parts), app.part)
        for part in [p for p in self._buttons if p not in ids]:
            self._buttons.pop(part).remove()
        gui = app.client.gui
        for part in ids:
            if part not in self._buttons:
                with self._parts_box:
                    button = gui.add_button("", color=palette.part_color(part), order=float(part))
                button.on_click(lambda _, part=part: app.act(lambda: self._part_clicked(part)))
                self._buttons[part] = button
            button = self._buttons[part]
            name = _part_name(doc, part)
            if name in (None, f"link_{part}"):  # as read from a folder of parts: no name at all
                name = "part" if part else "base"
            share = f" · {_percent(shares[part])}" if part in shares else ""
            mark = "▸ " if part == app.part else ""
            hidden = " (hidden)" if part in app.hidden else ""
            put(button, "label", f"{mark}{part} · {name[:24]}{share}{hidden}")

    def _draw_names(self, doc: Document) -> None:
        name = _part_name(doc, self._app.part)
        _show_choice(self._name, self._name_text, name, palette.PART_NAMES)
        _show_choice(self._category, self._category_text, doc.category, palette.CATEGORIES)
        picking = self._app.picking_out  # what is taken out is named above
        self._quick.show(self._app.part != BASE and not picking, name)
        asked = doc.category is None and not picking and doc.review.state != "accepted"
        self._guess.show(guesses_of(self._app) if asked else ())
        for choice, text in ((self._name, self._name_text), (self._category, self._category_text)):
            put(choice, "visible", not picking)
            if picking:
                put(text, "visible", False)

    def _draw_prompts(self, doc: Document, elements: str) -> None:
        app = self._app
        entries = prompt_entries(doc.prompts, elements)
        mine = [entry for entry in entries if entry.part == app.part]
        note = f"{len(mine)} on this part, {len(entries)} in all. Click one to remove it."
        put(self._prompt_note, "content", note if doc.prompts else "None yet.")
        wanted = mine[-PROMPTS_SHOWN:]
        if [entry for _, entry in self._prompt_buttons] == wanted:
            return
        for button, _ in self._prompt_buttons:
            button.remove()
        self._prompt_buttons = []
        for entry in wanted:
            with self._prompt_box:
                button = app.client.gui.add_button(entry.label, icon=viser.Icon.X, color="gray")
            remove = cmd.RemovePrompt(entry.index, entry.count)
            button.on_click(lambda _, remove=remove: app.act(lambda: app.do(remove)))
            self._prompt_buttons.append((button, entry))


def parts_listed(parts: Iterable[int], chosen: int) -> list[int]:
    """The parts that have a button: the first ``PARTS_SHOWN``, always with the chosen one."""
    ids = sorted({BASE, chosen, *parts})
    return ids if len(ids) <= PARTS_SHOWN else sorted({*ids[: PARTS_SHOWN - 1], chosen})


def _percent(share: float) -> str:
    """What there is at all is never shown as nothing."""
    return "< 0.1 %" if share < 0.0005 else f"{100 * share:.1f} %"


def _part_name(doc: Document, part: int) -> str | None:
    return next((p.name for p in doc.parts if p.id == part), None)


def _listed(value: str | None, known: tuple[str, ...]) -> str:
    """The option that says ``value``: "washing machine" is WashingMachine."""
    if value is None:
        return NONE
    said = value.replace(" ", "").lower()
    return next((k for k in known if k.lower() == said), OTHER)


def _show_choice(dropdown: Any, text: Any, value: str | None, known: tuple[str, ...]) -> None:
    """Show ``value`` in a dropdown, or in its text box where the list hasn't got it."""
    option = _listed(value, known)
    if dropdown.value != option and not (value is None and dropdown.value == OTHER):
        dropdown.value = option
    other = option == OTHER
    if text.visible != other:
        text.visible = other
    if other and text.value != value:
        text.value = value
