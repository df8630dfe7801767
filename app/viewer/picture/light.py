"""The light of a tab, with or without reflections, its theme, and light in the surface with lines
along the edges of objects without a texture.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import viser

from app.server.display_tasks import LitMesh, OpenedAsset, lit_mesh
from app.server.jobs import Job
from app.server.open_object import OpenObject
from app.server.page import call_page
from app.viewer.panels.widgets import Presses
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.picture.stage import GRID, LIGHT_ROOT, SCENE_ROOT, set_backdrop
from app.viewer.tab import Tab
from app.viewer.words import common as words
from app.viewer.words import keys

_PRIORITY: Final = -1
"""After all that a person waits for."""
_EDGE_COLOR: Final = (38, 42, 48)
_EDGE_PIXELS: Final = 1.2


class SurfaceDetail:
    """Surface detail of the open object in one tab; workers compute it after the first drawing.

    Attributes:
        edges_on: whether edges are drawn.
    """

    def __init__(self, tab: Tab, picture: ObjectPicture) -> None:
        self._tab, self._picture = tab, picture
        self.edges_on = True
        self._asset: OpenedAsset | None = None
        self._lit: LitMesh | None = None
        self._shown = False
        self._key: Any = None

    @property
    def lit(self) -> bool:
        """True if the light in the surface is drawn."""
        return self._shown

    def draw(self, obj: OpenObject, moving: bool) -> None:
        """Bring light and edges up to date."""
        asset = obj.asset
        if asset is not self._asset:
            self._asset, self._lit, self._shown, self._key = asset, None, False, None
            if asset is not None and asset.glb is not None:
                job = obj.lane.geometry.submit(lit_mesh, asset.folder, priority=_PRIORITY)
                job.add_done_callback(lambda done: self._done(done, asset))
        if self._lit is None:
            return
        if not self._shown:
            self._shown = True
            self._picture.show_lit(self._lit.glb, self._lit.glb_order)
        self._draw_edges(obj, self._lit, moving)

    def _done(self, job: Job[LitMesh | None], asset: OpenedAsset) -> None:
        if job.error is None:  # without it, the picture stays as it is
            self._tab.act(lambda: self._take(job.result(0), asset))

    def _take(self, lit: LitMesh | None, asset: OpenedAsset) -> None:
        if asset is self._asset:
            self._lit = lit
            self._tab.invalidate()

    def _draw_edges(self, obj: OpenObject, lit: LitMesh, moving: bool) -> None:
        hidden, labels = self._tab.selection.hidden, obj.labels
        key = (self.edges_on, moving, hidden, id(labels), id(self._picture.parts.payloads))
        if key == self._key:
            return
        self._key = key
        scene, edges = self._tab.client.scene, lit.edges
        of_edge = None if labels is None else labels[edges.face]
        shown = np.full(len(edges.face), self.edges_on)
        if of_edge is not None:
            shown &= ~np.isin(of_edge, list(hidden))
        names: dict[str, Any] = {"/edges": shown & (not moving)}
        for part in self._picture.parts.drawn:
            mine = shown & moving if of_edge is None else shown & moving & (of_edge == part)
            names[f"/part/{part}/edges"] = mine
        with self._tab.client.atomic():
            for name, which in names.items():
                if which.any():
                    scene.add_line_segments(
                        name,
                        edges.points[which],
                        _EDGE_COLOR,
                        thickness=_EDGE_PIXELS,
                        thickness_units="screen",
                    )
                elif scene.get_handle_by_name(name) is not None:
                    scene.remove_by_name(name)


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
        self._edges = tab.client.gui.add_checkbox(keys.EDGES, True, hint=keys.EDGES_HINT)
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
