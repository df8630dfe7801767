"""Convert masks between elements and nodes."""

from __future__ import annotations

import numpy as np

from model.core.errors import PromptError
from model.segmentation.arrays import Bool, Int64
from model.segmentation.default import DefaultSession


def to_elements(session: DefaultSession, nodes: Bool) -> Bool:
    """(E,) the elements of the nodes in (N,) ``nodes``."""
    return session.encoding.nodes.elements.to_elements(nodes.astype(np.int16)) > 0


def to_nodes(session: DefaultSession, mask: Bool) -> Bool:
    """(N,) the nodes of the elements in (E,) ``mask``.

    Raises:
        PromptError: if the mask has another length.
    """
    mask = checked(session, mask)
    out = np.zeros(len(session.encoding.nodes), bool)
    out[session.encoding.nodes.elements.nodes_of(np.nonzero(mask)[0])] = True
    return out


def checked(session: DefaultSession, mask: Bool) -> Bool:
    """``mask`` as booleans.

    Raises:
        PromptError: if its length is not the number of elements.
    """
    mask = np.asarray(mask, bool)
    if mask.shape != (session.asset.element_count,):
        raise PromptError(
            f"{session.asset.name}: a mask needs shape ({session.asset.element_count},), "
            f"got {mask.shape}"
        )
    return mask


def first_elements(session: DefaultSession) -> Int64:
    """(N,) one element that each node stands for."""
    elements = session.encoding.nodes.elements
    first = np.zeros(len(session.encoding.nodes), np.int64)
    if len(elements.vote_node):
        first[elements.vote_node] = elements.vote_element
    first[elements.node_of_element[::-1]] = np.arange(len(elements.node_of_element) - 1, -1, -1)
    return first
