"""Whatever is written to a place that others write, too: by ten at once it comes out complete."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from app.server import prepare_tasks, tasks
from app.server.display_tasks import draw_thumbnail, lit_mesh
from app.server.ending import unfinished
from app.server.part_tasks import DRAFTS_KEPT, PartSource, prepare_asset
from app.server.scene_saving_tasks import save_scene
from app.server.scene_tasks import SceneItem, make_working_copy, shapes
from app.server.uploads import keep_upload
from model.core.errors import ArtiworldError
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import reload_check
from model.physics.collision.store import load_arrays, save_arrays
from model.prediction.experience import Experience, in_use, record_of
from model.scenes.convert import alone
from model.scenes.registry import read_scene
from model.scenes.scene import Decision, SceneObject
from model.scenes.unpacking import unpack
from model.training import experience
from sessions.document import SavedRecord
from sessions.release_files import import_release, write_release
from sessions.releases import Release, accepted_assets
from sessions.storage import ArrayFiles, AssetStorage
from sessions.store import Store
from tests.accepted import accept, cupboard
from tests.builders import write_cupboard, zip_of_objects
from tests.model.scenes import scenes_made

AT_ONCE = 10
ROOM = 10_000_000
DOOR = Joint("door", "revolute", "link_0", "link_1", (0, 0, 1), (0, 0, 0), lower=0, upper=1.5)
TREE = KinematicTree(("link_0", "link_1"), (DOOR,))

_meeting: list[Any] = []
"""Where all meet before they write; of threads or of forked processes."""


def _meet_at(meeting: Any) -> None:
    _meeting[:] = [meeting]


def _when_all_are_there(write: Callable[[int], Any], number: int) -> Any:
    _meeting[0].wait(60)
    try:
        return write(number)
    except ArtiworldError as error:
        return str(error)


def threads() -> Executor:
    return ThreadPoolExecutor(AT_ONCE, initializer=_meet_at, initargs=(threading.Barrier(AT_ONCE),))


def processes() -> Executor:
    fork = multiprocessing.get_context("fork")
    return ProcessPoolExecutor(
        AT_ONCE, fork, initializer=_meet_at, initargs=(fork.Barrier(AT_ONCE),)
    )


def at_once(kind: Callable[[], Executor], write: Callable[[int], Any]) -> list[Any]:
    """What ten get that write at once; the text of an error."""
    with kind() as pool:
        return list(pool.map(partial(_when_all_are_there, write), range(AT_ONCE)))


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of what is opened."""
    folder = tmp_path_factory.mktemp("given")
    trimesh.creation.box((1, 0.5, 0.7)).export(folder / "box.ply")
    (folder / "objects.zip").write_bytes(zip_of_objects(60))
    write_cupboard(folder / "cupboard")
    scenes_made.write_gltf(folder / "room.glb")
    return folder


# --- what is written where, each returns its place --------------------------------------------


def a_zip(given: Path, workspace: Path) -> Path:
    content = (given / "objects.zip").read_bytes()
    return keep_upload(workspace / "uploads", "objects.zip", content, ROOM)


def a_file(given: Path, workspace: Path) -> Path:
    return keep_upload(workspace / "uploads", "b.ply", (given / "box.ply").read_bytes(), ROOM)


def an_array(given: Path, workspace: Path) -> Path:
    arrays = ArrayFiles(workspace / "arrays")
    ref = arrays.put(np.arange(200_000)[::-1])
    assert len(arrays.get(ref)) == 200_000
    return arrays.path(ref)


def a_cached_asset(given: Path, workspace: Path) -> Path:
    _, folder = tasks.working_copy(given / "box.ply", workspace, tasks.ReadOptions())
    assert tasks.load_asset(folder).element_count == 12
    return folder


def a_light(given: Path, workspace: Path) -> Path:
    folder = a_cached_asset(given, workspace)
    assert lit_mesh(folder) is not None
    return folder


def a_thumbnail(given: Path, workspace: Path) -> Path:
    return draw_thumbnail(given / "box.ply", workspace, tasks.ReadOptions())


def a_scene_objects_copy(given: Path, workspace: Path) -> Path:
    copy = workspace / "scenes" / "cupboard-1"
    obj = SceneObject("cupboard", "cupboard", np.eye(4), np.ones(3))
    assert make_working_copy(SceneItem(obj, Decision(True), given / "cupboard", copy)) == ""
    return copy


def _half_a_box(given: Path, workspace: Path) -> PartSource:
    folder = a_cached_asset(given, workspace)
    labels = tasks.arrays_of(workspace).put((np.arange(12) < 2).astype(np.int16))
    return PartSource(folder, workspace, labels, {1: "door"}, "Cabinet", "box")


def a_draft(given: Path, workspace: Path) -> Path:
    draft = prepare_asset(_half_a_box(given, workspace), TREE)
    assert reload_check(draft) == []
    return draft


def an_asset(given: Path, workspace: Path) -> Path:
    return write_asset(cupboard(), workspace / "assets" / "a.b-1", provenance={"by": "me"}).folder


def a_part_cut_out(given: Path, workspace: Path) -> Path:
    source = _half_a_box(given, workspace)
    return prepare_tasks.cut_out(
        workspace, None, source.folder, source.labels, 1, "door"
    ).path.parent


def a_drawn_shape(given: Path, workspace: Path) -> Path:
    (found,) = shapes([given / "box.ply"], workspace, 1000).values()
    assert not isinstance(found, str)
    return workspace / "cache" / "shapes"


def collision_shapes(given: Path, workspace: Path) -> Path:
    path = workspace / "collision" / "key.npz"
    save_arrays(path, {"hull 0 0": np.random.default_rng(0).normal(size=(50_000, 3))})
    assert load_arrays(path) is not None
    return workspace / "collision"


def the_objects_inside_a_scene(given: Path, workspace: Path) -> Path:
    folder = workspace / "scenes" / "inside-room"
    found = unpack(read_scene(given / "room.glb"), folder)
    assert not found.problems and all(p.exists() for p in found.files.values())
    return folder


def an_asset_on_the_storage(given: Path, workspace: Path) -> Path:
    url = f"file://{workspace}/there"
    me, place = f"{os.getpid()} {threading.get_ident()}", workspace / "two" / "assets" / "box-1"
    for text in ("one", "two"):
        draft = workspace / me / "draft"
        (draft / "meshes").mkdir(parents=True)
        (draft / "meshes" / "a.obj").write_text("v 0 0 0\n" * 5000)
        (draft / "provenance.json").write_text('{"asset": {"format": 1, "parts": []}}')
        mine, ours = (AssetStorage(workspace / name, url) for name in (me, "two"))
        mine.publish(draft, workspace / me / "assets" / "box-1", {"text": f"{text} {me}"})
        assert ours.folder(SavedRecord(str(place), "ann", "2026")) == place
    return place


PLACES = (a_zip, a_file, an_array, a_cached_asset, a_light, a_thumbnail, a_scene_objects_copy)
PLACES += (an_asset, a_part_cut_out, a_drawn_shape, collision_shapes, the_objects_inside_a_scene)
PLACES += (an_asset_on_the_storage, pytest.param(a_draft, marks=pytest.mark.slow))


def _size(file: Path) -> int:
    """Bytes; lines of OBJ, as rounding decides how Qhull cuts flat sides into triangles; 0 for
    JSON, which says when and by whom."""
    if file.suffix == ".json":
        return 0
    return file.read_bytes().count(b"\n") if file.suffix == ".obj" else file.stat().st_size


def sizes(place: Path) -> dict[str, int]:
    """File → its size."""
    files = [place] if place.is_file() else sorted(p for p in place.rglob("*") if p.is_file())
    return {str(p.relative_to(place)): _size(p) for p in files}


def _write_in(
    place: Callable[[Path, Path], Path], given: Path, workspace: Path, number: int
) -> Path:
    return place(given, workspace)


@pytest.mark.parametrize("kind", [threads, processes])
@pytest.mark.parametrize("place", PLACES)
def test_ten_at_once_write_it_complete(
    place: Callable[[Path, Path], Path], kind: Callable[[], Executor], given: Path, tmp_path: Path
) -> None:
    alone = place(given, tmp_path / "alone")
    workspace = tmp_path / "shared"
    there = workspace / alone.relative_to(tmp_path / "alone")
    assert set(at_once(kind, partial(_write_in, place, given, workspace))) == {there}
    assert sizes(there) == sizes(alone)
    assert unfinished(workspace) == []


# --- what is there once, or under a number of its own ------------------------------------------


def _release(workspace: Path, number: int) -> str:
    store = Store(workspace)
    about = Release("kitchen", "1", "folder", "CC-BY-4.0", "Example Lab")
    write_release(about, accepted_assets(store), workspace / "releases" / "kitchen-1")
    return "written"


def _import(release: Path, workspace: Path, number: int) -> str:
    assert len(import_release(release, Store(workspace))) == 1
    return "written"


@pytest.mark.parametrize("kind", [threads, processes])
def test_one_of_ten_writes_a_release_and_one_imports_it(
    kind: Callable[[], Executor], tmp_path: Path
) -> None:
    store = Store(tmp_path / "one")
    accept(store, tmp_path / "scans" / "oven.ply", cupboard())
    store.close()
    said = sorted(at_once(kind, partial(_release, tmp_path / "one")))
    assert said[-1] == "written" and all("is there already" in s for s in said[:-1])
    release = tmp_path / "one" / "releases" / "kitchen-1"
    Store(tmp_path / "two").close()
    said = sorted(at_once(kind, partial(_import, release, tmp_path / "two")))
    assert said[-1] == "written" and all("was imported before" in s for s in said[:-1])
    assert unfinished(tmp_path / "one") == unfinished(tmp_path / "two") == []


def _learn(workspace: Path, number: int) -> int:
    side = experience.Side(1, 1, 1, 0.0)
    learned = experience.Learned(1, (f"oven-{number}",), (), side, side, True)
    kept = experience.keep_version(workspace, learned, Experience(()))
    experience.use(workspace, kept.version)
    return kept.version


@pytest.mark.parametrize("kind", [threads, processes])
def test_ten_that_learn_at_once_get_a_version_each(
    kind: Callable[[], Executor], tmp_path: Path
) -> None:
    assert sorted(at_once(kind, partial(_learn, tmp_path))) == list(range(1, AT_ONCE + 1))
    assert experience.versions(tmp_path) == list(range(1, AT_ONCE + 1))
    folders = [tmp_path / experience.FOLDER / str(v) for v in experience.versions(tmp_path)]
    known = {record_of(folder)["assets"][0] for folder in folders}
    assert known == {f"oven-{number}" for number in range(AT_ONCE)}
    assert in_use(tmp_path) is not None


def _draft_of_a_size(source: PartSource, number: int) -> Path:
    line, upper = ((0, 0, 1), (0, 0, 0)), 0.5 + number / 10
    limit = Joint("door", "revolute", "link_0", "link_1", *line, lower=0, upper=upper)
    return prepare_asset(source, KinematicTree(TREE.links, (limit,)))


def test_old_drafts_are_dropped_but_never_those_being_written(given: Path, tmp_path: Path) -> None:
    source = _half_a_box(given, tmp_path)
    drafts = at_once(processes, partial(_draft_of_a_size, source))
    assert all(isinstance(d, Path) for d in drafts), drafts
    left = list((tmp_path / "drafts").iterdir())
    assert len(left) >= DRAFTS_KEPT and all(reload_check(d) == [] for d in left)


def _save_a_scene(scene: Path, out: Path, number: int = 0) -> str:
    read = read_scene(scene)
    ids = [o.id for o in read.objects]
    save_scene(scene, read.reader, ids, (), {}, {}, out)
    return "saved"


def test_one_at_a_time_saves_a_scene(given: Path, tmp_path: Path) -> None:
    out = tmp_path / "saved-1"
    with alone(out):
        said = at_once(processes, partial(_save_a_scene, given / "room.glb", out))
    assert all("another conversion is writing into" in text for text in said), said
    _save_a_scene(given / "room.glb", out)
    assert (out / "summary.json").is_file()


# --- what former versions left ----------------------------------------------------------------


@pytest.mark.parametrize("kind", [threads, processes])
def test_a_folder_of_which_files_are_missing_is_completed(
    kind: Callable[[], Executor], given: Path, tmp_path: Path
) -> None:
    folder = a_zip(given, tmp_path)
    whole = sizes(folder)
    for i in range(0, 60, 2):
        (folder / f"p{i}.obj").unlink()
    (folder / "p1.obj").write_text("v 0 0 0\n")  # cut off
    (folder / "maps" / "p3.mtl").write_text("x" * len("newmtl a\n"))  # as long, but other bytes
    (folder / "p5.prompts.json").write_text("{}")  # of a person who works there
    before = (folder / "p7.obj").stat()
    assert set(at_once(kind, partial(_write_in, a_zip, given, tmp_path))) == {folder}
    assert sizes(folder) == whole | {"p5.prompts.json": 0}
    assert (folder / "maps" / "p3.mtl").read_text() == "newmtl a\n"
    after = (folder / "p7.obj").stat()
    assert (after.st_mtime_ns, after.st_ino) == (before.st_mtime_ns, before.st_ino)
    assert unfinished(tmp_path) == []


def test_a_file_that_was_cut_off_is_written_again(given: Path, tmp_path: Path) -> None:
    path = a_file(given, tmp_path)
    path.write_bytes(b"ply\n")
    assert a_file(given, tmp_path).read_bytes() == (given / "box.ply").read_bytes()
