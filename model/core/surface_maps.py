"""Maps of a surface besides its colour: normals, emission, occlusion."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from model.core.textures import checked, decode, texture_bytes


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
