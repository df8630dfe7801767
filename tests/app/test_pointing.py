"""What a click or a drag means, as tools follow one another."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from app.viewer.pointing import Pointing


def test_a_cut_that_was_begun_leaves_no_mark_when_something_is_drawn_instead() -> None:
    marks: list[tuple[Any, ...]] = []
    app: Any = SimpleNamespace(
        stage="Annotate",
        scene=SimpleNamespace(overlays=SimpleNamespace(show_places=marks.append)),
        invalidate=lambda: None,
    )
    pointing = Pointing(app)
    pointing.arm("cut")
    pointing._cut_at((0.0, 0.0, 0.0), 7, (0.0, 1.0, 0.0), True)
    assert marks[-1] == ((0.0, 0.0, 0.0),)
    pointing.set_tool("lasso")
    assert (pointing.tool, pointing.armed, marks[-1]) == ("lasso", "", ())
