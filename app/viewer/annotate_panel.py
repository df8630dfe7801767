"""Parts, their names, and the prompts that made them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import viser

from app.viewer import palette
from app.viewer.text import plain
from app.viewer.widgets import put
from app.workbench import OpenObject
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.document import Document

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

NONE, OTHER = "—", "other…"
UNITS = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254}
PROMPTS_SHOWN = 12
PARTS_SHOWN = 40


class AnnotatePanel:
    """The first step: which parts are there."""

    def __init__(self, app: ClientApp) -> None:
        self._app = app
        self._drawn: Any = None
        self._turn = 0
        self._turned: tuple[int, int] | None = None
        gui = app.client.gui
        self._hint = gui.add_markdown("")
        self._category = gui.add_dropdown(
            "Category", (NONE, *palette.CATEGORIES, OTHER), initial_value=NONE
        )
        self._category_text = gui.add_text("Other category", "", visible=False)
        with gui.add_folder("Parts"):
            self._parts_box = gui.add_folder(None)
            self._buttons: dict[int, Any] = {}
            self._part_actions = gui.add_button_group("Part", ("Add", "Hide", "Delete"))
            self._name = gui.add_dropdown(
                "Part is a", (NONE, *palette.PART_NAMES, OTHER), initial_value=NONE
            )
            self._name_text = gui.add_text("Other name", "", visible=False)
            self._tools = gui.add_button_group("This part", ("Next mask", "Connected"))
            self._tools_size = gui.add_button_group("Its size", ("Grow", "Shrink"))
            self._tools_more = gui.add_button_group("Find", ("Same shape", "All parts"))
        with gui.add_folder("Prompts", expand_by_default=True):
            self._prompt_note = gui.add_markdown("")
            self._prompt_box = gui.add_folder(None)
            self._prompt_buttons: list[tuple[Any, int]] = []
            self._prompt_actions = gui.add_button_group("Remove", ("Last", "Of this part", "All"))
        self._predict = gui.add_button("Predict joints (P)", icon=viser.Icon.WAND, color="blue")
        self._here = gui.add_button(
            "Predict on this machine", icon=viser.Icon.CPU, color="gray", visible=False
        )
        with gui.add_folder("Source", expand_by_default=False):
            self._source = gui.add_markdown("")
            self._up = gui.add_dropdown("Up axis", ("z", "y", "x", "-z", "-y", "-x"))
            self._unit = gui.add_dropdown("File's unit", tuple(UNITS))
            self._frame = gui.add_button("Read again with these", color="gray")
            self._touch = gui.add_checkbox(
                "Touch screen", False, hint="A tap adds a prompt; keys are not needed"
            )
        self._wire()

    def _wire(self) -> None:
        app = self._app
        app.on_update(self._category, self._category_chosen)
        app.on_update(self._category_text, self._category_typed)
        app.on_update(self._name, self._name_chosen)
        app.on_update(self._name_text, self._name_typed)
        app.on_update(self._touch, self._touched)
        self._part_actions.on_click(lambda e: app.act(lambda: self._part_action(e.target.value)))
        for group in (self._tools, self._tools_size, self._tools_more):
            group.on_click(lambda e: app.act(lambda: self.use_tool(e.target.value)))
        self._prompt_actions.on_click(
            lambda e: app.act(lambda: self._prompt_action(e.target.value))
        )
        self._predict.on_click(lambda _: app.act(app.predict))
        self._here.on_click(lambda _: app.act(app.predict_here))
        self._frame.on_click(lambda _: app.act(self._read_again))

    # --- what a person does

    def _document(self) -> Document:
        return self._app.need_object().document

    def _category_chosen(self) -> None:
        value = self._category.value
        self._category_text.visible = value == OTHER
        if value == OTHER:
            return
        category = None if value == NONE else value
        if category != self._document().category:
            self._app.do(cmd.SetCategory(category))

    def _category_typed(self) -> None:
        if self._category_text.value.strip():
            self._app.do(cmd.SetCategory(self._category_text.value))

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
                self._app.do(cmd.NamePart(part, name))

    def _part_action(self, action: str) -> None:
        app = self._app
        if action == "Add":
            app.choose_part(self._document().next_part)
        elif action == "Hide":
            self.toggle_hidden()
        elif app.part:
            app.do(cmd.DeletePart(app.part))
            app.part = min((p.id for p in self._document().parts if p.id), default=1)

    def toggle_hidden(self) -> None:
        """Hide the chosen part (its joint's part in the other steps), or show it again."""
        app = self._app
        part = app.part
        if app.stage != "Annotate" and app.child is not None:
            digits = app.child.removeprefix("link_")
            part = int(digits) if digits.isdigit() else part
        app.hidden = app.hidden ^ {part}
        app.invalidate()

    def use_tool(self, label: str) -> None:
        """Let a segmentation tool work on the chosen part."""
        app, obj = self._app, self._app.need_object()
        tool = "propose" if label == "All parts" else label.lower()
        last = (obj.record.id, app.part)
        self._turn = self._turn + 1 if tool == "next mask" and self._turned == last else 0
        self._turned = last if tool == "next mask" else None
        found = obj.use_tool(tool, app.part, app.who, self._turn)
        if not found:
            app.notify(label, "It found nothing to change", "gray")
        elif tool in ("same shape", "propose"):
            app.notify(label, f"{found} new part{'s'[: found != 1]}; undo takes them back", "green")

    def _prompt_action(self, action: str) -> None:
        prompts = self._document().prompts
        if not prompts:
            return
        if action == "Last":
            self._app.do(cmd.RemovePrompt(len(prompts) - 1))
        else:
            self._app.do(cmd.ClearPrompts(self._app.part if action == "Of this part" else None))

    def _read_again(self) -> None:
        app, obj = self._app, self._app.need_object()
        scale = UNITS[self._unit.value]
        app.do(cmd.SetFrame(self._up.value, scale))
        obj.ensure_open()

    def _touched(self) -> None:
        self._app.touch_wanted = self._touch.value

    # --- drawing

    def draw(self, obj: OpenObject) -> None:
        """Bring the panel up to date."""
        put(self._here, "visible", obj.backend_away)
        app, doc = self._app, obj.document
        counts = {} if doc.segmentation is None else dict(doc.segmentation.counts)
        now = (
            obj.record.id,
            doc.parts,
            doc.prompts,
            doc.category,
            tuple(counts.items()),
            app.part,
            app.hidden,
            id(obj.asset),
        )
        if now == self._drawn:
            return
        before = self._drawn
        source_changed = before is None or before[0] != now[0] or before[-1] != now[-1]
        self._drawn = now
        self._draw_hint(doc)
        self._draw_parts(doc, counts)
        self._draw_names(doc)
        self._draw_prompts(doc)
        if source_changed:
            self._draw_source(obj, doc)

    def _draw_hint(self, doc: Document) -> None:
        if not doc.prompts:
            text = (
                "**Click a part that moves** (a door, a drawer, a knob). "
                "Press **2**, **3**, … for the next part; Shift+click says *not this*."
            )
        else:
            text = "Unclaimed surface is the base. Tint wrong? Click there, or Shift+click."
        put(self._hint, "content", text)

    def _draw_parts(self, doc: Document, counts: dict[int, int]) -> None:
        app = self._app
        ids = sorted({0, app.part, *(p.id for p in doc.parts)})[:PARTS_SHOWN]
        for part in [p for p in self._buttons if p not in ids]:
            self._buttons.pop(part).remove()
        total = max(sum(counts.values()), 1)
        gui = app.client.gui
        for part in ids:
            if part not in self._buttons:
                with self._parts_box:
                    button = gui.add_button("", color=palette.part_color(part), order=float(part))
                button.on_click(lambda _, part=part: app.act(lambda: app.choose_part(part)))
                self._buttons[part] = button
            button = self._buttons[part]
            name = _part_name(doc, part) or ("base" if part == 0 else "part")
            share = f" · {100 * counts[part] / total:.1f} %" if counts.get(part) else ""
            mark = "▸ " if part == app.part else ""
            hidden = " (hidden)" if part in app.hidden else ""
            put(button, "label", f"{mark}{part} · {name[:24]}{share}{hidden}")

    def _draw_names(self, doc: Document) -> None:
        name = _part_name(doc, self._app.part)
        _show_choice(self._name, self._name_text, name, palette.PART_NAMES)
        _show_choice(self._category, self._category_text, doc.category, palette.CATEGORIES)

    def _draw_prompts(self, doc: Document) -> None:
        app = self._app
        mine = [(i, p) for i, p in enumerate(doc.prompts) if p.part == app.part]
        note = f"{len(mine)} on this part, {len(doc.prompts)} in all. Click one to remove it."
        put(self._prompt_note, "content", note if doc.prompts else "None yet.")
        wanted = mine[-PROMPTS_SHOWN:]
        if [i for _, i in self._prompt_buttons] == [i for i, _ in wanted] and all(
            button.label == _prompt_label(p)
            for (button, _), (_, p) in zip(self._prompt_buttons, wanted, strict=True)
        ):
            return
        for button, _ in self._prompt_buttons:
            button.remove()
        self._prompt_buttons = []
        for index, prompt in wanted:
            with self._prompt_box:
                button = app.client.gui.add_button(
                    _prompt_label(prompt), icon=viser.Icon.X, color="gray"
                )
            button.on_click(lambda _, index=index: app.act(lambda: app.do(cmd.RemovePrompt(index))))
            self._prompt_buttons.append((button, index))

    def _draw_source(self, obj: OpenObject, doc: Document) -> None:
        asset = obj.asset
        lines = [f"`{plain(str(obj.record.path), 200)}`"]
        if asset is not None:
            lines += [f"⚠ {plain(w, 300)}" for w in asset.warnings]
            self._up.value = asset.up_axis
        for word, scale in UNITS.items():
            if abs(scale - doc.unit_scale) < 1e-9:
                self._unit.value = word
        lines.append("Reading again starts this object afresh (undo brings it back).")
        self._source.content = "\n\n".join(lines)


def _part_name(doc: Document, part: int) -> str | None:
    return next((p.name for p in doc.parts if p.id == part), None)


def _prompt_label(prompt: Any) -> str:
    if isinstance(prompt, Click):
        x, y, z = prompt.position
        sign = "+" if prompt.positive else "−"
        return f"{sign}  {x:.3f}, {y:.3f}, {z:.3f} m"
    sign = "+" if prompt.positive else "−"
    return f"{sign}  {prompt.tool}: {prompt.count:,} elements"


def _show_choice(dropdown: Any, text: Any, value: str | None, known: tuple[str, ...]) -> None:
    """Show ``value`` in a dropdown, or in its text box where the list hasn't got it."""
    option = NONE if value is None else (value if value in known else OTHER)
    if dropdown.value != option and not (value is None and dropdown.value == OTHER):
        dropdown.value = option
    other = option == OTHER
    if text.visible != other:
        text.visible = other
    if other and text.value != value:
        text.value = value
