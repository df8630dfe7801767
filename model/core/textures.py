"""Texture images, the other maps of a surface, and sRGB.

Textures are opened within bounds and written back with the bytes that they came from. Maps besides
the colour are normals, emission and occlusion. sRGB is what files and screens have, linear light
what glTF counts in (IEC 61966-2-1).
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

Array = npt.NDArray[Any]


def to_srgb(linear: Array) -> npt.NDArray[np.uint8]:
    """Linear RGB(A), floats in 0..1 or whole numbers, as (N, 4) uint8 sRGB; alpha stays linear."""
    v = linear.astype(np.float64)
    if linear.dtype.kind in "iu":
        v = v / np.iinfo(linear.dtype).max
    v = np.clip(np.nan_to_num(v), 0.0, 1.0)
    rgb = from_linear(v[:, :3])
    alpha = v[:, 3:] if v.shape[1] == 4 else np.ones((len(v), 1))
    return np.rint(255 * np.column_stack([rgb, alpha])).astype(np.uint8)


def from_linear(light: Array) -> npt.NDArray[np.float64]:
    """Linear light, 0 or more, as sRGB; values above 1 are brighter than white."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def to_linear(srgb: Array) -> npt.NDArray[np.float64]:
    """sRGB, 0 or more, as linear light; 1 stays 1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


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
        suffix = _kept(image)
        _spend(image.width * image.height, what)
        has_alpha = "A" in image.getbands() or "transparency" in image.info
        mode = "RGBA" if has_alpha else "RGB"
        image.load()
        if image.mode[0] in "IF":
            image = _eight_bits(image)
        out = image if image.mode == mode else image.convert(mode)  # never two copies
    if suffix:
        setattr(out, _ATTRIBUTE, (data, suffix))
    return out


def _kept(image: Image.Image) -> str | None:
    """Suffix of a file whose bytes are kept: all software shows such an image alike."""
    plain = image.mode[0] not in "IF" and image.mode != "CMYK"
    return _KEPT.get(image.format or "") if plain else None


def _eight_bits(image: Image.Image) -> Image.Image:
    """A grey image of 16 or 32 bits, which Pillow would cut off at 255, without its alpha."""
    grey = np.nan_to_num(np.asarray(image, np.float64))
    most = float(grey.max(initial=0.0))
    scale = 255.0 if image.mode == "F" and most <= 1 else 1 / 257 if most > 255 else 1.0
    if image.mode == "I;16":
        scale = 1 / 257
    return Image.fromarray(np.clip(np.rint(scale * grey), 0, 255).astype(np.uint8))


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
        suffix = _kept(image)
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


@dataclass(frozen=True)
class ImageFile:
    """An image as the file that it is in, as nobody here looks at its pixels; equal files are one.

    Attributes:
        data: a whole PNG or JPEG file.
        suffix: ``.png`` or ``.jpg``.
    """

    data: bytes = field(repr=False)
    suffix: str


@dataclass(frozen=True)
class SurfaceMaps:
    """Maps of a material, which lie on a surface as its colour texture does; as in glTF.

    Attributes:
        normal: directions in tangent space, +y up, or None.
        normal_scale: times the x and y of ``normal``.
        emission: RGB of linear light, 0 or more; above 1 it is brighter than white.
        emissive: times ``emission``, sRGB, or None.
        occlusion: how much light from around gets there, in its red channel, or None.
        occlusion_strength: 0 (none of ``occlusion``) to 1.
    """

    normal: ImageFile | None = None
    normal_scale: float = 1.0
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emissive: ImageFile | None = None
    occlusion: ImageFile | None = None
    occlusion_strength: float = 1.0

    @property
    def images(self) -> tuple[ImageFile, ...]:
        """The images that there are."""
        return tuple(i for i in (self.normal, self.emissive, self.occlusion) if i is not None)


def image_file(data: bytes, what: str) -> ImageFile:
    """The image in ``data``, as it is where it is PNG or JPEG, else as PNG.

    Raises:
        TextureError: where it is no image, truncated, or too large.
    """
    return ImageFile(*checked(data, what))


def open_image_file(path: Path) -> ImageFile:
    """The image in the file ``path``; see :func:`image_file`.

    Raises:
        TextureError: where it is missing or not an image.
    """
    return image_file(texture_bytes(path), f"texture {path.name}")


def holds_normals(image: ImageFile) -> bool:
    """True if it is a normal map: directions away from the surface, not heights in grey."""
    import numpy as np
    from PIL import Image

    small = decode(image.data, "map").convert("RGB")
    small.thumbnail((64, 64), Image.Resampling.NEAREST)  # a mean of directions would be shorter
    pixels = np.asarray(small).reshape(-1, 3).astype(np.float64)
    grey = np.ptp(pixels, axis=1).max() <= 8
    vectors = pixels / 127.5 - 1.0
    length = float(np.median(np.linalg.norm(vectors, axis=1)))
    return not grey and abs(length - 1.0) < 0.2 and float(np.median(vectors[:, 2])) > 0.3
