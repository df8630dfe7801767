"""Run coacd in its own process: it may crash and can't be interrupted.

``python -m model.physics.collision.coacd_process IN.npz OUT.npz PARENT`` reads ``vertices``,
``faces`` and ``options`` (JSON), writes ``count`` and the vertices of each hull, and ends with the
process PARENT.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from model.core.mesh import Mesh
from model.core.shapes import FloatArray, Hull, hull_of
from model.core.threads import die_with_parent


def coacd_installed() -> bool:
    """True if coacd (``artiworld[collision]``) is installed."""
    return find_spec("coacd") is not None


def coacd_hulls(mesh: Mesh, seconds: float, **options: Any) -> list[Hull] | None:
    """Decompose a mesh by CoACD (Wei et al., 2022); None where it fails or takes too long.

    Args:
        seconds: time limit of the process.
        options: of ``coacd.run_coacd``.
    """
    root = str(Path(__file__).resolve().parents[3])
    with tempfile.TemporaryDirectory(prefix="artiworld-") as folder:
        source, target = Path(folder, "in.npz"), Path(folder, "out.npz")
        np.savez(source, vertices=mesh.vertices, faces=mesh.faces, options=json.dumps(options),
                 seconds=math.ceil(seconds))  # fmt: skip
        paths = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        try:
            subprocess.run(
                [sys.executable, "-m", __name__, str(source), str(target), str(os.getpid())],
                timeout=seconds, check=True, stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": paths},
            )  # fmt: skip
            with np.load(target, allow_pickle=False) as data:
                corners: list[FloatArray] = [data[f"{i}"] for i in range(int(data["count"]))]
        except (subprocess.SubprocessError, OSError):
            return None
    return [h for points in corners if (h := hull_of(points)) is not None] or None


def main(source: str, target: str, parent: str) -> None:
    """Run in the child process."""
    die_with_parent(int(parent))
    import coacd  # type: ignore[import-not-found]

    coacd.set_log_level("off")
    with np.load(source, allow_pickle=False) as data:
        signal.alarm(int(data["seconds"]) + 1)  # in case the parent was killed meanwhile
        mesh = coacd.Mesh(data["vertices"], data["faces"])
        found = coacd.run_coacd(mesh, **json.loads(str(data["options"])))
    corners = {str(i): np.asarray(vertices) for i, (vertices, _) in enumerate(found)}
    np.savez(target, count=len(found), **corners)  # type: ignore[arg-type]


if __name__ == "__main__":
    main(*sys.argv[1:])
