"""What a browser sends: objects of several files as a zip, and zips that mean harm."""

from __future__ import annotations

import contextlib
import io
import random
import stat
import zipfile
from pathlib import Path

import pytest
from PIL import Image

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
