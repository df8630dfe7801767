"""Light, backdrop and camera."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
import viser

from model.geometry.crop import ROOM_METRES

FIELD_OF_VIEW = 0.7
FLAT_VIEW = 0.05
"""Radians: the field of view, from so much farther away, that hardly has perspective; viser's page
has no orthographic camera."""
SCENE_ROOT = "/world"
"""Node above all that belongs to a scene around the object."""
_LIGHT = (222.0, 228.0, 236.0), (243.0, 244.0, 246.0)
_DARK = (58.0, 64.0, 72.0), (36.0, 39.0, 44.0)
"""RGB of the backdrop at its top and its bottom."""
_FLAT_NEAR = 0.01, 0.5
"""Share of the distance, and metres at most: from far away depths stay exact, and viser's backdrop,
which is one metre away, is not cut off."""
LIGHT_ROOT = "/light"
"""Node above the lights that the user chose."""


def set_stage(scene: viser.SceneApi) -> None:
    """Light of the picture."""
    scene.configure_default_lights(cast_shadow=False)


def set_backdrop(scene: viser.SceneApi, *, dark: bool) -> None:
    """A soft vertical gradient, so that white scans stand out, and black ones in the dark."""
    t = np.linspace(0.0, 1.0, 128)[:, None, None]
    top, bottom = _DARK if dark else _LIGHT
    image = np.array(top) + t * (np.array(bottom) - top)
    scene.set_background_image(np.repeat(image, 4, axis=1).astype(np.uint8), format="png")


GRID: Final[dict[bool, tuple[tuple[int, int, int], ...]]] = {
    False: ((205, 210, 216), (184, 190, 198)),
    True: ((66, 71, 79), (84, 90, 99)),
}
"""Colors of cells and sections of the floor, by whether it is dark."""


def add_ball(
    scene: viser.SceneApi, name: str, place: Any, radius: float, color: Any, opacity: Any = None
) -> viser.IcosphereHandle:
    """Draw a ball without shadows at ``place`` (3,); ``radius`` in metres."""
    return scene.add_icosphere(
        name,
        radius=radius,
        color=color,
        subdivisions=2,
        opacity=opacity,
        position=place,
        cast_shadow=False,
        receive_shadow=False,
    )


def add_floor(
    scene: viser.SceneApi, name: str, span: float, place: Any, wxyz: Any, *, fade: float, dark: bool
) -> None:
    """Draw the grid below something as wide as ``span``; ``fade`` times that it is gone."""
    cell = float(10.0 ** np.floor(np.log10(span)) / 2)
    grid = scene.add_grid(
        name,
        width=4 * span,
        height=4 * span,
        position=place,
        wxyz=wxyz,
        cell_size=cell,
        section_size=2 * cell,
        cell_color=GRID[dark][0],
        section_color=GRID[dark][1],
        infinite_grid=True,
        fade_distance=fade * span,
    )
    # viser sends no default pose, and the page keeps that of the node it replaces.
    grid.wxyz = -np.asarray(wxyz)


def may_be_a_room(bounds: npt.NDArray[np.floating]) -> bool:
    """True if (2, 3) bounds in metres may be a room's: a row of cabinets is not as deep."""
    return bool(np.ptp(bounds[:, :2], axis=0).min() > ROOM_METRES)


def view_direction(front: npt.ArrayLike, aside: float = 0.5, above: float = 0.45) -> Any:
    """(3,) unit direction from an object to the camera: its front, moved aside and above by these
    shares."""
    ahead = np.asarray(front, np.float64)
    direction = ahead + aside * np.cross(ahead, (0.0, 0.0, 1.0)) + np.array([0.0, 0.0, above])
    return direction / np.linalg.norm(direction)


def fitting_distance(camera: viser.CameraHandle, size: float) -> float:
    """Metres from which a ball of that diameter fills the picture."""
    aspect = max(min(camera.aspect or 1.5, 2.5), 0.4)
    lens = _lens(camera)
    half = min(lens / 2, np.arctan(np.tan(lens / 2) * aspect))
    return float(0.5 * size / np.sin(half))


def aim(
    client: viser.ClientHandle,
    position: npt.NDArray[Any],
    look_at: npt.NDArray[Any],
    *,
    least_near: float,
    least_far: float = 0.0,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> None:
    """Put the camera somewhere, upright; its clipping planes, in metres, go with the distance."""
    camera = client.camera
    distance = float(np.linalg.norm(position - look_at))
    lens = _lens(camera)
    near = 1e-3 * distance
    if lens == FLAT_VIEW:
        near = min(_FLAT_NEAR[0] * distance, _FLAT_NEAR[1])
    with client.atomic():
        camera.fov = lens
        camera.up_direction = up
        camera.position = position
        camera.look_at = look_at  # after the position, which carries the old one along
        camera.near = max(near, least_near)
        camera.far = max(distance * 100, least_far)


def _lens(camera: viser.CameraHandle) -> float:
    """The field of view that is used now, radians."""
    return FLAT_VIEW if camera.fov <= FLAT_VIEW * 1.01 else FIELD_OF_VIEW


def toggle_flat(client: viser.ClientHandle) -> bool:
    """Change between perspective and a picture hardly with any; what is looked at stays as large.

    Returns:
        Whether it is flat now.
    """
    camera = client.camera
    before = _lens(camera)
    now = FIELD_OF_VIEW if before == FLAT_VIEW else FLAT_VIEW
    look_at, away = np.asarray(camera.look_at), np.asarray(camera.position - camera.look_at)
    farther = float(np.tan(before / 2) / np.tan(now / 2))
    camera.fov = now
    up = tuple(float(v) for v in camera.up_direction)
    aim(client, look_at + farther * away, look_at, least_near=1e-4, up=up)  # type: ignore[arg-type]
    return now == FLAT_VIEW
