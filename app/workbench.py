"""The objects that are open, the jobs they ask for, and who looks at them.

One :class:`Workbench` a server; one :class:`OpenObject` an object, shared by all the tabs that show
it. Decisions live in the session's commands; this module runs the jobs that the state asks for and
feeds their answers back as commands.
"""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from app import (
    display_tasks,
    judging_tasks,
    part_tasks,
    picking_tasks,
    room_tasks,
    saving_tasks,
    segmenting_tasks,
    tool_tasks,
)
from app.config import ServeConfig
from app.jobs import Job, WorkerProcess
from app.judging import JointCheck, Judging
from app.part_tasks import PartSource
from app.review_order import ReviewOrder
from app.tasks import ReadOptions
from app.watched import Listener, Watched
from model.errors import ArtiworldError, CommandError
from model.gate.report import GateReport
from model.geometry.asset import Source
from model.kinematics.tree import KinematicTree
from model.predictors import DEFAULT as DEFAULT_PREDICTOR
from model.progress import Cancelled
from model.remote.http_predictor import BackendError
from model.segmentation.prompts import MAX_PARTS, Click
from sessions import commands as cmd
from sessions.live import LiveSession, SessionHub
from sessions.provenance import provenance
from sessions.state import Context, Document, SessionState, acceptance_problems, apply, needed_jobs
from sessions.store import Entry, ObjectRecord, Store
from sessions.tool_commands import ToolRegion

if TYPE_CHECKING:
    from app.scene_desk import SceneDesk

log = logging.getLogger(__name__)
TOOL_SECONDS = 120.0


class Workbench:
    """Workers, store and open objects of one server."""

    def __init__(self, config: ServeConfig, store: Store, paths: list[Path]) -> None:
        self.config = config
        self.store = store
        self.hub = SessionHub(store)
        self.workspace = Path(config.workspace)
        self.geometry = WorkerProcess("geometry")
        self.segmentation = WorkerProcess("segmentation")
        self.prediction = WorkerProcess("prediction")
        self.saving = WorkerProcess("saving")
        self._preparing: tuple[PartSource, KinematicTree, Job[Path]] | None = None
        self._lock = threading.RLock()
        self._open: dict[int, OpenObject] = {}
        self.review_order = ReviewOrder(lambda i: store.load(i).present)
        self.desk: SceneDesk | None = None
        self._queue_listeners: list[Listener] = []
        self._ids: list[int] = []
        self._records: dict[int, ObjectRecord] = {}
        self.add_paths(paths)

    def add_paths(self, paths: list[Path]) -> list[int]:
        """Put files or folders into the queue; returns their object ids."""
        records = self.store.open_objects((p, None, p.stem) for p in paths)
        ids = [r.id for r in records]
        with self._lock:
            self._ids = list(dict.fromkeys([*self._ids, *ids]))
            self._records.update({r.id: r for r in records})
        self._tell_queue()
        return ids

    def add_upload(self, name: str, content: bytes) -> int:
        """Keep a file that a browser sent, or what a zip holds; the first object's id.

        Raises:
            InputFileError: where nothing in it can be opened, or a zip is hostile.
        """
        from app.uploads import keep_upload
        from model.geometry.readers import find_assets

        most = 4 * self.config.max_upload_mb * 1_000_000
        kept = keep_upload(self.workspace / "uploads", name, content, most)
        return self.add_paths(find_assets([kept]))[0]

    def records(self) -> list[ObjectRecord]:
        """The queue: objects of this run, in the order they were given."""
        with self._lock:
            return [self._records[i] for i in self._ids]

    def object(self, object_id: int) -> OpenObject:
        """The shared view of an object; opens it on first use."""
        with self._lock:
            if object_id not in self._open:
                self._open[object_id] = OpenObject(self, self.store.object(object_id))
            opened = self._open[object_id]
        opened.ensure_open()
        return opened

    def on_queue(self, listener: Listener) -> Callable[[], None]:
        """Call ``listener`` when a state in the queue changes. Returns its removal."""
        self._queue_listeners.append(listener)

        def stop() -> None:
            if listener in self._queue_listeners:
                self._queue_listeners.remove(listener)

        return stop

    def queue_changed(self, object_id: int) -> None:
        """Tell all tabs that an object stands elsewhere now."""
        record = self.store.object(object_id)
        with self._lock:
            before, self._records[object_id] = self._records.get(object_id), record
        if before is None or before.state != record.state:
            self._tell_queue()

    def _tell_queue(self) -> None:
        for listener in list(self._queue_listeners):
            listener()

    def prepare_asset(self, source: PartSource, tree: KinematicTree) -> None:
        """Write the asset that will probably be accepted next; what fails is told on accepting."""
        self.stop_preparing()
        job = self.saving.submit(saving_tasks.prepare_asset, source, tree)
        self._preparing = (source, tree, job)

    def stop_preparing(self) -> None:
        """The joints changed, or something else is saved."""
        preparing, self._preparing = self._preparing, None
        if preparing is not None:
            preparing[2].cancel()

    def save_asset(
        self,
        source: PartSource,
        tree: KinematicTree,
        folder: Path,
        record: dict[str, Any],
        on_progress: Callable[[float, str], None],
    ) -> Job[str]:
        """Write an accepted asset, after its draft where that is being written."""
        if self._preparing is not None and self._preparing[:2] != (source, tree):
            self.stop_preparing()
        return self.saving.submit(
            saving_tasks.save_asset_folder, source, tree, folder, record, on_progress=on_progress
        )

    def close(self) -> None:
        """End the workers."""
        if self.desk is not None:
            self.desk.close()
        for worker in (self.geometry, self.segmentation, self.prediction, self.saving):
            worker.close()


class OpenObject(Watched):
    """One object as all its tabs see it: asset, session, labels, running jobs."""

    def __init__(self, bench: Workbench, record: ObjectRecord) -> None:
        self.bench = bench
        self.record = record
        self.live: LiveSession = bench.hub.session(record.id)
        self.asset: display_tasks.OpenedAsset | None = None
        self.problem: str | None = None
        self.backend_away = False
        self.busy: dict[str, tuple[float, str]] = {}
        self.labels: npt.NDArray[np.int16] | None = None
        self.payloads: dict[str, list[display_tasks.PartPayload]] = {}
        self._labels_ref: str | None = None
        self._frame: tuple[Any, ...] | None = None
        self._jobs: dict[str, Job[Any]] = {}
        self._lock = threading.RLock()
        super().__init__()
        self.judging = Judging(self)
        self.live.subscribe(lambda state, command: self._state_changed())

    # --- state

    @property
    def state(self) -> SessionState:
        """The session's state."""
        return self.live.state

    @property
    def document(self) -> Document:
        """What is decided now."""
        return self.live.state.present

    def do(self, command: cmd.Command, who: str) -> SessionState:
        """Carry out one user decision; it is on disk when this returns."""
        return self.live.do(command, who)

    @property
    def segmenting(self) -> bool:
        """Whether the shown labels lag behind the prompts."""
        return "segment" in self._jobs

    @property
    def checks(self) -> list[JointCheck]:
        """The collisions that the gate found on the present joints."""
        return self.judging.checks

    @property
    def predicting(self) -> bool:
        """Whether a prediction is under way."""
        return "predict" in self._jobs

    def source(self, document: Document | None = None) -> PartSource:
        """The parts of the document as the workers cut them.

        Raises:
            CommandError: where nothing is segmented yet.
        """
        doc = document or self.document
        if self.asset is None or doc.segmentation is None:
            raise CommandError("no part is there yet: click on a part that moves")
        names = {p.id: p.name for p in doc.parts if p.name}
        return PartSource(
            self.asset.folder,
            self.bench.workspace,
            doc.segmentation.labels,
            names,
            doc.category,
            self.asset.name,
        )

    # --- opening

    def ensure_open(self) -> None:
        """Read the asset in the background unless it is read or being read."""
        with self._lock:
            doc = self.document
            frame = (doc.up_axis, doc.unit_scale, doc.left_out)
            if "open" in self._jobs or (self.asset is not None and self._frame == frame):
                return
            if self.problem is not None and self._frame == frame:
                return
            self._frame, self.problem = frame, None
            self.asset, self.labels, self._labels_ref = None, None, None
            self.payloads.clear()
            config = self.bench.config
            options = ReadOptions(
                doc.up_axis or config.up_axis,
                doc.unit_scale * config.unit_scale,
                None if doc.left_out is None else doc.left_out.elements,
            )
            job = self.bench.geometry.submit(
                display_tasks.open_asset,
                Path(self.record.path),
                self.bench.workspace,
                options,
                on_progress=self._progress("open"),
                priority=5,
            )
            self._start("open", job, self._opened)

    def _opened(self, asset: display_tasks.OpenedAsset) -> None:
        with self._lock:
            self.asset = asset
        if self.state.seq == 0:
            if asset.has_parts:
                self._take_source_parts(asset)
            if asset.category:
                self.do(cmd.SetCategory(asset.category), "source file")
        for warning in asset.warnings:
            self.tell("Opened with a remark", warning, "yellow")
        self.bench.geometry.submit(picking_tasks.prepare_picking, asset.folder)
        self.prepare()
        self._state_changed()

    def prepare(self) -> None:
        """Encode the asset for the segmenter before the first click needs it."""
        if self.asset is None or "encode" in self._jobs:
            return
        job = self.bench.segmentation.submit(
            segmenting_tasks.encode,
            self.asset.folder,
            self.bench.config.segmenter,
            on_progress=self._progress("encode"),
        )
        self._start("encode", job, lambda _: None)

    def _take_source_parts(self, asset: display_tasks.OpenedAsset) -> None:
        """Parts that the source file was cut into become regions, which the person can edit."""
        regions = self.bench.geometry.submit(
            segmenting_tasks.source_regions, asset.folder, self.bench.workspace
        ).result(120)
        for part, (ref, count) in regions.items():
            name = asset.part_names[part] if part < len(asset.part_names) else None
            if part:
                self.do(cmd.AddPart(part, name), "source file")
                self.do(cmd.AddRegion(part, ref, True, count, "source"), "source file")
            elif name:
                self.do(cmd.NamePart(0, name), "source file")

    # --- jobs that the state asks for

    def _state_changed(self) -> None:
        self.ensure_open()
        if self.asset is not None:
            self._ask_labels()
            self.judging.ask()
        self.bench.queue_changed(self.record.id)
        self.changed()

    def use_tool(self, request: tool_tasks.ToolRequest, who: str) -> int:
        """Let a segmentation tool work; the number of regions that came of it.

        Raises:
            CommandError: where the tool can't work on what there is.
        """
        asset, doc = self._opened_asset(), self.document
        replaces = _last_of(doc, request.tool, request.part) if request.tool == "next mask" else 0
        kept = stored_prompts(doc)[: len(doc.prompts) - replaces]
        offers = self.bench.segmentation.submit(
            tool_tasks.use_tool,
            asset.folder,
            self.bench.workspace,
            self.bench.config.segmenter,
            kept,
            request,
            priority=12,
        ).result(TOOL_SECONDS)
        if not offers and not replaces:
            return 0
        named = request.tool in ("same shape", "mirror")
        name = doc.part_names.get(request.part) if named else None
        used = {p.id for p in doc.parts}
        regions = []
        for offer in offers:
            part = offer.part
            if part == tool_tasks.NEW_PART:
                part = next(i for i in range(1, MAX_PARTS) if i not in used)
                used.add(part)
            regions.append(ToolRegion(part, offer.elements, offer.positive, offer.count, name))
        gone = (request.other,) if request.tool == "merge" and request.other else ()
        self.do(cmd.ApplyTool(request.tool, tuple(regions), replaces, gone), who)
        return len(offers)

    # --- rooms

    def leave_out(self, what: str, part: int, who: str) -> None:
        """Look no more at floor and walls ("floor and walls"), or at one part ("part")."""
        asset, doc = self._opened_asset(), self.document
        left_out = None if doc.left_out is None else doc.left_out.elements
        if what == "part":
            labels = self.source().labels
            arguments: tuple[Any, ...] = (labels, part, left_out)
            function: Callable[..., room_tasks.Removal] = room_tasks.leave_out_part
        else:
            function, arguments = room_tasks.floor_and_walls, (left_out,)
        job = self.bench.geometry.submit(
            function,
            asset.folder,
            self.bench.workspace,
            *arguments,
            on_progress=self._progress("room"),
            priority=6,
        )

        def keep(removal: room_tasks.Removal) -> None:
            name = doc.part_names.get(part, f"part {part}") if what == "part" else what
            self.do(cmd.LeaveOut(removal.elements, removal.count, name), who)

        self._start("room", job, keep)
        self.changed()

    def cut_out(self, part: int, who: str, done: Callable[[int], None]) -> None:
        """Make one part an object of its own in the queue; ``done`` gets its id."""
        asset, doc = self._opened_asset(), self.document
        name = f"{asset.name}_{doc.part_names.get(part) or f'part_{part}'}"

        def keep(crop: room_tasks.Crop) -> None:
            new = self.bench.add_paths([crop.path])[0]
            placed = cmd.Placed(str(asset.path), asset.sha256, crop.elements, crop.position)
            self.bench.hub.session(new).do(placed, who)
            out = cmd.CropOut(crop.name, str(crop.path), crop.elements, crop.count, crop.position)
            self.do(out, who)
            done(new)

        self._cut(room_tasks.cut_out, (), part, name, keep)

    def pick_out(
        self, copy: Path, part: int, name: str, keep: Callable[[room_tasks.Picked], None]
    ) -> None:
        """Write one part, and all but it, for the scene around; ``keep`` gets both.

        Args:
            copy: what is open here, in the scene's workspace.
        """
        self._cut(room_tasks.pick_out, (copy,), part, name, keep)

    def _cut(
        self,
        function: Callable[..., Any],
        first: tuple[Any, ...],
        part: int,
        name: str,
        keep: Callable[[Any], None],
    ) -> None:
        asset, doc = self._opened_asset(), self.document
        if not doc.segmentation_current:
            raise CommandError("the parts are still being computed; try again in a moment")
        job = self.bench.geometry.submit(
            function,
            *first,
            asset.folder,
            self.bench.workspace,
            self.source(doc).labels,
            part,
            None if doc.left_out is None else doc.left_out.elements,
            name,
            on_progress=self._progress("room"),
            priority=6,
        )
        self._start("room", job, keep)
        self.changed()

    def _opened_asset(self) -> display_tasks.OpenedAsset:
        if self.asset is None:
            raise CommandError("the object is still being read")
        return self.asset

    def _ask_labels(self) -> None:
        doc, asset = self.document, self.asset
        assert asset is not None
        key = doc.key
        record = doc.segmentation
        if needed_jobs(self.state):
            job = self.bench.segmentation.submit(
                segmenting_tasks.segment,
                asset.folder,
                self.bench.workspace,
                self.bench.config.segmenter,
                stored_prompts(doc),
                key,
                asset.element,
                on_progress=self._progress("segment"),
                priority=10,
                key=("segment", self.record.id),
            )
            self._start("segment", job, self._segmented)
            return
        ref = record.labels if record is not None and doc.prompts else None
        with self._lock:
            if ref == self._labels_ref and (ref is None) == (self.labels is None):
                return
            if ref is None:
                self.labels, self._labels_ref = None, None
                return
        job = self.bench.segmentation.submit(
            segmenting_tasks.display_labels, self.bench.workspace, ref, asset.element, priority=9
        )
        self._start("labels", job, lambda labels: self._show_labels(ref, labels))

    def _segmented(self, answer: segmenting_tasks.SegmentationAnswer) -> None:
        self._show_labels(answer.labels, answer.display_labels)
        self.do(
            cmd.RecordSegmentation(
                answer.prompts_key, answer.labels, answer.segmenter, answer.seconds, answer.counts
            ),
            "segmenter",
        )

    def _show_labels(self, ref: str, labels: npt.NDArray[np.int16]) -> None:
        with self._lock:
            self._labels_ref, self.labels = ref, labels

    def start_gate(self, tree: KinematicTree, keep: Callable[[GateReport], None]) -> None:
        """Judge the joints of ``tree`` in the background."""
        job = self.bench.prediction.submit(
            judging_tasks.judge_joints,
            self.source(),
            tree,
            on_progress=self._progress("check"),
            key=("check", self.record.id),
        )
        self._start("check", job, keep)

    def part_payloads(self) -> list[display_tasks.PartPayload] | None:
        """The parts as drawn while joints move; None until they are cut (asks for it)."""
        doc = self.document
        if self.asset is None or doc.segmentation is None:
            return None
        ref = doc.segmentation.labels
        if ref not in self.payloads and "parts" not in self._jobs:
            job = self.bench.geometry.submit(
                display_tasks.part_payloads, self.source(doc), self.asset.element, priority=3
            )

            def keep(payloads: list[display_tasks.PartPayload]) -> None:
                self.payloads = {ref: payloads}

            self._start("parts", job, keep)
        return self.payloads.get(ref)

    # --- jobs that a person asks for

    def predict(self, who: str, *, here: bool = False) -> None:
        """Predict joints from the parts; the answer becomes a command.

        Args:
            who: decides it.
            here: with the predictor of this machine, whatever backend is set.
        """
        if self.predicting:
            return
        source, doc = self.source(), self.document
        if not doc.segmentation_current:
            raise CommandError("the parts are still being computed; predict in a moment")
        self.cancel("check")
        self.judging.forget_request()
        job = self.bench.prediction.submit(
            part_tasks.predict,
            source,
            DEFAULT_PREDICTOR if here else self.bench.config.predictor,
            doc.locked_joints,
            0,
            on_progress=self._progress("predict"),
            priority=10,
        )

        def keep(prediction: Any) -> None:
            self.backend_away = self.backend_away and here
            if prediction.tree is None:
                problems = "; ".join(prediction.problems) or "the predictor gave no reason"
                self.tell("No prediction", problems, "red")
                return
            self.do(cmd.RecordPrediction(prediction, source.labels), who)
            count = sum(j.moves for j in prediction.tree.joints)
            self.tell(
                "Predicted", f"{count} joint{'s'[: count != 1]} in {prediction.seconds:.1f} s"
            )

        self._start("predict", job, keep)
        self.changed()

    def cancel(self, what: str) -> None:
        """Stop a running job ("predict", "save", "segment")."""
        job = self._jobs.get(what)
        if job is not None:
            job.cancel()

    def accept(self, comment: str, who: str, at: str, override: str = "") -> None:
        """Write the asset, read it back, and only then record the decision.

        Args:
            override: why it is right although the gate calls a joint broken.

        Raises:
            CommandError: where something is missing, or the gate needs a reason.
        """
        if "save" in self._jobs:
            return
        state = self.state
        doc = state.present
        problems = acceptance_problems(doc)
        if problems:
            raise CommandError("; ".join(problems))
        assert doc.tree is not None
        if not self.judging.admits(comment, who, at, override):
            return
        gate = self.judging.report
        command = cmd.Accept(comment, self.judging.doubts(), override)
        after = apply(state, command, Context(who, at))
        record = acceptance_record(
            after, self.bench.store.history(self.record.id), self._source_record(), gate, override
        )
        folder = asset_folder(self.bench.workspace, self.record)
        job = self.bench.save_asset(
            self.source(doc), doc.tree, folder, record, self._progress("save")
        )

        def keep(written: str) -> None:
            now = self.document
            if now.tree != doc.tree or now.segmentation != doc.segmentation:
                self.tell("Not accepted", "It was edited meanwhile: accept it again", "yellow")
                return
            self.do(command, who)
            self.do(cmd.Saved(written), who)
            self.tell("Accepted", f"Saved in {written}", "green")

        self._start("save", job, keep)
        self.changed()

    def _source_record(self) -> Source:
        asset = self.asset
        assert asset is not None
        return Source(asset.path, asset.sha256, asset.up_axis, asset.unit_scale)

    # --- the life of a job

    def _progress(self, what: str) -> Callable[[float, str], None]:
        def tell(fraction: float, message: str) -> None:
            if what in self._jobs:
                self.busy[what] = (fraction, message)
                self.changed()

        return tell

    def _start(self, what: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        self._jobs[what] = job
        self.busy[what] = (0.0, "")
        job.add_done_callback(lambda ended: self._ended(what, ended, keep))

    def _ended(self, what: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        newest = self._jobs.get(what) is job
        if newest:
            del self._jobs[what]
            self.busy.pop(what, None)
        try:
            keep(job.result(0))
        except Cancelled:
            if what in ("predict", "save"):
                self.tell("Cancelled", "Nothing was changed", "gray")
        except BackendError as error:
            self.backend_away = True
            self._failed(what, f"{error}: press “Predict on this machine”")
        except ArtiworldError as error:
            self._failed(what, str(error))
        except Exception as error:  # a job's boundary: say it and go on
            log.exception("job %s of object %s failed", what, self.record.id)
            self._failed(what, f"{error} (our fault; the details are in the server's log)")
        if newest and what in ("labels", "predict"):
            self._state_changed()
        else:
            self.changed()

    def _failed(self, what: str, message: str) -> None:
        if what == "check":
            self.judging.failed(message)
        if what == "open":
            self.problem = message
        self.tell({"open": "Can't open this file"}.get(what, "That didn't work"), message, "red")


def acceptance_record(
    after: SessionState,
    history: list[Entry],
    source: Source,
    gate: GateReport | None,
    override: str = "",
) -> dict[str, Any]:
    """What ``provenance.json`` of an accepted asset holds, the gate's answer included."""
    record = provenance(after, history, source)
    record["gate"] = None if gate is None else {**gate.to_json(), "override": override}
    return record


def asset_folder(workspace: Path, record: ObjectRecord) -> Path:
    """Where the accepted asset of an object goes."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", record.name).strip("._") or "object"
    return workspace / "assets" / f"{plain[:60]}-{record.id}"


def _last_of(doc: Document, tool: str, part: int) -> int:
    """How many prompts at the end ``tool`` gave to ``part``, so that it can say something else."""
    count = 0
    for prompt in reversed(doc.prompts):
        if isinstance(prompt, Click) or (prompt.tool, prompt.part) != (tool, part):
            break
        count += 1
    return count


def stored_prompts(doc: Document) -> tuple[Click | segmenting_tasks.StoredRegion, ...]:
    """The prompts as workers take them."""
    return tuple(
        p if isinstance(p, Click) else segmenting_tasks.StoredRegion(p.part, p.elements, p.positive)
        for p in doc.prompts
    )
