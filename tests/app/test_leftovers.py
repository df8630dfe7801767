"""What killed processes left half-written goes at the next start, unless somebody is writing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from app.server.ending import LOCK, WorkspaceLease, remove_leftovers
from sessions.storage import ArrayFiles

LEFT = (
    *"arrays/ab/.tmp1234.part drafts/.key.1234/object.urdf uploads/01/.a.obj.part".split(),
    *"cache/.key.xyz/meta.json cache/shapes/.key.12.npz collision/.key.12.npz".split(),
    *"scenes/.a-1.12/object.json assets/.door-1.123456/object.urdf".split(),
    *"uploads/.kitchen-1.12/a/object.urdf thumbnails/.key.12.webp thumbnails/key.12.part".split(),
    *"crops/01/.door.12.glb exports/.12/object.urdf learned/.3.12/record.json".split(),
    *"releases/.kitchen-1.12/release.json storage/.door-1.12 scenes/report-1/.room.12.html".split(),
    "scenes/saved-1/.summary.12.json",
)
KEPT = (*"drafts/key/object.urdf uploads/01/a.obj assets/door-1/object.urdf artiworld.db".split(),)
SECOND = "uploads/02/.oven_2"
"""A second annotation's source, of an object whose name begins with a dot."""


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    for name in (*LEFT, *KEPT):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")
    (tmp_path / "uploads" / "02").mkdir()
    (tmp_path / "uploads" / "02" / ".oven_2").symlink_to(tmp_path / "artiworld.db")
    return tmp_path


def there(workspace: Path, names: tuple[str, ...]) -> list[bool]:
    return [(workspace / name).exists() for name in names]


def test_a_lone_server_removes_what_is_unfinished_and_nothing_else(workspace: Path) -> None:
    ref = ArrayFiles(workspace / "arrays").put(np.arange(5))
    WorkspaceLease(workspace).close()
    assert not any(there(workspace, LEFT)) and all(there(workspace, (*KEPT, SECOND)))
    assert (ArrayFiles(workspace / "arrays").get(ref) == np.arange(5)).all()


def test_nothing_is_removed_while_another_server_runs(workspace: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from app.server.ending import WorkspaceLease; "
        "lease = WorkspaceLease(Path(sys.argv[1])); print('held', flush=True); sys.stdin.read()"
    )
    words, pipe = [sys.executable, "-c", code, str(workspace)], subprocess.PIPE
    other = subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True)
    assert other.stdout is not None and other.stdout.readline() == "held\n"
    (workspace / LEFT[0]).write_text("being written")
    mine = WorkspaceLease(workspace)
    assert (workspace / LEFT[0]).exists()
    other.kill()
    other.wait()
    WorkspaceLease(workspace)  # mine still runs
    assert (workspace / LEFT[0]).exists()
    mine.close()
    WorkspaceLease(workspace).close()
    assert not (workspace / LEFT[0]).exists()


def test_an_asset_whose_replacement_was_cut_off_is_put_back(tmp_path: Path) -> None:
    assets = tmp_path / "assets"
    old = assets / ".oven-3.0123456789ab.old"
    old.mkdir(parents=True)
    (old / "provenance.json").write_text("{}")
    (assets / ".oven-3.0123456789ab").mkdir()
    remove_leftovers(tmp_path)
    assert [p.name for p in assets.iterdir()] == ["oven-3"]
    assert (assets / "oven-3" / "provenance.json").exists()


def test_a_workspace_that_cannot_be_locked_is_used_as_it_is(workspace: Path) -> None:
    (workspace / LOCK).mkdir()  # as if nothing could be written there
    WorkspaceLease(workspace).close()
    assert all(there(workspace, LEFT))
