"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# Two busy cores: numeric libraries with a thread pool each make tests slower and less even.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real scans and objects that is not part of the project; skips where absent."""
    folder = Path(os.environ.get("ARTIWORLD_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no shared data at {folder} (set ARTIWORLD_SHARED_DATA to its folder)")
    return folder
