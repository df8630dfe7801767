"""Texture images: opened within bounds, written back with the bytes that they came from."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from PIL import Image

MAX_PIXELS = 16384 * 16384
"""Most pixels of one image."""
MOST_PIXELS = 1 << 30
"""Most pixels of all textures that one reading keeps, 4 bytes each: 64 images of 4096 x 4096."""
MOST_BYTES = 1 << 30
"""Largest image file."""
_kept_pixels: ContextVar[list[int] | None] = ContextVar("kept pixels", default=None)
_KEPT = {"JPEG": ".jpg", "PNG": ".png"}
_ATTRIBUTE = "artiworld_encoded"


class TextureError(ValueError):
    """An image that can't be used; the message says why."""


def decode(data: bytes, what: str) -> Image.Image:
    """The RGB or RGBA image in ``data``.

    Raises:
        TextureError: where it is no image, truncated, or too large.
    """
    with _readable(what):
        image = _opened(data, what)
        suffix = _KEPT.get(image.format or "")
        _spend(image.width * image.height, what)
        has_alpha = "A" in image.getbands() or "transparency" in image.info
        mode = "RGBA" if has_alpha else "RGB"
        image.load()
        out = image if image.mode == mode else image.convert(mode)  # never two copies
    if suffix:
        setattr(out, _ATTRIBUTE, (data, suffix))
    return out


@contextmanager
def one_reading() -> Iterator[None]:
    """Within the block, all images that are decoded count towards :data:`MOST_PIXELS`."""
    if _kept_pixels.get() is not None:  # within another one
        yield
        return
    token = _kept_pixels.set([0])
    try:
        yield
    finally:
        _kept_pixels.reset(token)


def _spend(pixels: int, what: str) -> None:
    kept = _kept_pixels.get()
    if kept is None:
        return
    if kept[0] + pixels > MOST_PIXELS:
        most = MOST_PIXELS / 1e6
        raise TextureError(f"{what}: with it the textures have more than {most:.0f} million pixels")
    kept[0] += pixels


def checked(data: bytes, what: str) -> tuple[bytes, str]:
    """``(bytes, suffix)`` of an image file: ``data`` itself where it is JPEG or PNG, else PNG.

    Raises:
        TextureError: as :func:`decode`.
    """
    with _readable(what):
        image = _opened(data, what)
        suffix = _KEPT.get(image.format or "")
        if suffix:
            image.load()
            return data, suffix
    return encode(decode(data, what))


def _opened(data: bytes, what: str) -> Image.Image:
    image = Image.open(io.BytesIO(data))
    if image.width * image.height > MAX_PIXELS:
        raise TextureError(f"{what}: {image.width} x {image.height} pixels are too many")
    return image


@contextmanager
def _readable(what: str) -> Iterator[None]:
    """Say in words what makes an image unusable."""
    try:
        yield
    except TextureError:
        raise
    except Image.DecompressionBombError as error:
        raise TextureError(f"{what}: {error}") from None
    # Pillow's decoders raise whatever the damaged header leads to.
    except (OSError, ValueError, SyntaxError, TypeError, KeyError, IndexError, EOFError) as error:
        raise TextureError(f"{what}: not an image that can be read ({error})") from None


def left_out(what: Iterable[str]) -> str:
    """The remark on material properties that aren't kept."""
    return f"left out of its materials: {', '.join(sorted(set(what)))}"


def open_texture(path: Path) -> Image.Image:
    """The image in the file ``path``.

    Raises:
        TextureError: where it is missing or not an image.
    """
    return decode(texture_bytes(path), f"texture {path.name}")


def texture_bytes(path: Path) -> bytes:
    """The content of the file ``path``.

    Raises:
        TextureError: where it can't be read.
    """
    try:
        if path.exists() and not path.is_file():
            raise TextureError(f"texture {path.name}: is not a regular file")
        if path.stat().st_size > MOST_BYTES:
            raise TextureError(f"texture {path.name}: has more than {MOST_BYTES >> 20} MiB")
        return path.read_bytes()
    except OSError as error:
        raise TextureError(f"texture {path.name}: {error.strerror or error}") from None


def encode(image: Image.Image) -> tuple[bytes, str]:
    """``(bytes, suffix)`` of an image file: the original JPEG or PNG where known, else PNG."""
    kept = getattr(image, _ATTRIBUTE, None)
    if kept is not None:
        return kept
    buffer = io.BytesIO()
    image.save(buffer, "PNG", compress_level=3)
    out = (buffer.getvalue(), ".png")
    setattr(image, _ATTRIBUTE, out)
    return out
