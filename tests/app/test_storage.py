"""Accepted assets and releases on object storage: a real S3 server where there is one."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import urllib.request
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from model.core.errors import ArtiworldError, ConfigurationError, StoreError
from sessions.document import SavedRecord
from sessions.storage import STORAGE_VARIABLE, AssetStorage
from tests.app.api_server import team_server, token_client
from tests.app.run_cli import artiworld, assert_users_mistake
from tests.builders import wait_until, write_cupboard

pytest.importorskip("fsspec", reason="the extra s3 is not installed")


@pytest.fixture(scope="module")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a prefix in a bucket of a real server; its settings are in the environment."""
    pytest.importorskip("obstore", reason="the extra s3 is not installed")
    program = shutil.which("moto_server")
    if program is None:
        pytest.skip("no S3 server: pip install 'moto[server]' in an environment of its own")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    running = subprocess.Popen(
        [program, *"-H 127.0.0.1 -p".split(), str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    address = f"http://127.0.0.1:{port}"

    def bucket() -> bool:
        try:
            request = urllib.request.Request(f"{address}/assets-of-us", method="PUT")
            return urllib.request.urlopen(request, timeout=5).status == 200
        except OSError:
            return False

    with pytest.MonkeyPatch.context() as patch:
        secrets = {"AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b"}
        place = {"AWS_ENDPOINT_URL": address, "AWS_REGION": "us-east-1"}
        for name, value in (secrets | place).items():
            patch.setenv(name, value)
        try:
            wait_until(bucket, "the S3 server", 60)
            yield "s3://assets-of-us/kitchens"
        finally:
            running.terminate()
            running.wait(30)


def provenance(folder: Path) -> Any:
    return json.loads((folder / "provenance.json").read_text())


def test_an_accepted_asset_lies_on_the_storage_and_comes_back(
    s3: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace = tmp_path / "workspace"
    cupboard = write_cupboard(tmp_path / "cupboard")
    with team_server(workspace, cupboard, predictor="geometric", storage=s3) as server:
        mia = token_client(server, "mia", "read", "annotate", "review", "manage")
        id = mia.call("GET", "/objects")["objects"][0]["id"]
        mia.command(id, kind="set_category", category="Cupboard")
        wait_until(lambda: mia.object(id)["segmented"], "parts", 60)
        mia.predict(id)
        mia.accept(id, override="a test", warnings_seen=True)
        (folder,) = [p for p in (workspace / "assets").iterdir() if p.is_dir()]
        first = provenance(folder)
        before = sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
        shutil.rmtree(folder)
        assert [a["id"] for a in mia.call("GET", "/assets")["assets"]] == [id]
        archive = mia.download(id, tmp_path / "asset.zip")
        with zipfile.ZipFile(archive) as found:
            assert len(found.namelist()) == len(before) > 3
        assert sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file()) == before
        assert provenance(folder) == first

        # Another server accepts it again; what lies here is old then, and is fetched.
        elsewhere = AssetStorage(tmp_path / "elsewhere", s3)
        draft = tmp_path / "elsewhere" / "assets" / ".draft"
        shutil.copytree(folder, draft)
        elsewhere.publish(draft, tmp_path / "elsewhere" / "assets" / folder.name, {"second": True})
        mia.download(id, tmp_path / "again.zip")
        assert provenance(folder)["second"] is True

    monkeypatch.setenv(STORAGE_VARIABLE, s3)
    released = artiworld(
        "release", workspace, *"--name kitchens --version 1 --license CC0-1.0 --json".split()
    )
    place = json.loads(released.stdout)["storage"]
    assert place.startswith(f"{s3}/releases/kitchens-1/")
    shutil.rmtree(workspace / "releases")
    again = artiworld("release", workspace, "--name", "kitchens", "--version", "1")
    assert_users_mistake(again, "is there already")


def test_a_storage_that_fails_is_named(s3: str, tmp_path: Path) -> None:
    folder = tmp_path / "assets" / "box-1"
    folder.mkdir(parents=True)
    gone = AssetStorage(tmp_path, "s3://no-such-bucket/x")
    with pytest.raises(ArtiworldError, match="no-such-bucket"):
        gone.folder(SavedRecord(str(folder), "ann", "2026"))
    with pytest.raises(ConfigurationError, match="s3://bucket/prefix"):
        AssetStorage(tmp_path, "bucket")
    with pytest.raises(ConfigurationError, match="ftpx"):
        AssetStorage(tmp_path, "ftpx://host/x")


def test_nobody_reads_half_an_asset(tmp_path: Path) -> None:
    one, two = (AssetStorage(tmp_path / n, "memory://half/prefix") for n in ("one", "two"))
    saved = SavedRecord("/elsewhere/assets/box-1", "ann", "2026")
    assert two.folder(saved) is None
    files = {"object.urdf": "<robot/>", "meshes/a.obj": "v 0 0 0"}
    for text in ("first", "second"):
        draft = tmp_path / "one" / "assets" / f".{text}"
        for name, content in files.items():
            (draft / name).parent.mkdir(parents=True, exist_ok=True)
            (draft / name).write_text(content + text)
        (draft / "provenance.json").write_text('{"asset": {"format": 1, "parts": []}}')
        one.publish(draft, tmp_path / "one" / "assets" / "box-1", {"text": text})
        found = two.folder(saved)
        assert found is not None
        assert (found / "object.urdf").read_text() == f"<robot/>{text}"
        assert (found / "meshes/a.obj").read_text() == f"v 0 0 0{text}"
    assert two.folder(saved) == found, "what is here and new is taken as it is"
    import fsspec

    files_there = fsspec.filesystem("memory").find("half/prefix")
    assert len(files_there) == 1 + 3, "the former version is gone"
    fsspec.filesystem("memory").pipe_file("half/prefix/assets/box-1/current", b"../../etc")
    with pytest.raises(StoreError, match="names no version"):
        two.folder(saved)
