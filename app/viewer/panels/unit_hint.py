"""An object of an unlikely size: the question, and a button that sets the unit."""

from __future__ import annotations

from app.server.open_object import OpenObject
from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.words.annotate import set_unit
from model.geometry.units import UNITS, OddSize, odd_size
from sessions import commands as cmd


class UnitHint:
    """A button that is there only where the size is odd and nothing was clicked yet."""

    def __init__(self, tab: Tab) -> None:
        self._tab = tab
        self._odd: OddSize | None = None
        self._button = tab.client.gui.add_button("", color="gray", visible=False)
        self._button.on_click(lambda _: tab.act(self._set))

    def draw(self, obj: OpenObject) -> str | None:
        """Bring the button up to date; the question, or None."""
        asset, doc = obj.asset, obj.document
        untouched = not doc.prompts and doc.left_out is None and doc.placement is None
        self._odd = odd_size(asset.bounds, asset.unit_scale) if asset and untouched else None
        unit = None if self._odd is None else self._odd.unit
        put(self._button, "visible", unit is not None)
        if unit is not None:
            put(self._button, "label", set_unit(unit))
        return None if self._odd is None else self._odd.question

    def _set(self) -> None:
        obj = self._tab.selection.need_object()
        if self._odd is not None and self._odd.unit is not None and obj.asset is not None:
            self._tab.do(cmd.SetFrame(obj.asset.up_axis, UNITS[self._odd.unit]))
            obj.ensure_open()
