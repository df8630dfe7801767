"""The first step: which parts are there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import viser

from app.server.open_object import OpenObject
from app.server.tool_tasks import LikeOffer, object_name
from app.viewer.input.pointing import Pointing
from app.viewer.panels.comments import Instructions
from app.viewer.panels.extracting import SourcePanel
from app.viewer.panels.part_list import CategoryGuess, PartList, PromptList, category_in
from app.viewer.panels.widgets import Choice, PredictButtons, Presses, offered, put
from app.viewer.picture import palette
from app.viewer.picture.stage import may_be_a_room
from app.viewer.steps.prepare import PrepareStep
from app.viewer.tab import Tab
from app.viewer.words import annotate as words
from app.viewer.words.prepare import PREPARE, SEARCHING
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.database import ObjectRecord
from sessions.document import Document
from sessions.project_settings import Project


class AnnotateStep:
    """Controls of the annotate step.

    Args:
        records: the queue.
        open_object: gets the id of an object that was cut out.
        prepare: the step before.
        presses: events of the custom controls.

    Attributes:
        instructions: of the project.
        parts: the list of parts.
        source: how the source is read, and what of it is left out.
    """

    def __init__(
        self,
        tab: Tab,
        pointing: Pointing,
        records: Callable[[], Sequence[ObjectRecord]],
        open_object: Callable[[int], None],
        prepare: PrepareStep,
        presses: Presses,
        project: Project,
    ) -> None:
        self._tab, self._pointing, self._prepare = tab, pointing, prepare
        self._project = project
        self._drawn: Any = None
        gui = tab.client.gui
        # Above what comes and goes, so that it keeps its place.
        self._predict = PredictButtons(tab)
        self.instructions = Instructions(tab, project)
        self._hint = gui.add_markdown("")
        self._alike = gui.add_button("", icon=viser.Icon.COPY, color="blue", visible=False)
        self._to_prepare = gui.add_button(PREPARE, color="blue", visible=False)
        self._room = gui.add_button("", icon=viser.Icon.SCISSORS, color="gray", visible=False)
        self._category = Choice(
            tab,
            words.CATEGORY,
            palette.CATEGORIES,
            lambda: tab.selection.need_object().document.category,
            lambda category: tab.do(cmd.SetCategory(category)),
        )
        self._guess = CategoryGuess(
            tab, records, lambda category: tab.do(cmd.SetCategory(category)), project
        )
        self.parts = PartList(tab, pointing, presses, project)
        self._prompts = PromptList(tab)
        self.source = SourcePanel(tab, open_object)
        self._alike.on_click(lambda _: tab.act(self.take_alike))
        self._room.on_click(lambda _: tab.act(self._room_clicked))
        self._to_prepare.on_click(lambda _: tab.act(lambda: tab.selection.set_step("Prepare")))

    def _room_clicked(self) -> None:
        if self._room.label == words.EXCLUDE_ROOM:
            self.source.leave_out()
        else:
            self.source.cut_out()

    def take_found(self) -> bool:
        """Make parts of what *Same shape* found; False where nothing waits."""
        tools = self._pointing.tools
        waits = bool(tools.finds)
        tools.take()
        return waits

    def delete(self) -> None:
        """Leave out the piece found that is highlighted, else delete the selected part."""
        tools = self._pointing.tools
        (tools.leave_out if tools.finds else self.parts.delete)()

    def take_alike(self) -> None:
        """Take the parts of the accepted object that this one is like, if there is one."""
        obj = self._tab.selection.object
        offer = None if obj is None or self._tab.in_scene else obj.likeness.wanted
        if obj is None or offer is None:
            return
        count = obj.likeness.take(self._tab.user)
        self._tab.notify(*words.alike_taken(count, _name_of(offer)), "green")

    @property
    def likely_category(self) -> str | None:
        """The object's category, or the one that is suggested first."""
        return self._tab.selection.need_object().document.category or self._guess.first

    def next_mask(self, step: int) -> None:
        """Take another mask for the last click: the next one, or with -1 the one before."""
        self._pointing.tools.next_mask(step)

    def name_by_key(self, number: int) -> str:
        """Take the name of a digit for a part; 0 takes the suggested category.

        Returns:
            The result, for the user.
        """
        if number == 0:
            category = self._guess.take_first()
            return words.category_set(category) if category else words.NO_SUGGESTION
        self.parts.take_number(number)
        return ""

    def draw(self, obj: OpenObject) -> None:
        """Bring the widgets up to date."""
        selection, doc = self._tab.selection, obj.document
        self._predict.show_here(obj.backend_away and not selection.picking)
        shares = obj.segmenting.shares
        now = (
            obj.record.id,
            doc.parts,
            doc.prompts,
            doc.category,
            doc.review.state,
            doc.left_out,
            tuple(shares.items()),
            selection.part,
            self._pointing.tools.label,
            selection.hidden,
            id(obj.asset),
            selection.picking,
            doc.segmentation is None,
            id(obj.preparing.current),
            "prepare" in obj.busy,
            id(obj.likeness.offer),
            self._project.settings,
        )
        if now != self._drawn:
            self._drawn = now
            settings = self._project.settings
            self.instructions.draw()
            self._category.offer(offered(settings.categories, palette.CATEGORIES, settings.strict))
            self._draw_hint(obj, doc)
            ready = doc.segmentation is not None and self._room.color != "blue"
            self._predict.show(not selection.picking, "blue" if ready else "gray")
            picking = selection.picking  # what is taken out is named above
            self._category.show(doc.category, not picking)
            asked = doc.category is None and not picking and doc.review.state != "accepted"
            self._guess.show(asked)
            obj.likeness.likely = obj.likeness.likely or self.likely_category
            obj.likeness.update()
            self.parts.draw(doc, shares, self.likely_category)
            asset = obj.asset
            self._prompts.draw(doc, "face" if asset is None else asset.element_kind)
        self.source.draw(obj)

    def _draw_hint(self, obj: OpenObject, doc: Document) -> None:
        selection = self._tab.selection
        asset = obj.asset  # another thread may let it be read anew
        wide = asset is not None and may_be_a_room(asset.bounds)
        room = wide and not self._tab.in_scene and doc.placement is None
        whole = room and doc.left_out is None and not doc.prompts
        # A name or a category says that it is one thing, at whatever size.
        named = doc.category or category_in(obj.record.path.stem)
        sure = room and named is None and doc.tree is None
        searching = sure and "prepare" in obj.busy
        noticed = self._prepare.notice(obj)
        put(self._to_prepare, visible=noticed is not None)
        alike = None if sure or noticed or selection.picking else obj.likeness.wanted
        if alike is not None:
            put(self._alike, label=words.take_alike(len(alike.regions), _name_of(alike)))
        put(self._alike, visible=alike is not None)
        mine = [p for p in doc.prompts if p.part == selection.part]
        put(self._room, label=words.EXCLUDE_ROOM if whole else words.EXTRACT)
        acts = sure and (whole or doc.segmentation is not None)
        put(self._room, color="blue" if acts else "gray")
        put(self._room, visible=room and noticed is None and not searching)
        if selection.picking:
            text = words.extracting(selection.part)
        elif noticed is not None:
            text = noticed
        elif doc.review.state == "accepted":
            text = words.IS_ACCEPTED
        elif searching:
            text = SEARCHING
        elif whole and sure:
            text = words.IS_ROOM
        elif room and sure:
            text = words.IN_ROOM
        elif not mine and (selection.part or not doc.prompts):
            text = words.CLICK_A_PART
        elif any(isinstance(p, Click) for p in mine):
            text = words.REFINE_WITH_MASKS
        else:
            text = f"{words.REFINE} {words.DELETE_PART}" if selection.part else words.REFINE
        put(self._hint, content=text)


def _name_of(offer: LikeOffer) -> str:
    return object_name(offer.folder) or words.of_a_kind(offer.known)
