"""How a tab is lit: with reflections of surroundings, or plainly for browsers without a GPU."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

from app.viewer.picture.stage import LIGHT_ROOT

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

PLAIN = "plain"
"""What the browser remembers where there are no reflections."""
_ABOVE, _BESIDE = (0.0, 0.0, 1.0), (-2.0, -3.0, 2.0)
"""From where sky and lamp shine on the origin."""


class LightSwitch:
    """A checkbox for the light of one tab."""

    def __init__(self, app: ClientApp) -> None:
        self._app = app
        self._lamps: list[viser.SceneNodeHandle] = []
        self._box = app.client.gui.add_checkbox(
            "Plain light",
            False,
            hint="No reflections. Moves several times more smoothly where the browser has no GPU",
        )
        self._box.on_update(lambda _: app.act(self._switched))

    @property
    def plain(self) -> bool:
        """Whether there are no reflections."""
        return self._box.value

    @plain.setter
    def plain(self, plain: bool) -> None:
        self._box.value = plain  # which is heard like a click on it

    def _switched(self) -> None:
        self._light(self.plain)
        self._app.remember()

    def _light(self, plain: bool) -> None:
        """Plainly, or by viser's own map of surroundings.

        Looking up surroundings takes most of a frame's time where a processor draws it.
        """
        scene = self._app.client.scene
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
