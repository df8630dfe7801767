"""Preparing one open object: what is proposed, what is noticed, and the decisions; leaving out
parts of it, and cutting objects out of it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server import display_tasks, prepare_tasks, segmenting_tasks
from app.server.display_tasks import OpenedAsset
from app.server.jobs import CLICKS, Job, WorkerProcess
from app.server.object_context import ObjectContext
from app.server.prepare_tasks import Crop, Marks, Removal, ScanProposal, Vector
from model.core.errors import CommandError
from model.geometry.cleaning import CLUTTER, OBJECT, OUTLIER, SUPPORT
from model.geometry.levelling import SURE
from model.geometry.picking import Camera, Stroke
from model.geometry.units import UNITS, odd_size
from model.io.geometry_files import declares_up
from sessions import commands as cmd
from sessions.document import SOURCE_FRAME, Document, ObjectFrame
from sessions.state import Context
from sessions.tool_commands import LeaveOut

Array = npt.NDArray[np.float64]

CLUTTERING = (SUPPORT, CLUTTER, OUTLIER)
"""Kinds of elements that aren't the object."""
LEAST_TILT = np.radians(0.5)
"""Tilt of a supported scan from which it is levelled, too, when its support is removed."""
TILT = np.radians(3.0)
"""Tilt that is noticed; registration drifts by a degree or two."""
_VERY_SURE = 0.9
"""Confidence from which a scan that lies along an axis is called tilted; chosen as ``SURE``."""
_LEAST_OBJECT, _LEAST_SUPPORT = 0.15, 0.05
"""Shares of the scan: a door that lies on nothing has a handle on a large "table"."""
_MANY_OUTLIERS = 0.03
"""Share of the scan; a few are in each."""
UPRIGHT: Vector = (0.0, 0.0, 1.0)


def untouched(doc: Document) -> bool:
    """True if an object has no decisions that preparing it would discard."""
    return not doc.prompts and doc.tree is None and doc.placement is None


def odd_unit(asset: OpenedAsset) -> float | None:
    """Metres per unit of the file that its size speaks for; None where it isn't odd."""
    odd = odd_size(asset.bounds, asset.source.unit_scale)
    return None if odd is None or odd.unit is None else UNITS[odd.unit]


class Preparing:
    """Proposes how to level and clean an object, and carries the decisions out.

    Attributes:
        proposal: of the present asset, or None until it is made.
    """

    def __init__(self, obj: ObjectContext) -> None:
        self.proposal: ScanProposal | None = None
        self._obj = obj
        self._asset: OpenedAsset | None = None
        self._ups: list[Vector] = []
        self._ahead: Job[Any] | None = None

    @property
    def current(self) -> ScanProposal | None:
        """The proposal, unless the object was read again since."""
        return self.proposal if self._asset is self._obj.asset is not None else None

    def propose(self, up: Vector | None = None, *, anew: bool = False, priority: int = 4) -> None:
        """Make a proposal for the present asset, unless it is there or being made.

        Args:
            up: the up direction; by default it is found, or +z where a person levelled it.
            anew: discard the present one.
        """
        obj = self._obj
        asset = obj.asset
        if asset is None or (self._asset is asset and not anew):
            return
        if up is None and not anew and obj.document.frame.wxyz != SOURCE_FRAME.wxyz:
            up = UPRIGHT
        obj.jobs.cancel("prepare")
        self.forget()
        self._asset, self.proposal = asset, None
        job = obj.lane.geometry.submit(
            prepare_tasks.propose,
            asset.folder,
            asset.element,
            up,
            on_progress=obj.jobs.progress("prepare"),
            priority=priority,
            preempted_by=CLICKS,
        )

        def keep(proposal: ScanProposal) -> None:
            if self._asset is asset:
                self.proposal = proposal
                if up is None:
                    level = proposal.levelling
                    self._ups = [level.up, *level.alternatives]
                if self.tilt:  # it will be read in another frame
                    obj.jobs.cancel("encode")
                self._look_ahead(proposal)

        obj.start("prepare", job, keep)

    def propose_for_step(self) -> None:
        """Make the proposal that the prepare step shows."""
        found = self.current
        if found is None:
            self.propose()
        elif self._rejected:  # what stands around is found as it lies
            self.propose(UPRIGHT, anew=True)

    def frame(self, removed: tuple[int, ...] = ()) -> Array | None:
        """(4, 4) the frame that is offered, in the present one; None where the object stands.

        Args:
            removed: kinds of elements that go at the same time.
        """
        found = self.current
        if found is None:
            return None
        level = found.levelling
        drifted = level.support is not None and level.tilt > LEAST_TILT and SUPPORT in removed
        turned = found.up not in (None, UPRIGHT) or self.tilt or self.doubtful
        return found.object_from_asset if turned or drifted else None

    def _look_ahead(self, found: ScanProposal) -> None:
        """Read and encode the object as Apply will most likely give it."""
        obj, asset = self._obj, self._obj.asset
        doc = obj.document
        raw = untouched(doc) and doc.left_out is None and not doc.face_cuts
        if asset is None or not raw or not (self.noticed() or self.frame() is not None):
            return
        kinds = tuple(kind for kind in CLUTTERING if found.counts[kind])
        frame, metres, lanes = self.frame(kinds), odd_unit(asset), obj.services.workers.lanes
        matrix = np.eye(4) if frame is None else frame

        def encode(job: Job[Any]) -> None:
            if job.error is None and self._ahead is job:
                lane = lanes.reserve(obj, heavy=job.result().heavy)
                self._ahead = lane.segmentation.submit(
                    segmenting_tasks.encode,
                    job.result().folder,
                    obj.services.config.segmenter,
                    priority=-1,
                    preempted_by=CLICKS,
                    works_on=job.result().folder,
                )

        def read(job: Job[Removal]) -> None:
            if job.error is not None or self._ahead is not job:
                return
            left = LeaveOut(job.result().elements, job.result().count, "")
            after = self._command(matrix, left, "", metres).edit(obj.document, Context("", ""))
            self._ahead = obj.services.workers.read(
                display_tasks.open_asset,
                Path(obj.record.path),
                obj.services.workspace,
                obj.read_options(after),
                priority=-1,
            )
            self._ahead.add_done_callback(encode)

        self._ahead = obj.lane.geometry.submit(
            prepare_tasks.marked_elements,
            obj.services.workspace,
            None,
            asset.folder,
            found.up,
            Marks(kinds),
            priority=-1,
            preempted_by=CLICKS,
        )
        self._ahead.add_done_callback(read)

    def forget(self) -> None:
        """Stop working ahead."""
        ahead, self._ahead = self._ahead, None
        if ahead is not None:
            ahead.cancel()

    def next_up(self, step: int) -> None:
        """Propose the next likely up direction, or with -1 the one before."""
        found = self.current
        if found is None or len(self._ups) < 2:
            return
        now = found.up or found.levelling.up
        near = int(np.argmax(np.array(self._ups) @ now))
        self.propose(self._ups[(near + step) % len(self._ups)], anew=True)

    # --- what is noticed

    @property
    def tilt(self) -> float:
        """Radians by which the scan seems to be tilted; 0 where it may well be upright."""
        found, asset = self.current, self._obj.asset
        if found is None or asset is None or found.up is not None:
            return 0.0
        level = found.levelling
        if level.tilt < TILT:
            return 0.0
        supported = level.support is not None and self._share(OBJECT) > _LEAST_OBJECT
        if level.askew:  # slanted lamps are, too: a format that declares its axis is trusted more
            sure = level.confidence >= SURE and (supported or not declares_up(asset.source.path))
        else:
            sure = level.confidence >= _VERY_SURE and supported and self._along_an_axis
        return level.tilt if sure else 0.0

    @property
    def _along_an_axis(self) -> bool:
        """True if another axis of the file seems to be up, and its format doesn't declare one."""
        found, asset = self.current, self._obj.asset
        if found is None or asset is None or declares_up(asset.source.path):
            return False
        _, y, z = found.levelling.up
        return max(abs(y), -z) > np.cos(TILT)

    @property
    def doubtful(self) -> bool:
        """True if the scan doesn't seem upright, but its up direction is uncertain."""
        found, asset = self.current, self._obj.asset
        if found is None or asset is None or found.up is not None or self.tilt:
            return False
        if found.levelling.tilt < TILT:
            return False
        level = found.levelling
        on_axis = level.confidence >= SURE and self._along_an_axis
        return level.askew or on_axis or level.lies(declares_up(asset.source.path))

    @property
    def _rejected(self) -> bool:
        """True if the scan may be upright, although another direction was found."""
        found = self.current
        if found is None or found.up is not None or found.levelling.tilt < TILT:
            return False
        return not (self.tilt or self.doubtful)

    def noticed(self) -> dict[int, int]:
        """Kind → number of elements that don't belong to the object, where they are many."""
        found = self.current
        asset = self._obj.asset
        if found is None or asset is None or self._rejected:
            return {}
        many = _MANY_OUTLIERS if asset.element_kind == "point" else 1.0  # meshes have loose faces
        least = {SUPPORT: _LEAST_SUPPORT, CLUTTER: 0.0, OUTLIER: many}
        return {k: found.counts[k] for k, share in least.items() if self._share(k) > share}

    def _share(self, kind: int) -> float:
        found = self.current
        return 0.0 if found is None else found.counts[kind] / max(sum(found.counts), 1)

    # --- decisions

    def turn(self, matrix: Array, what: str, who: str) -> None:
        """Move the object by a (4, 4) rotation, uniform scale and shift in its present frame; where
        that only scales it, parts and joints stay."""
        self._obj.do(self._command(matrix, None, what), who)

    def set_unit(self, metres: float, what: str, who: str) -> None:
        """Read the file with another unit."""
        self._obj.do(self._command(np.eye(4), None, what, metres), who)

    def apply(
        self,
        matrix: Array,
        marks: Marks,
        what: str,
        who: str,
        done: Callable[[], None],
        *,
        metres: float | None = None,
    ) -> None:
        """Move the object, leave out what is marked and set the unit as one step; then ``done``.

        Args:
            matrix: (4, 4) rotation, uniform scale and shift in the object's present frame.
            metres: per unit of the file, or None.
        """
        obj, found = self._obj, self.current
        asset = obj.need_asset()
        if found is None or marks == Marks():
            obj.do(self._command(matrix, None, what, metres), who)
            done()
            return

        def keep(removal: Removal) -> None:
            leave_out = LeaveOut(removal.elements, removal.count, what)
            obj.do(self._command(matrix, leave_out, what, metres), who)
            done()

        # The process that made the proposal has it still.
        task, worker = prepare_tasks.marked_elements, obj.lane.geometry
        _start(obj, keep, task, asset.folder, found.up, marks, worker=worker)

    def _command(
        self, matrix: Array, leave_out: LeaveOut | None, what: str, metres: float | None = None
    ) -> cmd.Prepare:
        doc = self._obj.document
        left, metres = doc.left_out, metres or doc.unit_scale
        resizes = leave_out is None and np.array_equal(matrix, np.diag([matrix[0, 0]] * 3 + [1]))
        if leave_out is None and left is not None:
            leave_out = LeaveOut(left.elements, left.count, left.what)
        ratio = metres / doc.unit_scale
        x, y, z = (ratio * v for v in doc.frame.position)
        moved = matrix.copy()
        moved[:3, 3] *= ratio
        frame = ObjectFrame((x, y, z), doc.frame.wxyz, doc.frame.scale).then(moved)
        return cmd.Prepare(metres, frame, leave_out or LeaveOut(None), what, resizes)

    def remove(self, chosen: str, what: str, who: str) -> None:
        """Leave out stored elements of the present asset."""
        _leave_out(self._obj, what, who, prepare_tasks.chosen_elements, chosen)

    def restore(self, camera: Camera, stroke: Stroke | tuple[Any, Any], who: str) -> None:
        """Bring back what a stroke or a box covers of what is left out."""
        obj, left = self._obj, self._obj.document.left_out
        asset = obj.need_asset()
        if left is None:
            raise CommandError("nothing was removed")

        def keep(removal: Removal | None) -> None:
            command = cmd.LeaveOut(None)
            if removal is not None:
                command = cmd.LeaveOut(removal.elements, removal.count, left.what)
            obj.do(command, who)

        task, options = prepare_tasks.restored_elements, obj.read_options(obj.document)
        _start(obj, keep, task, asset.source.path, options, camera, stroke)


def leave_out(obj: ObjectContext, part: int | None, who: str) -> None:
    """Leave out one part, or where that is None the floor and the walls."""
    if part is None:
        _leave_out(obj, "floor and walls", who, prepare_tasks.floor_and_walls)
    else:
        name, labels = obj.document.part_names.get(part, f"part {part}"), obj.source().labels
        _leave_out(obj, name, who, prepare_tasks.leave_out_part, labels, part)


def _leave_out(
    obj: ObjectContext, what: str, who: str, task: Callable[..., Removal], *arguments: Any
) -> None:
    def keep(removal: Removal) -> None:
        obj.do(cmd.LeaveOut(removal.elements, removal.count, what), who)

    _start(obj, keep, task, obj.need_asset().folder, *arguments)


def cut_out(obj: ObjectContext, part: int, who: str, done: Callable[[int], None]) -> None:
    """Make one part an object of its own in the queue; ``done`` gets its id."""
    asset = obj.need_asset()
    source = asset.source

    def keep(crop: Crop) -> None:
        new = obj.services.queue.add([crop.path])[0]
        placed = cmd.Placed(str(source.path), source.sha256, crop.elements, crop.position)
        obj.services.hub.session(new).do(placed, who)
        out = cmd.CropOut(crop.name, str(crop.path), crop.elements, crop.count, crop.position)
        obj.do(out, who)
        done(new)

    name = obj.document.part_names.get(part) or f"part_{part}"
    pick_out(obj, part, f"{asset.name}_{name}", None, keep)


def pick_out(
    obj: ObjectContext, part: int, name: str, copy: Path | None, keep: Callable[[Crop], None]
) -> None:
    """Write one part as an object of its own.

    Args:
        copy: folder of the working copy that is open, to write its rest, too.
        keep: gets the object.
    """
    folder, doc = obj.need_asset().folder, obj.document
    if not doc.segmentation_current:
        raise CommandError("the parts are still being computed; try again in a moment")
    _start(obj, keep, prepare_tasks.cut_out, folder, obj.source(doc).labels, part, name, copy)


def _start(
    obj: ObjectContext,
    keep: Callable[[Any], None],
    task: Callable[..., Any],
    *arguments: Any,
    worker: WorkerProcess | None = None,
) -> None:
    """Start a task about elements of the file, what is left out among them."""
    left = obj.document.left_out
    if obj.document.face_cuts:
        raise CommandError("faces were split by a cut: undo it first, then cut again")
    job = (worker or obj.services.workers.reading).submit(
        task,
        obj.services.workspace,
        None if left is None else left.elements,
        *arguments,
        on_progress=obj.jobs.progress("room"),
        priority=6,
        preempted_by=CLICKS,
    )
    obj.start("room", job, keep)
    obj.changed()
