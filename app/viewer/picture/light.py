"""The light of a tab: with reflections, or simple for browsers without a GPU."""

from __future__ import annotations

from collections.abc import Callable

import viser

from app.viewer.picture.stage import LIGHT_ROOT
from app.viewer.tab import Tab
from app.viewer.words import common as words

PLAIN = "plain"
"""Stored in the browser where there are no reflections."""
_ABOVE, _BESIDE = (0.0, 0.0, 1.0), (-2.0, -3.0, 2.0)
"""From where sky and lamp shine on the origin."""


class LightSwitch:
    """A checkbox for the light of one tab."""

    def __init__(self, tab: Tab, remember: Callable[[], None]) -> None:
        """Make the checkbox; ``remember`` is called once it was switched."""
        self._tab, self._remember = tab, remember
        self._lamps: list[viser.SceneNodeHandle] = []
        self._box = tab.client.gui.add_checkbox(
            words.SIMPLE_LIGHT,
            False,
            hint=words.SIMPLE_LIGHT_HINT,
        )
        self._box.on_update(lambda _: tab.act(self._switched))

    @property
    def plain(self) -> bool:
        """Whether there are no reflections."""
        return self._box.value

    @plain.setter
    def plain(self, plain: bool) -> None:
        self._box.value = plain  # this triggers the same callback as a click

    def _switched(self) -> None:
        self._light(self.plain)
        self._remember()

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
