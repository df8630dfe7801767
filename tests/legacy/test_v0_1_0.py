"""Everything that version 0.1.0 saved still opens, and its command line is still accepted.

``v0.1.0`` holds a workspace and other folders that version 0.1.0 wrote, what it read from them, and
its command-line options; see the README there. Later versions may add fields and options, and may
change texts for people; what was there must stay.
"""

import contextlib
import inspect
import io
import json
import os
import sqlite3
import tarfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli.main import parse
from app.cli.predict import predicted_confidence
from app.server import display_tasks, part_tasks, scene_tasks, segmenting_tasks, workers
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.job import Job
from app.server.prompt_file import PromptFile, read_prompts
from model.core import codec
from model.core.articulated_object import ArticulatedObject, Part
from model.io.assets.reader import load_object, read_provenance, reload_check
from model.io.export.manifest import declared_category
from model.io.open_asset import open_asset, read_part_files
from model.io.urdf.model import load_declared
from model.scenes.registry import read_scene
from model.scenes.scene import Scene
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.document import Document, acceptance_problems, review_problems
from sessions.provenance import provenance
from sessions.serialise import state_from_json, state_to_json
from sessions.state import Context, SessionState, replay
from sessions.store import Store
from tests.builders import wait_until

HERE = Path(__file__).parent / "v0.1.0"
ORIGINAL_ROOT = "/srv/"
"""Folder of the scans and the workspace when they were written."""
TOLERANCE = 1e-6
"""In metres, radians, square metres and kilograms."""

Json = dict[str, Any]


# --- comparing ---------------------------------------------------------------------------------


def assert_includes(found: Any, expected: Any, where: str = "") -> None:
    """Check that ``found`` has all values of ``expected``; mappings may have further keys."""
    if isinstance(expected, Mapping):
        assert isinstance(found, Mapping), f"{where}: {found!r} instead of {expected!r}"
        for key, value in expected.items():
            assert key in found, f"{where}.{key} is missing"
            assert_includes(found[key], value, f"{where}.{key}")
    elif isinstance(expected, list):
        assert isinstance(found, list | tuple), f"{where}: {found!r} instead of {expected!r}"
        assert len(found) == len(expected), f"{where}: {found!r} instead of {expected!r}"
        for i, value in enumerate(expected):
            assert_includes(found[i], value, f"{where}[{i}]")
    elif isinstance(expected, float) and isinstance(found, float):
        assert found == pytest.approx(expected, abs=TOLERANCE, rel=TOLERANCE), where
    else:
        assert type(found) is type(expected) and found == expected, (
            f"{where}: {found!r} instead of {expected!r}"
        )


def session_summary(state: SessionState) -> Json:
    """Summarise a session: the present document and what the screens derive from it."""
    doc = state.present
    same = "key segmentation_current prediction_stale next_part joints_file"
    return {
        **{name: getattr(doc, name) for name in same.split()},
        **{"seq": state.seq, "past": len(state.past), "future": len(state.future)},
        "document": codec.write(replace(doc, label=""), "document"),
        "edited_joints": list(doc.edited_joints),
        "predicted_confidence": dict(doc.predicted_confidence),
        "review_problems": len(review_problems(doc)),
        "acceptance_problems": len(acceptance_problems(doc)),
    }


def without_labels(state: SessionState) -> SessionState:
    """Return the state without the texts that name its steps."""

    def plain(documents: Sequence[Document]) -> tuple[Document, ...]:
        return tuple(replace(d, label="") for d in documents)

    return SessionState(*plain([state.present]), plain(state.past), plain(state.future), state.seq)


def provenance_summary(store: Store, number: int) -> Json:
    """Return what ``provenance.json`` would say now, without package versions and texts."""
    found = provenance(store.load(number), store.history(number), None)
    del found["versions"]
    found["edits"] = [{k: v for k, v in e.items() if k != "what"} for e in found["edits"]]
    return found


def part_summary(part: Part) -> Json:
    """Summarise a part and its geometry in a few numbers."""
    mesh, cloud = part.mesh, part.cloud
    out: Json = {"link": part.link, "name": part.name, "remarks": len(part.remarks)}
    if mesh is not None:
        images = [m.texture for m in mesh.materials if m.texture is not None]
        out |= {
            "faces": len(mesh.faces),
            "area": float(mesh.face_areas.sum()),
            "bounds": mesh.bounds.tolist(),
            "middle": mesh.triangles.mean(axis=(0, 1)).tolist(),
            "colors": sorted({m.base_color for m in mesh.materials}),
            "images": sorted([*i.size, float(np.asarray(i.convert("RGB")).mean())] for i in images),
            "maps": sorted(len(m.maps.images) for m in mesh.materials),
        }
    if cloud is not None:
        out |= {
            "points": len(cloud),
            "cloud_bounds": cloud.bounds.tolist(),
            "cloud_colors": None if cloud.colors is None else float(cloud.colors.mean()),
        }
    return json.loads(json.dumps(out))


def object_summary(obj: ArticulatedObject) -> Json:
    """Summarise an articulated object: its tree, its parts and its declared physics."""
    return {
        "name": obj.name,
        "category": obj.category,
        "tree": codec.write(obj.tree, "tree"),
        "parts": [part_summary(p) for p in obj.parts],
        **physics_summary(obj.inertials, obj.shapes),
    }


def physics_summary(inertials: Mapping[str, Any], shapes: Mapping[str, Any]) -> Json:
    """Summarise masses with their centres, and collision shapes with their places."""
    return {
        "masses": {k: [i.mass, *i.center] for k, i in sorted(inertials.items())},
        "shapes": {
            k: [
                [s.kind, [float(v) for v in s.sizes], s.object_from_shape[:3, 3].tolist()]
                for s in link
            ]
            for k, link in sorted(shapes.items())
        },
    }


def scene_summary(scene: Scene) -> Json:
    """Summarise a scene's objects and problems."""
    same = ("id", "description", "category", "room", "asset", "anchor", "static", "obstacle")
    return {
        "name": scene.name,
        "reader": scene.reader,
        "problems": [[p.object, p.skipped] for p in scene.problems],
        "objects": [
            {
                **{field: getattr(o, field) for field in (*same, "base", "solid")},
                "world_from_object": o.world_from_object.tolist(),
                "scale": o.scale.tolist(),
                "box": None if o.box is None else [float(v) for v in o.box],
            }
            for o in scene.objects
        ],
    }


def prompts_summary(file: PromptFile) -> Json:
    """Summarise a prompt file."""
    prompts = [
        codec.write(p, "click")
        if isinstance(p, Click)
        else {"part": p.part, "positive": p.positive, "elements": p.elements.tolist()}
        for p in file.prompts.items
    ]
    names = {str(k): v for k, v in file.names.items()}
    return {"category": file.category, "names": names, "prompts": prompts}


def opened_summary(obj: Any) -> Json:
    """Summarise an object that is open in the application."""
    asset, labels = obj.asset, obj.labels
    ids, counts = np.unique([] if labels is None else labels, return_counts=True)
    return {
        **{name: getattr(asset.source, name) for name in ("up_axis", "unit_scale", "sha256")},
        **{"name": asset.name, "kind": asset.element_kind, "elements": asset.element_count},
        "bounds": np.asarray(asset.bounds).tolist(),
        "part_names": list(asset.part_names),
        "warnings": len(asset.warnings),
        "labels": {str(int(i)): int(n) for i, n in zip(ids, counts, strict=True)},
    }


# --- the saved files ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def expected() -> Json:
    return json.loads((HERE / "expected.json").read_text(encoding="utf-8"))


def unpack(folder: Path, expected: Json) -> Path:
    """Unpack the saved files into ``folder``, and let the database find its sources there."""
    with tarfile.open(HERE / "saved.tar.xz") as packed:
        packed.extractall(folder, filter="data")
    for name, nanoseconds in expected["modified"].items():
        os.utime(folder / name, ns=(nanoseconds, nanoseconds))
    with database_of(folder) as database:
        database.execute(
            "UPDATE objects SET path = replace(path, ?, ?)", (ORIGINAL_ROOT, f"{folder}/")
        )
        database.commit()
    return folder


def database_of(root: Path) -> contextlib.closing[sqlite3.Connection]:
    return contextlib.closing(sqlite3.connect(root / "workspace" / "artiworld.db"))


@pytest.fixture
def root(tmp_path: Path, expected: Json) -> Path:
    return unpack(tmp_path, expected)


@pytest.fixture(scope="module")
def read_only(tmp_path_factory: pytest.TempPathFactory, expected: Json) -> Path:
    """One copy for all tests that change nothing."""
    return unpack(tmp_path_factory.mktemp("saved"), expected)


@pytest.fixture(scope="module")
def store(read_only: Path) -> Iterator[Store]:
    opened = Store(read_only / "workspace")
    yield opened
    opened.close()


# --- sessions ----------------------------------------------------------------------------------


def test_the_fixture_holds_every_kind_of_command(store: Store, expected: Json) -> None:
    found = {e.kind for record in store.objects() for e in store.history(record.id)}
    assert sorted(found) == expected["kinds"] and found <= set(cmd.KINDS)


def test_commands_are_written_as_they_were_read(read_only: Path) -> None:
    with database_of(read_only) as database:
        rows = database.execute("SELECT object_id, seq, kind, payload FROM commands").fetchall()
    assert len(rows) > 200
    for number, seq, kind, payload in rows:
        data = json.loads(payload)
        command = cmd.from_json(data)
        assert command.kind == kind
        written = cmd.to_json(command)
        assert_includes(written, data, f"object {number}, command {seq}")
        assert cmd.from_json(written) == command


@pytest.mark.parametrize("snapshots", [True, False], ids=["snapshots", "commands alone"])
def test_sessions_replay_to_the_same_states(root: Path, expected: Json, snapshots: bool) -> None:
    if not snapshots:
        with database_of(root) as database:
            assert database.execute("DELETE FROM snapshots").rowcount > 1
            database.commit()
    store = Store(root / "workspace")
    assert {str(r.id) for r in store.objects()} == set(expected["sessions"])
    for number, session in expected["sessions"].items():
        state = store.load(int(number))
        assert_includes(session_summary(state), session, f"session {number}")
        written = state_from_json(expected["states"][number])
        assert without_labels(state) == without_labels(written)
        assert state_from_json(state_to_json(state)) == state
        steps = [(e.seq, e.command, Context(e.who, e.at)) for e in store.history(int(number))]
        assert without_labels(replay(steps)) == without_labels(state)
    store.close()


def test_records_and_provenance_are_the_same(read_only: Path, store: Store, expected: Json) -> None:
    for record in store.objects():
        fields_then = expected["records"][str(record.id)]
        found = codec.write({f: getattr(record, f) for f in fields_then if f != "path"})
        found["path"] = str(record.path.relative_to(read_only))
        assert_includes(found, fields_then, f"record {record.id}")
        then = expected["provenance"][str(record.id)]
        assert_includes(provenance_summary(store, record.id), then, f"provenance {record.id}")


def test_arrays_are_readable(read_only: Path, store: Store) -> None:
    refs = [p.stem for p in (read_only / "workspace" / "arrays").glob("*/*.array")]
    assert len(refs) > 30
    for ref in refs:
        assert store.put_array(store.get_array(ref)) == ref


def test_a_session_can_be_continued(root: Path, expected: Json) -> None:
    store = Store(root / "workspace")
    rejected = next(int(k) for k, v in expected["records"].items() if v["state"] == "rejected")
    before = seq = store.object(rejected).seq
    for command in (cmd.Reopen("Again."), cmd.NamePart(1, "flap"), cmd.Undo(), cmd.Undo()):
        seq = store.append(rejected, command, "eve", seq)
    assert seq == before + 4 and store.object(rejected).state == "rejected"
    store.close()


# --- the application ---------------------------------------------------------------------------

RUN = {
    display_tasks.open_asset,
    segmenting_tasks.display_labels,
    scene_tasks.read,
    scene_tasks.shapes,
    scene_tasks.drawn_parts,
}
"""Jobs that the screens need to show a saved workspace."""
MUST_NOT_RUN = {segmenting_tasks.segment, part_tasks.predict, scene_tasks.prepare}
"""Jobs whose results would replace saved decisions."""


class InlineWorker:
    """Replaces a worker process: runs the jobs of ``RUN`` at once, leaves others in the queue."""

    submitted: set[Callable[..., Any]]
    busy = False

    def __init__(self, name: str, **_: Any) -> None:
        self.name = name

    def submit(
        self,
        function: Callable[..., Any],
        *args: Any,
        on_progress: Callable[[float, str], object] | None = None,
        key: Any = None,
        **settings: Any,
    ) -> Job[Any]:
        call = (function, args, settings)
        job: Job[Any] = Job(lambda j: j.end("cancelled"), 0, self.name, call, on_progress, key)
        self.submitted.add(function)
        if function in RUN:
            parameters = inspect.signature(function).parameters
            try:
                own = {k: v for k, v in settings.items() if k in parameters}
                job.end("done", function(*args, **own))
            except Exception as error:
                job.end("failed", error=error)
        return job

    def begin_to_close(self) -> None: ...

    def adopt(self, job: Job[Any]) -> None: ...

    def rest(self, rests: bool) -> None: ...

    def close(self) -> None: ...


@pytest.fixture
def start_app(root: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., AppState]]:
    started: list[AppState] = []
    monkeypatch.setattr(workers, "WorkerProcess", InlineWorker)
    monkeypatch.setattr(InlineWorker, "submitted", set(), raising=False)

    def start(paths: Sequence[Path], **settings: Any) -> AppState:
        config = ServeConfig(workspace=root / "workspace", **settings)
        started.append(AppState(config, Store(root / "workspace"), list(paths)))
        return started[-1]

    yield start
    for app in started:
        app.close()
        app.store.close()


def test_the_queue_shows_the_same_states(start_app, root: Path, expected: Json) -> None:
    queue = expected["queue"]
    app = start_app([root / name for name in queue["paths"]])
    # Those that were decided before come after those that were given.
    records = app.queue.records()[: len(queue["states"])]
    assert [[r.id, r.state] for r in records] == queue["states"]
    assert list(app.queue.removed) == queue["removed"]
    assert {str(r.id): app.on_hold(r) for r in records if app.on_hold(r)} == queue["on_hold"]
    assert [r.id for r in records if app.was_interrupted(r)] == queue["interrupted"]
    pending = {str(r.id): app.acceptances.of(r) for r in records}
    found = {k: [p.seq, p.comment, p.override] for k, p in pending.items() if p is not None}
    assert found == queue["pending"]


def test_objects_open_with_their_parts_and_without_new_commands(
    start_app, root: Path, expected: Json
) -> None:
    app = start_app([root / name for name in expected["queue"]["paths"]])
    for number, then in expected["opened"].items():
        obj = app.object(int(number))
        wait_until(lambda obj=obj: obj.asset or obj.problem, "it is open")
        assert obj.problem is None
        if obj.document.segmentation is not None and obj.document.prompts:
            wait_until(lambda obj=obj: obj.labels is not None, "its labels are there")
        assert_includes(opened_summary(obj), then, f"object {number}")
        assert obj.state.seq == expected["records"][number]["seq"]
    assert display_tasks.open_asset in InlineWorker.submitted
    assert not InlineWorker.submitted & MUST_NOT_RUN


def test_a_scene_finds_its_working_copies_and_decisions(
    start_app, root: Path, expected: Json
) -> None:
    path, then = root / "scans" / "home.glb", expected["scene"]
    app = start_app([], scene=path, predictor="geometric")
    numbers = {r.id for r in app.store.objects()}
    scene = app.open_scene(path, ())

    def settled() -> Any:
        wrong = scene.problem or InlineWorker.submitted & MUST_NOT_RUN
        return wrong or (scene.scene and not scene.busy)

    wait_until(settled, "the scene is read")
    assert scene.problem is None and not InlineWorker.submitted & MUST_NOT_RUN
    wait_until(
        lambda: all(w.drawn for w in scene.wanted() if w.document.tree), "its parts are drawn"
    )
    assert {i.obj.id: scene.status(i) for i in scene.items.values()} == then["statuses"]
    copies = {i: scene.work(i) for i in scene.items}
    assert {i: copy and copy.id for i, copy in copies.items()} == then["works"]
    assert {r.id for r in app.store.objects()} == numbers
    assert [d.decision for d in scene.document.decided] == then["decided"]
    assert not InlineWorker.submitted & MUST_NOT_RUN


# --- assets, scenes and other folders ----------------------------------------------------------


def test_saved_assets_have_the_same_tree_and_geometry(read_only: Path, expected: Json) -> None:
    workspace = read_only / "workspace"
    for kind, pattern in (("assets", "assets/*"), ("scene_assets", "scenes/saved-*/assets/*")):
        found = {p.name: object_summary(load_object(p)) for p in workspace.glob(pattern)}
        assert_includes(found, expected["folders"][kind], kind)
    for name, then in expected["folders"]["provenance"].items():
        assert_includes(read_provenance(workspace / "assets" / name), then, name)


def test_saved_assets_are_complete(read_only: Path) -> None:
    for folder in sorted((read_only / "workspace" / "assets").iterdir()):
        assert reload_check(folder, mujoco=False) == []


def test_a_saved_asset_opens_with_its_joints_and_masses(read_only: Path) -> None:
    asset = open_asset(read_only / "workspace" / "assets" / "fridge-4")
    assert asset.part_names == ("body", "door", "tray") and asset.tree is not None
    types = {j.name: j.type for j in asset.tree.joints}
    assert types == {"hinge": "revolute", "slide": "prismatic"}
    assert asset.inertials["link_1"].mass == pytest.approx(2.5)


def test_folders_of_segment_and_predict_are_readable(read_only: Path, expected: Json) -> None:
    then, results = expected["folders"], read_only / "results"
    parts = read_part_files(results / "parts")
    found = [parts.name, parts.category, [part_summary(p) for p in parts.parts]]
    assert_includes(found, then["parts"], "parts")
    predicted = load_object(results / "predicted")
    assert_includes(object_summary(predicted), then["predicted"], "predicted")
    confidence = predicted_confidence(results / "predicted", predicted.tree)
    assert_includes(confidence, then["predicted_confidence"], "confidence")


def test_an_exported_urdf_is_readable(read_only: Path, expected: Json) -> None:
    then, folder = expected["folders"], read_only / "results" / "exported" / "urdf"
    assert_includes(object_summary(load_object(folder)), then["exported"], "folder")
    file = folder / "object.urdf"
    assert_includes(object_summary(load_object(file)), then["exported_alone"], "file")
    assert list(declared_category(folder)) == then["exported_category"]


def test_scenes_are_readable(read_only: Path, expected: Json) -> None:
    for name, then in expected["folders"]["scenes"].items():
        assert_includes(scene_summary(read_scene(read_only / name)), then, name)


def test_prompt_files_are_readable(read_only: Path, expected: Json) -> None:
    found = prompts_summary(read_prompts(read_only / "scans" / "cupboard.prompts.json"))
    assert_includes(found, expected["folders"]["prompts"], "prompts")


def test_declared_physics_of_a_working_copy_is_readable(read_only: Path, expected: Json) -> None:
    (file,) = (read_only / "workspace" / "scenes").glob("*/told.npz")
    found = physics_summary(*load_declared(file.parent, np.eye(4)))
    assert_includes(found, expected["folders"]["declared_physics"], "declared physics")


# --- the command line --------------------------------------------------------------------------

COMMANDS = json.loads((HERE / "options.json").read_text(encoding="utf-8"))
BENCHMARKS = dict.fromkeys(("points", "faces", "clicks"), "ui")
BENCHMARKS |= dict.fromkeys(
    ("sets", "data", "segmenter", "limit", "offset", "parts", "first"), "segment"
)
BENCHMARKS |= {"objects": "scene", "sizes": "networks", "train": "networks"}
"""Option → a benchmark that it is for; that version took all of them with each."""


def json_value(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [json_value(v) for v in value]
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def options_of(words: Sequence[str]) -> Json:
    """Return the options that ``words`` set; the command isn't run."""
    message = io.StringIO()
    try:
        with contextlib.redirect_stderr(message):
            command, debug = parse(words)
    except SystemExit:
        raise AssertionError(f"{' '.join(words)}: {message.getvalue()}") from None
    what = {"what": words[1]} if words[0] == "bench" else {}
    return {**field_values(command), "debug": debug, **what}


def field_values(options: Any) -> Json:
    """Return the fields of a dataclass and of the dataclasses in it."""
    out: Json = {}
    for field in fields(options):
        value = getattr(options, field.name)
        out |= field_values(value) if is_dataclass(value) else {field.name: json_value(value)}
    return out


@pytest.mark.parametrize("command", COMMANDS, ids=[c["command"] or "artiworld" for c in COMMANDS])
def test_options_are_accepted_with_the_same_values(command: Json, capsys) -> None:
    for option in command["options"]:
        for words in option["words"]:
            if words[0] == "bench" and option["dest"] in BENCHMARKS:
                words[1] = BENCHMARKS[option["dest"]]
            if option["exits"]:
                with pytest.raises(SystemExit) as done:
                    parse(words)
                assert done.value.code == 0
                continue
            found = options_of(words)
            assert option["dest"] in found, f"{' '.join(words)}: no {option['dest']}"
            assert_includes(found[option["dest"]], option["value"], " ".join(words))
    if command["minimal"] is not None:
        # Without a default the command itself decides; a default may be declared for that.
        defaults = {k: v for k, v in command["defaults"].items() if v is not None}
        assert_includes(options_of(command["minimal"]), defaults, command["command"])
