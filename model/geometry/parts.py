"""Split an asset into its parts: every face or point belongs to exactly one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part
from model.core.asset import Asset
from model.core.errors import GeometryError

BASE = 0
"""The part of unassigned elements."""


def split(
    asset: Asset, labels: npt.NDArray[np.integer], names: Mapping[int, str] | None = None
) -> tuple[Part, ...]:
    """Split ``asset`` by labels, with its textures, colours and normals.

    Args:
        asset: its mesh is split if it has one, else its cloud.
        labels: (E,) part of each element; -1 (unassigned) becomes part 0.
        names: label → name of the part.

    Returns:
        A part ``link_i`` for each label i with elements, ascending. Faces keep their order.

    Raises:
        GeometryError: where the labels don't fit the asset.
    """
    labels = np.asarray(labels)
    if labels.shape != (asset.element_count,) or labels.dtype.kind not in "iu":
        raise GeometryError(
            f"{asset.name}: {asset.element_count} whole labels are needed, one a "
            f"{asset.element_kind}; got {labels.dtype} of shape {labels.shape}"
        )
    if len(labels) and labels.min() < -1:
        raise GeometryError(f"{asset.name}: label {labels.min()} is below -1")
    labels = np.where(labels < 0, BASE, labels)
    names = names or {}
    # One stable sort instead of one scan per part.
    order = np.argsort(labels, kind="stable")
    kept, starts = np.unique(labels[order], return_index=True)
    out = []
    for label, index in zip(kept, np.split(order, starts[1:]), strict=True):
        mesh = None if asset.mesh is None else asset.mesh.take_faces(index)
        cloud = None
        if asset.mesh is None and asset.cloud is not None:
            cloud = asset.cloud.take(index)
        name = names.get(int(label)) or None
        out.append(Part(f"link_{label}", mesh, cloud, name, asset.warnings))
    return tuple(out)
