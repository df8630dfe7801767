import shutil
import sys
from pathlib import Path

import pytest

from model.core.packages import install_command


def test_install_lines_are_of_the_environment_that_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pip that is not of this environment would look for the package elsewhere, in vain."""
    folder = tmp_path / "my work" / ".venv" / "bin"
    folder.mkdir(parents=True)
    monkeypatch.setattr(sys, "executable", str(folder / "python"))
    monkeypatch.setattr(shutil, "which", lambda _: "/usr/bin/pip")
    monkeypatch.chdir(tmp_path / "my work")
    wanted = "install 'artiworld[physics]' torch"
    assert install_command("artiworld[physics]", "torch") == f".venv/bin/python -m pip {wanted}"
    monkeypatch.chdir(folder.parent / "bin")
    monkeypatch.chdir("/")
    there = install_command("artiworld[physics]", "torch")
    assert there.endswith(f".venv/bin/python' -m pip {wanted}")
    monkeypatch.setattr(shutil, "which", lambda _: str(folder / "pip"))
    assert install_command("artiworld[physics]", "torch") == f"pip {wanted}"
