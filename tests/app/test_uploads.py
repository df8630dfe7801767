"""What a browser sends: objects of several files as a zip, and zips that mean harm."""

from __future__ import annotations

import contextlib
import http.client
import io
import itertools
import json
import random
import shutil
import stat
import tracemalloc
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image

from app.server.export_tasks import DOWNLOAD_BYTES
from app.server.network import Room
from app.server.server import Server
from app.server.uploads import keep_upload
from model.core.errors import InputFileError
from model.io.model_files import find_assets
from model.io.open_asset import open_asset
from tests.app.api_server import team_server, token_client, upload_at_once

OBJ = (
    b"mtllib door.mtl\nusemtl oak\nv 0 0 0\nv 1 0 0\nv 0 1 0\n"
    b"vt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
)
MTL = b"newmtl oak\nKd 1 1 1\nmap_Kd images/oak.png\n"
ROOM = 10_000_000


def png() -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (4, 4), (120, 80, 40)).save(out, "PNG")
    return out.getvalue()


def zipped(*entries: tuple[str | zipfile.ZipInfo, bytes], packing: int = zipfile.ZIP_STORED):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", packing) as archive:
        for name, data in entries:
            archive.writestr(name, data)
    return out.getvalue()


def test_an_obj_keeps_its_texture(tmp_path: Path) -> None:
    entries = (("door/door.obj", OBJ), ("door/door.mtl", MTL), ("door/images/oak.png", png()))
    content = zipped(*entries, ("__MACOSX/door/._door.obj", b"x"), ("door/run.sh", b"rm"))
    kept = keep_upload(tmp_path, "door.zip", content, ROOM)
    (path,) = find_assets([kept])
    mesh = open_asset(path).mesh
    assert mesh is not None and mesh.materials[0].texture is not None
    assert not list(kept.rglob("*.sh")) and not (kept / "__MACOSX").exists()
    assert keep_upload(tmp_path, "door.zip", content, ROOM) == kept


def test_a_single_file_is_kept_under_its_digest(tmp_path: Path) -> None:
    path = keep_upload(tmp_path, "../../etc/tri.obj", OBJ, ROOM)
    assert path.read_bytes() == OBJ
    assert path.name == "tri.obj" and path.parent.parent == tmp_path
    with pytest.raises(InputFileError, match="zip"):
        keep_upload(tmp_path, "photo.heic", b"x", ROOM)
    with pytest.raises(InputFileError, match="empty"):
        keep_upload(tmp_path, "a.zip", b"", ROOM)


def link() -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo("link.obj")
    entry.create_system = 3
    entry.external_attr = (stat.S_IFLNK | 0o777) << 16
    return entry


def lying() -> bytes:
    """A zip that announces fewer bytes than it unpacks to."""
    content = bytearray(zipped(("a.obj", b"v 0 0 0\n" * 10_000), packing=zipfile.ZIP_DEFLATED))
    size = (80_000).to_bytes(4, "little")
    assert content.count(size) == 2
    return bytes(content.replace(size, (10).to_bytes(4, "little")))


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (zipped(("../../evil.obj", OBJ)), "leads out"),
        (zipped(("/etc/evil.obj", OBJ)), "leads out"),
        (zipped(("..\\..\\evil.obj", OBJ)), "leads out"),
        (zipped(("c:evil.obj", OBJ)), "leads out"),
        (zipped((link(), b"/etc/passwd")), "link"),
        (zipped(("a.obj", b"v 0 0 0\n" * 2_000_000), packing=zipfile.ZIP_DEFLATED), "unpacks"),
        (zipped(*((f"{i}.obj", b"") for i in range(5001))), "5,001 files"),
        (zipped(("notes.exe", b"MZ")), "nothing that can be opened"),
        (zipped(("x" * 300 + ".obj", OBJ)), "very long name"),
        (zipped(("a.obj", OBJ))[:-30], "not a readable zip"),
        (b"PK\x03\x04 not really", "not a readable zip"),
        (lying(), "not a readable zip"),
        (zipped(("a.obj", OBJ), ("a.obj/b.obj", OBJ)), "a file above a.obj/b.obj"),
        (zipped(("a.obj/b.obj", OBJ), ("a.obj", OBJ)), "a.obj twice"),
    ],
)
def test_hostile_zips_are_refused_and_leave_nothing(
    tmp_path: Path, content: bytes, told: str
) -> None:
    with pytest.raises(InputFileError, match=told):
        keep_upload(tmp_path / "uploads", "some.zip", content, ROOM)
    assert not [p for p in tmp_path.rglob("*") if p.is_file()]


@pytest.mark.parametrize("packing", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_damaged_zip_is_called_damaged(tmp_path: Path, packing: int) -> None:
    whole = zipped(("a.obj", OBJ * 50), ("b.obj", OBJ[::-1] * 50), packing=packing)
    rng = random.Random(packing)
    for number in range(300):
        mutated = bytearray(whole)
        for _ in range(rng.randint(1, 8)):
            mutated[rng.randrange(len(mutated))] = rng.randrange(256)
        with contextlib.suppress(InputFileError):
            keep_upload(tmp_path / str(number), "some.zip", bytes(mutated), ROOM)


def test_ten_who_upload_the_same_files_get_them_whole(tmp_path: Path) -> None:
    (tmp_path / "tri.obj").write_bytes(OBJ)
    with team_server(tmp_path / "workspace", tmp_path / "tri.obj") as server:
        ann = token_client(server, "ann", "read", "annotate")
        for number in range(6):
            upload_at_once(tmp_path / str(number), [ann], number)
        folders = list((tmp_path / "workspace" / "uploads").glob("*/objects"))
        assert [len(list(f.rglob("*.*"))) for f in folders] == [120] * 6
        assert ann.call("GET", "/objects")["total"] == 1 + 6 * 61


@pytest.fixture
def large(tmp_path: Path) -> Iterator[tuple[Server, http.client.HTTPConnection, dict[str, str]]]:
    """A server of a tiny object; a connection to it, and headers that let in."""
    (tmp_path / "tri.obj").write_bytes(OBJ)
    with team_server(tmp_path / "workspace", tmp_path / "tri.obj") as server:
        people = server.app_state.store.people
        ann = people.accounts.find("ann")
        token = people.credentials.make_token(ann, "test", ("read", "annotate"))
        connection = http.client.HTTPConnection("127.0.0.1", server.viser.get_port(), timeout=60)
        yield server, connection, {"Authorization": f"Bearer {token}"}


def blocks(count: int) -> Iterator[bytes]:
    """A binary PLY of so many MB, of points."""
    points = (count * 2**20) // 12
    yield (
        b"ply\nformat binary_little_endian 1.0\nelement vertex %d\n"
        b"property float x\nproperty float y\nproperty float z\nend_header\n" % points
    )
    yield from itertools.repeat(bytes(12 * 2**15), points // 2**15 + 1)


@contextlib.contextmanager
def little_memory() -> Iterator[None]:
    """Fail where Python takes more than a quarter of what is sent, at any moment."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < MANY * 2**20 / 4
    finally:
        tracemalloc.stop()


MANY = 40
"""MB of a large body."""


def answer_of(
    connection: http.client.HTTPConnection, headers: dict[str, str]
) -> http.client.HTTPResponse:
    """The answer, also where it takes long."""
    answer = connection.getresponse()
    while answer.status == 202:
        place = answer.headers["Location"]
        answer.read()
        connection.request("GET", place, headers=headers)
        answer = connection.getresponse()
    assert answer.status < 300, answer.read()
    return answer


def test_a_large_upload_does_not_pass_whole_through_memory(large) -> None:
    server, connection, headers = large
    with little_memory():
        connection.request("POST", "/api/v1/objects?name=big.ply", blocks(MANY), headers)
        assert json.load(answer_of(connection, headers))["name"] == "big"
    (kept,) = (server.app_state.workspace / "uploads").rglob("big.ply")
    assert kept.stat().st_size > MANY * 2**20


def test_a_large_download_does_not_pass_whole_through_memory(large, tmp_path, monkeypatch) -> None:
    server, connection, headers = large
    (tmp_path / "asset").mkdir()
    content = random.Random(1).randbytes(MANY * 2**20)
    (tmp_path / "asset" / "mesh.bin").write_bytes(content)
    monkeypatch.setattr(server.app_state.store.assets, "folder", lambda _: tmp_path / "asset")
    with little_memory():
        connection.request("GET", "/api/v1/assets/1", headers=headers)
        with (tmp_path / "got.zip").open("wb") as out:
            shutil.copyfileobj(answer_of(connection, headers), out)
    with zipfile.ZipFile(tmp_path / "got.zip") as archive:
        assert archive.read("tri/mesh.bin") == content


def test_bodies_have_room_for_all_together_and_half_of_it_for_one(large) -> None:
    server, connection, headers = large
    room, taken = Room(100), [Body() for _ in range(4)]
    assert room.take(taken[0], 50, "ann") and not room.take(taken[1], 1, "ann")
    assert room.take(taken[1], 30, "rob") and not room.take(taken[2], 30, "mia")
    del taken[0]
    assert room.take(taken[1], 30, "mia"), "what is over gives its room back"
    half = room_of(server) // 2
    held = [Body(), Body()]
    full = [server.app_state.room.take(held[n], half, who) for n, who in enumerate(("rob", "mia"))]
    assert full == [True, True]
    for refused in (True, False):
        connection.request("POST", "/api/v1/objects?name=b.obj", OBJ, headers)
        answer = connection.getresponse()
        assert (answer.status == 429) == refused, answer.read()
        answer.read()
        held.clear()


class Body:
    """Stands in for a request."""


def room_of(server: Server) -> int:
    return 2 * max(server.config.max_upload_mb * 1_000_000, DOWNLOAD_BYTES)
