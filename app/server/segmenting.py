"""Segmentation of one open object: labels for its prompts, and the segmentation tools."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from app.server import segmenting_tasks, tool_tasks
from app.server.display_tasks import OpenedAsset
from app.server.jobs import CLICKS, PREVIEWS, Job, WorkerProcess
from app.server.object_context import ObjectContext
from app.server.segmenting_tasks import StoredRegion
from model.core.asset import MAX_PARTS
from model.core.errors import ArtiworldError, CommandError
from model.segmentation.prompts import BASE, Click
from sessions import commands as cmd
from sessions.document import Document, RegionRef
from sessions.state import SOURCE, SessionState
from sessions.statistics import MASKS, SEGMENTER
from sessions.tool_commands import ToolRegion

T = TypeVar("T")

Take = Callable[[Sequence[tool_tasks.RegionOffer], str], None]
POINTING = 20
"""Priority of what finds a place in the picture."""
TOOL_SECONDS = 120.0
"""Longest wait for a tool."""
_ANSWERS = frozenset({"encode", "segment", "tool", "room"})
"""Jobs of the segmenter."""
_INEFFECTIVE_SHARE = 0.03
"""A click that changes less of its part than this share is ineffective."""
_MASKS_KEPT = 50
"""Masks shown whose numbers are remembered, for undo."""


@dataclass(frozen=True)
class MaskShown:
    """The mask shown of those that a click allows.

    Attributes:
        prompts: the prompts including the mask.
        part: the part that it belongs to.
        number: 0 is the segmenter's first choice.
        total: number of masks.
        rank: how many of them are smaller.
        share: of the surface that it covers, 0..1.
    """

    prompts: tuple[Click | RegionRef, ...]
    part: int
    number: int
    total: int
    rank: int = 0
    share: float = 0.0

    def fits(self, doc: Document, part: int) -> bool:
        """True while ``part`` still shows it: its prompts are unchanged."""
        return part == self.part and doc.prompts == self.prompts


@dataclass(eq=False)
class _Clicked:
    """A click on its way to its labels.

    Attributes:
        asset: the asset that was clicked on.
        before: key of the prompts before it.
        who: the person.
        name: of the part that it makes, or None.
        prompt: its prompt, once that is shown.
        announced: the state with its prompt.
        job: finds its place, and its labels.
    """

    asset: OpenedAsset
    before: str
    who: str
    name: str | None
    prompt: Future[Click | None] = field(default_factory=Future)
    announced: SessionState | None = None
    job: Job[Any] | None = None


class Segmenting:
    """Runs the segmenter whenever an object's prompts change, and keeps the labels shown.

    Attributes:
        labels: (D,) part of each displayed element; None where nothing is segmented.
        shares: part → its share of the displayed surface, 0..1: area, or points of a cloud.
        ineffective_clicks: number of the last clicks in a row that hardly changed their part.
    """

    def __init__(self, obj: ObjectContext) -> None:
        self.labels: npt.NDArray[np.int16] | None = None
        self.shares: dict[int, float] = {}
        self.ineffective_clicks = 0
        self._answered: tuple[Click | RegionRef, ...] = ()
        self._masks_shown: deque[MaskShown] = deque(maxlen=_MASKS_KEPT)
        self._obj = obj
        self._labels_ref: str | None = None
        self._asked: tuple[tuple[object, ...], Job[Any] | None] = ((), None)
        self._held = False
        self._lock = threading.Lock()

    def forget(self) -> None:
        """Drop the labels: the object is read again, with other elements."""
        with self._lock:
            self.labels, self._labels_ref, self.shares = None, None, {}

    def prepare(self) -> None:
        """Encode the asset for the segmenter before the first click needs it."""
        obj = self._obj
        if obj.asset is None or "encode" in obj.jobs:
            return
        obj.start("encode", self._encode(obj.asset), lambda _: None)

    def _encode(self, asset: OpenedAsset) -> Job[None]:
        return self._obj.lane.segmentation.submit(
            segmenting_tasks.encode,
            asset.folder,
            self._obj.services.config.segmenter,
            on_progress=self._obj.jobs.progress("encode"),
            preempted_by=CLICKS,
            works_on=asset.folder,
        )

    def take_source_parts(self, asset: OpenedAsset) -> None:
        """Turn the source file's parts, or those of masks, into regions and its joints into the
        first prediction.

        The base's elements are regions as well, so that the segmenter has nothing to guess.
        """
        obj = self._obj
        names = dict(enumerate(asset.part_names))
        who, tool = (MASKS, asset.masks) if asset.masks else (SOURCE, "source")
        if BASE in asset.source_parts and names.get(BASE):
            obj.do(cmd.NamePart(BASE, names[BASE]), who)
        if asset.source_labels is None or not any(asset.source_parts):
            return
        regions = tuple(
            ToolRegion(part, ref, True, count, names.get(part) or None)
            for part, (ref, count) in asset.source_parts.items()
        )
        counts = {part: count for part, (_, count) in asset.source_parts.items()}
        labels = asset.source_labels
        self._held = True  # the segmenter must not run in between
        try:
            obj.do(cmd.ApplyTool(tool, regions), who)
            key = obj.document.key
            obj.do(cmd.RecordSegmentation(key, labels, tool, 0.0, counts), who)
        finally:
            self._held = False
        joints = asset.source_joints
        if joints is not None:
            obj.do(cmd.RecordPrediction(joints, labels), SOURCE)
            moving = sum(j.moves for j in joints.tree.joints) if joints.tree else 0
            body = f"{moving} joint{'s'[: moving != 1]} from {joints.file}. P predicts again"
            obj.notify("Opened with its joints", body)

    def update(self) -> None:
        """Segment where the prompts changed, and show the labels that belong to them."""
        obj = self._obj
        doc, asset = obj.document, obj.asset
        assert asset is not None
        record = doc.segmentation
        if self._held:
            return
        if doc.needs_labels:
            self._segment(asset, doc)
            return
        ref = record.labels if record is not None and doc.prompts else None
        with self._lock:
            if ref == self._labels_ref and (ref is None) == (self.labels is None):
                return
            if ref is None:
                self.labels, self._labels_ref, self.shares = None, None, {}
                return
        job = obj.lane.segmentation.submit(
            segmenting_tasks.display_labels,
            obj.services.workspace,
            ref,
            asset.element,
            priority=9,
            repeated=True,
        )
        obj.start("labels", job, self._if_current(asset, lambda labels: self._show(ref, labels)))

    def _segment(self, asset: OpenedAsset, doc: Document) -> None:
        """Answer the prompts, unless that is under way: a click and an answer may ask at once."""
        obj = self._obj
        with self._lock:
            asked, job = self._asked
            if asked == (asset.folder, doc.key) and job is not None and not job.done:
                return
            job = self._submit(
                obj.lane.segmentation,
                segmenting_tasks.segment,
                stored_prompts(doc),
                doc.key,
                asset.element,
                on_progress=obj.jobs.progress("segment"),
                priority=10,
                key=("segment", obj.record.id),
            )
            self._asked = ((asset.folder, doc.key), job)
        obj.start("segment", job, self._if_current(asset, self._keep))

    def _submit(
        self, worker: WorkerProcess, task: Callable[..., T], *args: Any, **how: Any
    ) -> Job[T]:
        """Have a worker do something for a click, with the asset and the segmenter."""
        services, folder = self._obj.services, self._obj.need_asset().folder
        how = {"works_on": folder, "preempted_by": CLICKS, **how}
        known = folder, services.workspace, services.config.segmenter
        return worker.submit(task, *known, *args, repeated=True, **how)

    def click(
        self,
        aim: segmenting_tasks.Aim,
        part: int,
        positive: bool,
        who: str,
        name: str | None = None,
    ) -> Future[Click | None]:
        """Answer a click by one job: its prompt shows as soon as its place is known, and is stored
        together with its labels.

        While the segmenter is at work on the object, the other process finds the place, and the
        prompt is stored before its labels are there.

        Args:
            name: of the part, where the click makes it.

        Returns:
            The prompt; None where the ray hits nothing.
        """
        obj, asset, doc = self._obj, self._obj.need_asset(), self._obj.document
        alone = _ANSWERS.isdisjoint(obj.jobs.busy)
        clicked = _Clicked(asset, doc.key, who, name)
        worker = obj.lane.segmentation if alone else obj.lane.geometry
        with self._lock:
            clicked.job = self._submit(
                worker,
                segmenting_tasks.click,
                stored_prompts(doc) if alone else None,
                aim,
                part,
                positive,
                asset.element,
                on_found=lambda prompt: self._found(clicked, prompt),
                on_progress=obj.jobs.progress("segment"),
                priority=POINTING,
            )
        if alone:
            obj.jobs.add("segment", clicked.job, lambda job: self._clicked(clicked, job))
        else:
            clicked.job.add_done_callback(lambda job: self._clicked(clicked, job))
        return clicked.prompt

    def _found(self, clicked: _Clicked, prompt: Click | None) -> None:
        """Show the prompt of a click."""
        obj = self._obj
        if clicked.prompt.done():
            return  # its worker died, and answers once more
        try:
            if prompt is not None and obj.asset is clicked.asset:
                clicked.announced = obj.live.announce(
                    cmd.AddClick(prompt, name=clicked.name), clicked.who
                )
                with self._lock:
                    self._asked = ((clicked.asset.folder, obj.document.key), clicked.job)
                obj.changed()
        except ArtiworldError as error:
            clicked.prompt.set_exception(error)
        else:
            clicked.prompt.set_result(prompt)

    def _clicked(self, clicked: _Clicked, job: Job[Any]) -> None:
        """Store the prompt of a click, with its labels."""
        obj, answers = self._obj, list[segmenting_tasks.SegmentationAnswer]()
        error = obj.jobs.deliver("segment", job, answers.append)
        obj.jobs.drop("segment", job)
        if error is not None and not clicked.prompt.done():
            clicked.prompt.set_exception(error)
        elif clicked.announced is not None:
            self._held = error is not None  # it would only fail again
            try:
                self._keep_click(clicked, clicked.announced, answers[0] if answers else None)
            except ArtiworldError as refused:
                error = refused
                self.forget()
                if obj.asset is not None:
                    self.update()  # back to the stored labels
            finally:
                self._held = False
            if isinstance(error, ArtiworldError):
                obj.notify("Failed", str(error), "red")
        obj.changed()

    def _keep_click(
        self,
        clicked: _Clicked,
        announced: SessionState,
        answer: segmenting_tasks.SegmentationAnswer | None,
    ) -> None:
        click, record = announced.present.prompts[-1], None
        assert isinstance(click, Click)
        same = announced.past[-1].key == clicked.before and self._obj.asset is clicked.asset
        if answer is not None and same:
            record = self._show_answer(replace(answer, prompts_key=announced.present.key))
        stored = self._obj.live.complete(announced, cmd.AddClick(click, record, clicked.name))
        if record is not None and not stored:
            self._obj.do(record, SEGMENTER)
        elif not stored and self._obj.asset is not None:
            self.update()  # another command stored it, while this job was still to answer it

    def _if_current(self, asset: OpenedAsset, keep: Callable[[T], None]) -> Callable[[T], None]:
        """Return ``keep``, which then ignores results for an asset that was replaced meanwhile."""
        return lambda answer: keep(answer) if self._obj.asset is asset else None

    def _keep(self, answer: segmenting_tasks.SegmentationAnswer) -> None:
        self._obj.do(self._show_answer(answer), SEGMENTER)

    def _show_answer(self, answer: segmenting_tasks.SegmentationAnswer) -> cmd.RecordSegmentation:
        """Show an answer; returns its record."""
        self._count_ineffective(answer)
        # Labels of undone prompts aren't shown; those of earlier prompts are better than none.
        doc = self._obj.document
        if answer.prompts_key == doc.key or doc.needs_labels:
            self._show(answer.labels, answer.display_labels)
        return cmd.RecordSegmentation(
            answer.prompts_key, answer.labels, answer.segmenter, answer.seconds, answer.counts
        )

    def _count_ineffective(self, answer: segmenting_tasks.SegmentationAnswer) -> None:
        """Note whether the last click had an effect."""
        doc, before, answered = self._obj.document, self.labels, self._answered
        if answer.prompts_key != doc.key:
            return  # newer prompts are being segmented
        self._answered = doc.prompts
        last = doc.prompts[-1] if doc.prompts else None
        now = answer.display_labels
        if not isinstance(last, Click) or doc.prompts[:-1] != answered or before is None:
            self.ineffective_clicks = 0
            return
        part = max(int((before == last.part).sum()), int((now == last.part).sum()))
        little = len(before) == len(now) and (before != now).sum() < _INEFFECTIVE_SHARE * part
        # Checked last, as it reads the stored labels of all elements.
        ineffective = little and not self._agreed(last)
        self.ineffective_clicks = self.ineffective_clicks + 1 if ineffective else 0

    def _agreed(self, click: Click) -> bool:
        """True if the labels agreed with a click already before it."""
        if click.element is None:
            return False
        part = self._obj.part_of(click.element)
        return part is not None and (part == click.part) == click.positive

    def _show(self, ref: str, labels: npt.NDArray[np.int16]) -> None:
        asset = self._obj.asset  # None where the object is being read again
        shares = _shares(labels, None if asset is None else asset.area)
        with self._lock:
            self._labels_ref, self.labels, self.shares = ref, labels, shares

    def use_tool(self, request: tool_tasks.ToolRequest, who: str) -> int:
        """Run a segmentation tool; returns how many regions it found, see :meth:`find`."""
        offers, replaces, take = self.find(request)
        if isinstance(offers, tool_tasks.FaceCutOffer):
            self._cut_faces(offers, request, who)
            return 1
        if isinstance(offers, tool_tasks.MaskOffer):
            return self._show_mask(offers, replaces, request.part, who)
        take(offers, who)
        known = max((offer.known for offer in offers), default=0)
        if known:
            self._obj.notify("All parts", f"like {known} accepted objects of its kind")
        return len(offers)

    def find(self, request: tool_tasks.ToolRequest) -> tuple[tool_tasks.Offer, int, Take]:
        """Run a segmentation tool without changing the object.

        Returns:
            What it found, the number of the last prompts that this replaces, and what makes parts
            of regions that were found, as one step.

        Raises:
            CommandError: where the tool can't work on the present parts, the object changed
                meanwhile, or the server is too busy.
            Cancelled: where somebody stopped it.
        """
        obj = self._obj
        asset, doc = obj.need_asset(), obj.document
        replaces = _last_of(doc, request.part) if request.tool == tool_tasks.NEXT_MASK else 0
        kept = stored_prompts(doc)[: len(doc.prompts) - replaces]
        if request.tool == tool_tasks.NEXT_MASK:
            request = replace(request, turn=self._turn(doc, request, replaces))
        used = {p.id for p in doc.parts} - _never_used(doc)
        category = doc.category or request.category
        request = replace(request, free_part=_free(used), category=category)
        long = request.tool == tool_tasks.PROPOSE
        if long:  # clicks on the same asset come between its steps, so encode it first
            self._encode(asset)
        job = self._submit(
            obj.lane.segmentation,
            tool_tasks.use_tool,
            kept,
            request,
            on_progress=obj.jobs.progress("tool"),
            priority=PREVIEWS - 1 if long else 12,
            preempted_by=PREVIEWS if long else CLICKS,
            works_on=None if long else asset.folder,
        )
        obj.jobs.add("tool", job, self._tool_ended)
        obj.changed()
        try:
            offers = job.result(TOOL_SECONDS)
        except TimeoutError as error:
            job.cancel()
            raise CommandError(
                f"the server is too busy: the tool got no result within {TOOL_SECONDS:.0f} s"
            ) from error
        self._check_unchanged(doc)
        return offers, replaces, lambda kept, who: self._take(doc, request, kept, who)

    def _check_unchanged(self, doc: Document) -> None:
        if _tool_input(self._obj.document) != _tool_input(doc):
            raise CommandError("the object was changed meanwhile: use the tool again")

    def _take(
        self,
        doc: Document,
        request: tool_tasks.ToolRequest,
        offers: Sequence[tool_tasks.RegionOffer],
        who: str,
    ) -> None:
        self._check_unchanged(doc)
        if not offers:
            return
        empty = _never_used(doc)
        used = {p.id for p in doc.parts} - empty
        named = request.tool in ("same shape", "mirror")
        name = doc.part_names.get(request.part) if named else None
        source = doc.part(request.part) if named else None
        like = None if source is None else source.id if source.like is None else source.like
        regions = []
        for offer in offers:
            part = offer.part
            if part == tool_tasks.NEW_PART:
                part = _free(used)
                used.add(part)
            called = offer.name or name or (request.name if part == request.part else None)
            regions.append(
                ToolRegion(part, offer.elements, offer.positive, offer.count, called, like)
            )
        # A new part takes the number of an empty one, but not its name.
        gone = {r.part for r in regions} & empty - {request.part}
        if request.tool == "merge" and request.other:
            gone.add(request.other)
        self._obj.do(cmd.ApplyTool(request.tool, tuple(regions), 0, tuple(sorted(gone))), who)

    def _tool_ended(self, job: Job[tool_tasks.Offer]) -> None:
        self._obj.jobs.drop("tool", job)
        self._obj.changed()

    def _turn(self, doc: Document, request: tool_tasks.ToolRequest, replaces: int) -> int:
        """Return the number of the mask ``turn`` steps after the one shown."""
        shown = self.mask_shown(doc, request.part)
        if shown is not None:
            return shown.number + request.turn
        # A mask that was chosen before this server started: most likely the first one.
        return (1 if replaces else 0) + request.turn

    def mask_shown(self, doc: Document, part: int) -> MaskShown | None:
        """Return the mask that ``part`` shows; None where nobody asked for another one."""
        return next((m for m in reversed(self._masks_shown) if m.fits(doc, part)), None)

    def _show_mask(self, offer: tool_tasks.MaskOffer, replaces: int, part: int, who: str) -> int:
        obj = self._obj
        if offer.regions or replaces:
            regions = tuple(
                ToolRegion(r.part, r.elements, r.positive, r.count) for r in offer.regions
            )
            obj.do(cmd.ApplyTool(tool_tasks.NEXT_MASK, regions, replaces), who)
        if offer.total > 1:
            shown = MaskShown(
                obj.document.prompts, part, offer.number, offer.total, offer.rank, offer.share
            )
            self._masks_shown.append(shown)
        return offer.total - 1

    def _cut_faces(
        self, offer: tool_tasks.FaceCutOffer, request: tool_tasks.ToolRequest, who: str
    ) -> None:
        """Split faces; their parts are known, so the segmenter doesn't run."""
        obj, names = self._obj, {request.part: request.name}
        regions = tuple(
            ToolRegion(r.part, r.elements, True, r.count, names.get(r.part)) for r in offer.regions
        )
        obj.do(cmd.CutFaces(request.tool, offer.cut, regions), who)
        obj.do(
            cmd.RecordSegmentation(obj.document.key, offer.labels, "cut", 0.0, offer.counts),
            SEGMENTER,
        )


def _shares(
    labels: npt.NDArray[np.int16], area: npt.NDArray[np.float32] | None
) -> dict[int, float]:
    """Return each part's share of the surface; -1 stands for unassigned elements."""
    # Faces may have been cut since the labels were computed.
    weight = area if area is not None and len(area) == len(labels) else None
    sums = np.bincount(labels.astype(np.int64) + 1, weight)
    total = max(float(sums.sum()), 1e-12)
    return {int(i) - 1: float(sums[i] / total) for i in np.flatnonzero(sums)}


def _tool_input(doc: Document) -> tuple[object, ...]:
    """Return the decisions that a tool's result refers to."""
    frame = (doc.up_axis, doc.unit_scale, doc.frame, doc.left_out, doc.face_cuts)
    return doc.prompts, {p.id for p in doc.parts}, frame


def _never_used(doc: Document) -> set[int]:
    """Return the declared parts without prompt, name or joint."""
    used = {0, *(p.part for p in doc.prompts), *(p.like for p in doc.parts)}
    links = () if doc.tree is None else doc.tree.links
    return {
        p.id
        for p in doc.parts
        if p.id not in used and p.name is None and p.like is None and p.link not in links
    }


def _free(used: set[int]) -> int:
    found = next((i for i in range(1, MAX_PARTS) if i not in used), None)
    if found is None:
        raise CommandError(f"an object has at most {MAX_PARTS - 1} parts beside the base")
    return found


def _last_of(doc: Document, part: int) -> int:
    """Return how many prompts at the end are another mask of ``part``."""
    count = 0
    for prompt in reversed(doc.prompts):
        if isinstance(prompt, Click) or (prompt.tool, prompt.part) != (tool_tasks.NEXT_MASK, part):
            break
        count += 1
    return count


def stored_prompts(doc: Document) -> tuple[Click | StoredRegion, ...]:
    """Return the prompts as workers take them."""
    return tuple(
        p if isinstance(p, Click) else StoredRegion(p.part, p.elements, p.positive)
        for p in doc.prompts
    )
