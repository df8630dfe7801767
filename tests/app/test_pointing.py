"""What a click or a drag means, as tools follow one another."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from app.server.open_object import OpenObject
from app.viewer.input.pointing import Pointing
from app.viewer.tab import Selection
from sessions.store import Store


def make_tab(**selected: Any) -> Any:
    """A tab without a browser."""
    tab: Any = SimpleNamespace(asked=[], invalidate=lambda: None, say=lambda text: None)
    tab.notify = lambda *said: tab.asked.append(said)
    selection = Selection(tab.invalidate, "the queue")
    vars(selection).update(selected)
    tab.selection = selection
    return tab


def test_a_cut_that_was_begun_leaves_no_mark_when_something_is_drawn_instead() -> None:
    marks: list[tuple[Any, ...]] = []
    picture: Any = SimpleNamespace(overlays=SimpleNamespace(show_places=marks.append))
    pointing = Pointing(make_tab(), picture, *[cast(Any, None)] * 2)
    pointing.arm("cut")
    pointing._cut_at((0.0, 0.0, 0.0), 7, (0.0, 1.0, 0.0), True)
    assert marks[-1] == ((0.0, 0.0, 0.0),)
    pointing.set_tool("lasso")
    assert (pointing.tool, pointing.armed, marks[-1]) == ("lasso", "", ())


def test_a_part_is_found_by_points_that_are_not_displayed(tmp_path: Path) -> None:
    """Of a large scan only some points are drawn, but each can be clicked on."""
    store = Store(tmp_path)
    ref = store.put_array(np.array([0, 0, 2, 2, -1], np.int16))
    read: list[str] = []
    whole = store.get_array
    store.get_array = lambda ref: (read.append(ref), whole(ref))[1]  # type: ignore[method-assign]
    obj: Any = SimpleNamespace(
        _stored=None,
        document=SimpleNamespace(segmentation=SimpleNamespace(labels=ref), tree=None),
        services=SimpleNamespace(store=store),
        asset=SimpleNamespace(element=np.array([0, 2])),
        labels=np.array([0, 2], np.int16),
    )
    obj.part_of = partial(OpenObject.part_of, obj)
    tab = make_tab(object=obj)
    asked = tab.asked
    pointing = Pointing(tab, *[cast(Any, None)] * 3)
    pointing.tools.use = lambda request, label: asked.append(request.other)  # type: ignore[method-assign]
    for element in (3, 2, 4):
        pointing._merge_at(element)
    assert asked == [2, 2, 0]
    chosen: list[int | None] = []
    pointing._choose_joint_of = chosen.append  # type: ignore[method-assign]
    pointing._choose_joint_at(3)
    assert chosen == [2]
    assert read == [ref]  # the labels of all points are read once, not for each click
    obj.document.segmentation.labels = store.put_array(np.array([0, 0, 2, 3, -1], np.int16))
    pointing._merge_at(3)
    assert asked[-1] == 3
    obj.document.segmentation = None
    pointing._merge_at(3)
    assert asked[-1][:2] == ("Merge", "No parts yet: click on one first")
    store.close()
