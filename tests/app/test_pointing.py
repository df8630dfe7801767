"""What a click or a drag means, as tools follow one another."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from app.server.object_context import ObjectContext
from app.viewer.input.pointing import Pointing
from app.viewer.tab import Selection
from model.core.joint import Joint
from model.core.tree import KinematicTree
from sessions.store import Store


def make_tab(**selected: Any) -> Any:
    """A tab without a browser."""
    tab: Any = SimpleNamespace(asked=[], invalidate=lambda: None, say=lambda text: None)
    tab.notify = lambda *said: tab.asked.append(said)
    selection = Selection(tab.invalidate, "the queue")
    vars(selection).update(selected)
    tab.selection = selection
    return tab


RAY = (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)


class Hits:
    """Stands in for the workers: a ray meets these elements, one after the other, at the origin."""

    def __init__(self, *elements: int) -> None:
        self.elements = iter(elements)

    def pick(self, *_: Any) -> Any:
        return SimpleNamespace(position=np.zeros(3), element=next(self.elements))


def test_a_cut_that_was_begun_leaves_no_mark_when_something_is_drawn_instead() -> None:
    marks: list[tuple[Any, ...]] = []
    picture: Any = SimpleNamespace(overlays=SimpleNamespace(show_places=marks.append))
    tab = make_tab(object=SimpleNamespace(asset=SimpleNamespace()))
    pointing = Pointing(tab, picture, cast(Any, None), Hits(7))
    pointing.arm("cut")
    pointing.click(*RAY, True)
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
    slide = Joint("slide", "prismatic", "link_0", "link_2", (0, -1, 0), (0, 0, 0), 0.0, 0.3)
    document = SimpleNamespace(
        segmentation=SimpleNamespace(labels=ref), tree=KinematicTree(("link_0", "link_2"), (slide,))
    )
    session = SimpleNamespace(state=SimpleNamespace(present=document))
    services: Any = SimpleNamespace(store=store, hub=SimpleNamespace(session=lambda id: session))
    obj: Any = ObjectContext(SimpleNamespace(id=1), services)  # type: ignore[arg-type]
    obj.asset = SimpleNamespace(element=np.array([0, 2]))
    tab = make_tab(object=obj)
    asked = tab.asked
    picture: Any = SimpleNamespace(overlays=SimpleNamespace(show_places=lambda places: None))
    still: Any = SimpleNamespace(q={})
    pointing = Pointing(tab, picture, still, Hits(3, 2, 4, 3, 3, 3))
    pointing.tools.use = lambda request, label: asked.append(request.other)  # type: ignore[method-assign]

    def merge_at_click() -> Any:
        pointing.arm("merge")
        pointing.click(*RAY, True)
        return asked[-1]

    assert [merge_at_click() for _ in range(3)] == [2, 2, 0]
    tab.selection.set_step("Joints")
    pointing.click(*RAY, True)
    assert tab.selection.child == "link_2"
    assert read == [ref]  # the labels of all points are read once, not for each click
    document.segmentation.labels = store.put_array(np.array([0, 0, 2, 3, -1], np.int16))
    assert merge_at_click() == 3
    document.segmentation = None
    assert merge_at_click()[:2] == ("Merge", "No parts yet: click on one first")
    store.close()
