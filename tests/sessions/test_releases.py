"""Releases: frozen, the same bytes for the same assets, checked before anything is imported."""

import hashlib
import io
import json
import os
import shutil
import subprocess
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from model.core.errors import ConfigurationError, InputFileError
from model.io.assets.reader import load_object
from sessions.project_settings import FORMS
from sessions.release_files import (
    check_release,
    import_release,
    is_inside,
    read_release,
    write_release,
)
from sessions.releases import Release, accepted_assets
from sessions.store import Store
from tests.accepted import accept, cupboard


@pytest.fixture
def workspace(tmp_path: Path, store: Store) -> Store:
    accept(store, tmp_path / "secret folder" / "oven 1.5.ply", cupboard())
    accept(store, tmp_path / "secret folder" / "cabinet.ply", cupboard("Cabinet"), "ben", 1)
    return store


def release(store: Store, out: Path, form: str = "folder", **settings: int) -> Release:
    about = Release("kitchen", out.name, form, "CC-BY-4.0", "Example Lab")
    return write_release(about, accepted_assets(store), out, **settings)


def tree_of(folder: Path) -> dict[str, str]:
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in folder.rglob("*")
        if p.is_file()
    }


@pytest.mark.parametrize("form", FORMS)
def test_same_assets_give_same_bytes_and_import_again(
    workspace: Store, tmp_path: Path, form: str
) -> None:
    found = release(workspace, tmp_path / "a" / "1.0", form)
    release(workspace, tmp_path / "b" / "1.0", form)
    written = tree_of(tmp_path / "a" / "1.0")
    assert written == tree_of(tmp_path / "b" / "1.0")
    assert read_release(tmp_path / "a" / "1.0") == found
    assert not any(os.stat(p).st_mode & 0o222 for p in (tmp_path / "a").rglob("*") if p.is_file())
    command = ["sha256sum", "--check", "--strict", "manifest.sha256"]
    checked = subprocess.check_output(command, cwd=tmp_path / "a" / "1.0", text=True)
    assert len(checked.splitlines()) == len(written) - 1

    other = Store(tmp_path / "other")
    records = import_release(tmp_path / "a" / "1.0", other)
    assert [r.name for r in records] == [a.key for a in found.assets]
    obj = load_object(records[0].path)
    assert [j.type for j in obj.tree.joints] == ["revolute"] and obj.category == "Cabinet"
    with pytest.raises(InputFileError, match="imported before"):
        import_release(tmp_path / "a" / "1.0", other)
    other.close()


def test_names_of_people_and_folders_stay_at_home(workspace: Store, tmp_path: Path) -> None:
    found = release(workspace, tmp_path / "1.0")
    assert [(a.key, a.category) for a in found.assets] == [
        ("cabinet-2", "Cabinet"),
        ("oven_1_5-1", "Oven"),
    ]
    assert {a.predictor for a in found.assets} == {"geometric 1"}
    assert (found.assets[0].joints, found.newest) == ({"revolute": 1}, "2026-03-03")
    everything = b"".join(p.read_bytes() for p in (tmp_path / "1.0").rglob("*") if p.is_file())
    for word in (b"secret folder", b"anna", b"ben", str(tmp_path).encode()):
        assert word not in everything, word
    kept = json.loads((tmp_path / "1.0" / "assets" / "cabinet-2" / "provenance.json").read_text())
    assert kept["review"]["by"] == "person-2" and kept["source"]["path"] == "cabinet.ply"


def test_a_workspace_that_was_moved_is_released(workspace: Store, tmp_path: Path) -> None:
    workspace.close()
    moved = workspace.workspace.rename(tmp_path / "moved")
    store = Store(moved)
    assert len(release(store, tmp_path / "1.0").assets) == 2
    store.close()


def test_a_release_is_never_written_twice_nor_of_changed_assets(
    workspace: Store, tmp_path: Path
) -> None:
    release(workspace, tmp_path / "1.0")
    with pytest.raises(ConfigurationError, match="never changes"):
        release(workspace, tmp_path / "1.0")
    mesh = next(accepted_assets(workspace)[0].folder.rglob("*.obj"))
    mesh.write_text(mesh.read_text() + "# by hand\n")
    with pytest.raises(InputFileError, match=f"{mesh.name}.*changed since it was accepted"):
        release(workspace, tmp_path / "2.0")
    assert sorted(p.name for p in tmp_path.iterdir() if "2.0" in p.name) == [], "no half of it"
    shutil.rmtree(accepted_assets(workspace)[0].folder)
    with pytest.raises(InputFileError, match="isn't there; reopen"):
        release(workspace, tmp_path / "2.0")


def test_webdataset_reads_its_shards(workspace: Store, tmp_path: Path) -> None:
    webdataset = pytest.importorskip("webdataset")
    found = release(workspace, tmp_path / "1.0", "webdataset", shard_bytes=1)
    shards = sorted((tmp_path / "1.0" / "shards").iterdir())
    assert [s.name for s in shards] == ["kitchen-1_0-000000.tar", "kitchen-1_0-000001.tar"]
    samples = list(webdataset.WebDataset([str(s) for s in shards], shardshuffle=False).decode())
    assert [s["__key__"] for s in samples] == [a.key for a in found.assets]
    assert samples[0]["json"]["category"] == "Cabinet"
    assert samples[0]["tree.json"]["children"][0]["joint_type"] == "revolute"
    with tarfile.open(fileobj=io.BytesIO(samples[0]["tar"])) as packed:
        packed.extractall(tmp_path / "out", filter="data")
    assert load_object(tmp_path / "out").tree.joints[0].upper == 1.5


def test_hugging_faces_layout_is_read(workspace: Store, tmp_path: Path) -> None:
    found = release(workspace, tmp_path / "1.0", "huggingface")
    _, header, text = (tmp_path / "1.0" / "README.md").read_text().split("---\n", 2)
    said = yaml.safe_load(header)
    assert said["license"] == "cc-by-4.0" and said["size_categories"] == ["n<1K"]
    assert "| Oven | 1 |" in text and "| revolute | 2 |" in text
    file = tmp_path / "1.0" / said["configs"][0]["data_files"]
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert [r["key"] for r in rows] == [a.key for a in found.assets]
    assert all((tmp_path / "1.0" / r["urdf"]).is_file() for r in rows)
    assert len({tuple(r) for r in rows}) == 1, "the same columns everywhere"
    try:
        from datasets import load_dataset
    except ImportError:
        return  # the rows above are what it reads
    data = load_dataset(str(tmp_path / "1.0"), cache_dir=str(tmp_path / "cache"), split="train")
    assert data["category"] == ["Cabinet", "Oven"]


def _replace(path: Path, old: str, new: str) -> None:
    path.chmod(0o644)
    path.write_text(path.read_text().replace(old, new, 1))


def _changed(folder: Path) -> None:
    _replace(folder / "assets" / "cabinet-2" / "object.urdf", "revolute", "continuous")


def _missing(folder: Path) -> None:
    (folder / "assets" / "cabinet-2" / "tree.json").unlink()


def _added(folder: Path) -> None:
    (folder / "assets" / "more.py").write_text("import os")


def _link(folder: Path) -> None:
    tree = folder / "assets" / "cabinet-2" / "tree.json"
    tree.rename(folder.parent / "tree.json")
    tree.symlink_to(folder.parent / "tree.json")


def _outside(folder: Path) -> None:
    (folder.parent / "victim").write_text("mine")
    sha256 = hashlib.sha256(b"mine").hexdigest()
    _replace(folder / "manifest.sha256", "", f"{sha256}  ../victim\n")


def _odd_key(folder: Path) -> None:
    _replace(folder / "release.json", '"key": "cabinet-2"', '"key": "../../cabinet-2"')


def _odd_version(folder: Path) -> None:
    _replace(folder / "release.json", '"version": "1.0"', '"version": ".."')


def _newer(folder: Path) -> None:
    _replace(folder / "release.json", '"format": 1', '"format": 99')


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (_changed, "object.urdf has another sum"),
        (_missing, "tree.json is missing"),
        (_added, "more.py isn't in manifest"),
        (_link, "tree.json is a link"),
        (_outside, "line 1 names '../victim'"),
        (_odd_key, "../../cabinet-2"),
        (_odd_version, "names '..'"),
        (_newer, "format 99"),
    ],
)
def test_what_is_wrong_with_a_release_is_named(
    workspace: Store, tmp_path: Path, damage: Callable[[Path], None], words: str
) -> None:
    release(workspace, tmp_path / "1.0")
    damage(tmp_path / "1.0")
    other = Store(tmp_path / "other")
    with pytest.raises(InputFileError, match=words.replace(".", r"\.")):
        import_release(tmp_path / "1.0", other)
    assert other.objects() == [] and not (tmp_path / "other" / "uploads" / "kitchen-1.0").exists()
    other.close()


@pytest.mark.parametrize("hostile", ["../../evil", "/tmp/evil", "a/../../evil", "C:\\evil", "link"])
def test_a_hostile_shard_writes_nothing(workspace: Store, tmp_path: Path, hostile: str) -> None:
    """Its sums are right: they are the attacker's own."""
    folder = tmp_path / "1.0"
    release(workspace, folder, "webdataset")
    (shard,) = (folder / "shards").iterdir()
    inner = io.BytesIO()
    with tarfile.open(fileobj=inner, mode="w") as tar:
        member = tarfile.TarInfo(hostile)
        if hostile == "link":
            member.type, member.linkname = tarfile.SYMTYPE, "/etc/passwd"
        tar.addfile(member)
    before = hashlib.sha256(shard.read_bytes()).hexdigest()
    shard.chmod(0o644)
    with tarfile.open(shard, "w") as tar:
        member = tarfile.TarInfo("cabinet-2.tar")
        member.size = len(inner.getvalue())
        tar.addfile(member, io.BytesIO(inner.getvalue()))
    after = hashlib.sha256(shard.read_bytes()).hexdigest()
    _replace(folder / "manifest.sha256", before, after)
    check_release(folder)
    other = Store(tmp_path / "other")
    with pytest.raises(InputFileError, match="no file of an asset"):
        import_release(folder, other)
    assert list((tmp_path / "other" / "uploads").iterdir()) == []
    assert not (tmp_path / "evil").exists()
    other.close()


@pytest.mark.parametrize("name", ["", ".", "a//b", "a/", "./a", "a\nb", "a\0", "nul:x"])
def test_odd_names_lead_nowhere(name: str) -> None:
    assert not is_inside(name)
    assert is_inside("assets/oven_1-2/meshes/türe 1.obj")
