"""Session states to JSON and back. The format carries its version.

The documents of a session share most values, so a written state holds each value once, and of each
document only its difference from the one before.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from model.core import codec
from model.core.articulated_object import Prediction
from model.core.errors import StoreError
from model.core.tree import KinematicTree
from model.segmentation.prompts import Click
from sessions.document import (
    Document,
    PartInfo,
    RegionRef,
    ReviewRecord,
    SavedRecord,
    SegmentationRecord,
)
from sessions.state import SessionState

VERSION = 1

_VALUES: Mapping[str, type[Any]] = {
    "click": Click,
    "region": RegionRef,
    "part": PartInfo,
    "segmentation": SegmentationRecord,
    "prediction": Prediction,
    "tree": KinematicTree,
    "review": ReviewRecord,
    "saved": SavedRecord,
}
"""Tag → class of the values that documents share."""
_TAGS = {cls: tag for tag, cls in _VALUES.items()}

_SHARED = ("segmentation", "prediction", "tree", "review", "saved")
_PLAIN = tuple(
    f.name for f in dataclasses.fields(Document) if f.name not in (*_SHARED, "prompts", "parts")
)


def state_to_json(state: SessionState) -> dict[str, Any]:
    """Return ``state`` with its past and future as a dict."""
    shared = _Shared()
    documents: list[dict[str, Any]] = []
    before = Document()
    for document in (*state.past, state.present, *state.future):
        documents.append(_difference(document, before, shared))
        before = document
    return {
        "version": VERSION,
        "seq": state.seq,
        "past": len(state.past),
        "opened": state.opened,
        "documents": documents,
        "values": shared.written,
    }


def state_from_json(data: object) -> SessionState:
    """Return the state that :func:`state_to_json` wrote.

    Raises:
        StoreError: where it is malformed, or of a newer version.
    """
    fields = _check_version(data)
    try:
        values = [_value(item, i) for i, item in enumerate(fields["values"])]
        documents: list[Document] = []
        before = Document()
        for i, item in enumerate(fields["documents"]):
            before = _changed(before, item, values, f"state.documents[{i}]")
            documents.append(before)
        past, seq = int(fields["past"]), int(fields["seq"])
        former, future = tuple(documents[:past]), tuple(documents[past + 1 :])
        opened = int(fields.get("opened", 0))  # which earlier versions lack
        return SessionState(documents[past], former, future, seq, opened)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise StoreError(f"the written state is damaged: {error!r}") from error


def _check_version(data: object) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise StoreError(f"a written state must be an object, got {str(data)[:80]!r}")
    version = data.get("version")
    if isinstance(version, int) and version > VERSION:
        raise StoreError(
            f"the state has format {version}, this version of ArtiWorld reads up to {VERSION}; "
            "use the newer version that wrote it"
        )
    if version != VERSION:
        raise StoreError(f"the state has no format that ArtiWorld knows: {version!r}")
    return data


class _Shared:
    """Values that several documents hold, each written once."""

    def __init__(self) -> None:
        self.written: list[list[Any]] = []
        self._index: dict[int, int] = {}

    def ref(self, value: Any) -> int | None:
        """Return its index in ``written``; None for None. The documents keep the objects alive."""
        if value is None:
            return None
        index = self._index.get(id(value))
        if index is None:
            index = self._index[id(value)] = len(self.written)
            tag = _TAGS[type(value)]
            self.written.append([tag, codec.write(value, tag)])
        return index


def _difference(document: Document, before: Document, shared: _Shared) -> dict[str, Any]:
    out: dict[str, Any] = {}
    kept = _common(before.prompts, document.prompts)
    if kept < max(len(before.prompts), len(document.prompts)):
        out["prompts"] = [kept, [shared.ref(p) for p in document.prompts[kept:]]]
    if document.parts is not before.parts:
        out["parts"] = [shared.ref(p) for p in document.parts]
    for name in _SHARED:
        value = getattr(document, name)
        if value is not getattr(before, name):
            out[name] = shared.ref(value)
    for name in _PLAIN:
        value = getattr(document, name)
        if value != getattr(before, name):
            out[name] = codec.write(value, name)
    return out


def _common(a: tuple[Any, ...], b: tuple[Any, ...]) -> int:
    """Return the length of the common prefix."""
    shorter = min(len(a), len(b))
    if a[:shorter] == b[:shorter]:  # the usual case, far faster than a loop
        return shorter
    return next(i for i in range(shorter) if a[i] != b[i])


def _value(item: Any, index: int) -> Any:
    tag, data = item
    return codec.read(_VALUES[tag], data, f"state.values[{index}]")


def _changed(before: Document, item: Mapping[str, Any], values: list[Any], where: str) -> Document:
    plain = {k: v for k, v in item.items() if k not in (*_SHARED, "prompts", "parts")}
    out = codec.read_fields(Document, plain, where)
    if "prompts" in item:
        kept, refs = item["prompts"]
        out["prompts"] = before.prompts[:kept] + tuple(values[i] for i in refs)
    if "parts" in item:
        out["parts"] = tuple(values[i] for i in item["parts"])
    for name in _SHARED:
        if name in item:
            out[name] = None if item[name] is None else values[item[name]]
    return dataclasses.replace(before, **out)
