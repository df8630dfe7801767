from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _in_temporary_folder(tmp_path_factory, monkeypatch):
    """MuJoCo writes its warnings into a file of the working folder."""
    monkeypatch.chdir(tmp_path_factory.mktemp("cwd"))
