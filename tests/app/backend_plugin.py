"""A predictor as a plug-in package that dawdles, fails or crashes by the object's name."""

from __future__ import annotations

from pathlib import Path

ENTRY_POINTS = "[artiworld.predictors]\nmoody = moody:Moody\n"
MODULE = """
import os, time
from pathlib import Path
from model.core.errors import GeometryError
from model.prediction.geometric.predictor import GeometricPredictor
from model.core.progress import Cancelled, no_progress

LOG = Path(os.environ["MOODY_LOG"])
GO = LOG.with_name("go")  # what is held goes on once this file is there


def note(text):
    with LOG.open("a") as file:
        file.write(text + "\\n")


class Moody:
    name = "moody"

    def predict(self, segmented, *, locked=(), seed=0, progress=no_progress):
        mood, _, seconds = segmented.name.partition(" ")
        if mood == "picky":
            raise GeometryError("part link_0 is not to my taste")
        if mood == "broken":
            raise ValueError("a bug")
        if mood == "crash":
            os._exit(3)
        if mood in ("slow", "held"):
            note("begin")
            over = time.monotonic() + float(seconds)
            try:
                while time.monotonic() < over and not (mood == "held" and GO.exists()):
                    progress(0.5, "Dawdling")
                    time.sleep(0.02)
            except Cancelled:
                note("cancelled")
                raise
            note("end")
        return GeometricPredictor().predict(
            segmented, locked=locked, seed=seed, progress=progress
        )
"""


def install(folder: Path) -> Path:
    """Lay the package down in ``folder``, which then belongs on the path of Python."""
    info = folder / "moody-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: moody\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    (folder / "moody.py").write_text(MODULE)
    return folder
