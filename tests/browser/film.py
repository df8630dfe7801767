"""Moving pictures of the page: frames by screenshots, with the pointer and a caption drawn in."""

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont

WIDTH = 900
"""Pixels of a frame; the page is scaled down to it."""
QUALITY = 72
"""WebP's, 0..100: text stays readable, a minute stays below two megabytes."""
_POINTER = ((0, 0), (0, 17), (4, 13), (7, 20), (10, 19), (7, 12), (13, 12))
_LONGEST = 300_000.0
"""Milliseconds for one screenshot of a busy machine."""
_SETTLED = 350
"""Milliseconds that a page without a GPU takes to draw a change."""


@dataclass
class Film:
    """Frames of one page and how long each is shown."""

    page: Any
    frames: list[Image.Image] = field(default_factory=list)
    milliseconds: list[int] = field(default_factory=list)

    def take(
        self,
        caption: str,
        milliseconds: int,
        pointer: tuple[float, float] | None = None,
        *,
        pressed: bool = False,
    ) -> None:
        """Add the page as it is.

        Args:
            caption: a line below the page.
            pointer: where the mouse is, in pixels of the page. pressed: whether it clicks.
        """
        self.page.wait_for_timeout(_SETTLED)
        shot = Image.open(io.BytesIO(self.page.screenshot(timeout=_LONGEST))).convert("RGB")
        scale = WIDTH / shot.width
        page = shot.resize((WIDTH, round(shot.height * scale)), Image.Resampling.LANCZOS)
        frame = Image.new("RGB", (WIDTH, page.height + 34), "#16202c")
        frame.paste(page)
        draw = ImageDraw.Draw(frame)
        if pointer is not None:
            x, y = (scale * v for v in pointer)
            if pressed:
                draw.ellipse((x - 13, y - 13, x + 13, y + 13), outline="#c0392b", width=3)
            draw.polygon([(x + a, y + b) for a, b in _POINTER], fill="black", outline="white")
        draw.text((14, page.height + 7), caption, fill="white", font=ImageFont.load_default(17))
        self.frames.append(frame)
        self.milliseconds.append(milliseconds)

    def save(self, path: Path) -> None:
        """Write it as an animated WebP that repeats for ever."""
        first, *others = self.frames
        film = {"save_all": True, "append_images": others, "duration": self.milliseconds}
        first.save(path, loop=0, quality=QUALITY, method=6, **film)
