"""The light of a tab, with or without reflections, and its theme, light or dark."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from app.server.pointer_messages import call_page
from app.viewer.panels.markup import Presses
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.picture.stage import GRID, LIGHT_ROOT, SCENE_ROOT, set_backdrop
from app.viewer.picture.surface_detail import SurfaceDetail
from app.viewer.tab import Tab
from app.viewer.words import common as words
from app.viewer.words import view

PLAIN = "plain"
"""Stored in the browser where there are no reflections."""
_ABOVE, _BESIDE = (0.0, 0.0, 1.0), (-2.0, -3.0, 2.0)
"""From where sky and lamp shine on the origin."""


class LightSwitch:
    """Checkboxes for the light of one tab and for edges."""

    def __init__(self, tab: Tab, detail: SurfaceDetail, remember: Callable[[], None]) -> None:
        """Make the checkboxes; ``remember`` is called once the light was switched."""
        self._tab, self._remember = tab, remember
        self._lamps: list[viser.SceneNodeHandle] = []
        self._box = tab.client.gui.add_checkbox(
            words.SIMPLE_LIGHT,
            False,
            hint=words.SIMPLE_LIGHT_HINT,
        )
        self._box.on_update(lambda _: tab.act(self._switched))
        self._edges = tab.client.gui.add_checkbox(view.EDGES, True, hint=view.EDGES_HINT)
        tab.on_update(self._edges, lambda: self._show_edges(detail))

    @property
    def plain(self) -> bool:
        """True if there are no reflections."""
        return self._box.value

    @plain.setter
    def plain(self, plain: bool) -> None:
        self._box.value = plain  # this triggers the same callback as a click

    def _switched(self) -> None:
        self._light(self.plain)
        self._remember()

    def _show_edges(self, detail: SurfaceDetail) -> None:
        detail.edges_on = self._edges.value
        self._tab.invalidate()

    def _light(self, plain: bool) -> None:
        """Plainly, or by viser's own map of surroundings.

        Looking up surroundings takes most of a frame's time where a processor draws it.
        """
        scene = self._tab.client.scene
        for lamp in self._lamps:
            lamp.remove()
        self._lamps = []
        scene.configure_environment_map(None if plain else "warehouse")
        if plain:
            self._lamps = [
                scene.add_light_hemisphere(
                    f"{LIGHT_ROOT}/sky",
                    ground_color=(190, 180, 170),
                    intensity=1.9,
                    position=_ABOVE,
                ),
                scene.add_light_directional(
                    f"{LIGHT_ROOT}/lamp", color=(255, 250, 244), intensity=0.9, position=_BESIDE
                ),
            ]


class Theme:
    """Light or dark, as the browser's system has it."""

    def __init__(
        self, tab: Tab, presses: Presses, pictures: tuple[ObjectPicture | ScenePicture, ...]
    ) -> None:
        self._tab, self._pictures = tab, pictures
        self._set("light")
        presses.on("theme", self._set)
        call_page(tab.client, "Markup.theme")  # it answers, and again when it changes

    def _set(self, theme: str) -> None:
        dark = theme == "dark"
        self._tab.client.gui.configure_theme(
            show_logo=False, show_share_button=False, dark_mode=dark
        )
        scene = self._tab.client.scene
        set_backdrop(scene, dark=dark)
        for picture in self._pictures:
            picture.dark = dark
        for name in ("/ground", f"{SCENE_ROOT}/ground"):
            floor: Any = scene.get_handle_by_name(name)
            if floor is not None:
                floor.cell_color, floor.section_color = GRID[dark]
