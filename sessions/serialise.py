"""Session states and kinematic values to JSON and back. Every format carries its version.

The past of a session shares nearly everything with its present, so a written state holds each
value once, and each document says only how its prompts differ from those before.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from model.errors import StoreError
from model.kinematics.articulated_object import Prediction
from model.kinematics.joint import Joint
from model.kinematics.tree import KinematicTree
from model.segmentation.prompts import Click
from sessions import codec
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

T = TypeVar("T")

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


def joint_to_json(joint: Joint) -> dict[str, Any]:
    """``joint`` as a dict."""
    return _versioned(joint)


def joint_from_json(data: object) -> Joint:
    """The joint that :func:`joint_to_json` wrote.

    Raises:
        StoreError: naming the field and the value, or the newer version.
    """
    return _unversioned(Joint, data, "joint")


def tree_to_json(tree: KinematicTree) -> dict[str, Any]:
    """``tree`` as a dict."""
    return _versioned(tree)


def tree_from_json(data: object) -> KinematicTree:
    """The tree that :func:`tree_to_json` wrote. Errors as :func:`joint_from_json`."""
    return _unversioned(KinematicTree, data, "tree")


def prediction_to_json(prediction: Prediction) -> dict[str, Any]:
    """``prediction`` as a dict."""
    return _versioned(prediction)


def prediction_from_json(data: object) -> Prediction:
    """What :func:`prediction_to_json` wrote. Errors as :func:`joint_from_json`."""
    return _unversioned(Prediction, data, "prediction")


def document_to_json(document: Document) -> dict[str, Any]:
    """``document`` as a dict."""
    return state_to_json(SessionState(document))


def document_from_json(data: object) -> Document:
    """What :func:`document_to_json` wrote. Errors as :func:`joint_from_json`."""
    return state_from_json(data).present


def state_to_json(state: SessionState) -> dict[str, Any]:
    """``state`` with its past and future as a dict."""
    shared = _Shared()
    documents: list[dict[str, Any]] = []
    before: Sequence[Any] = ()
    for document in (*state.past, state.present, *state.future):
        documents.append(_document(document, before, shared))
        before = document.prompts
    return {
        "version": VERSION,
        "seq": state.seq,
        "past": len(state.past),
        "documents": documents,
        "values": shared.written,
    }


def state_from_json(data: object) -> SessionState:
    """The state that :func:`state_to_json` wrote.

    Raises:
        StoreError: naming what is wrong with it, or the newer version.
    """
    fields = _check_version(data, "state")
    try:
        values = [_value(item, i) for i, item in enumerate(fields["values"])]
        documents: list[Document] = []
        prompts: tuple[Any, ...] = ()
        for i, item in enumerate(fields["documents"]):
            documents.append(_read_document(item, prompts, values, f"state.documents[{i}]"))
            prompts = documents[-1].prompts
        past, seq = int(fields["past"]), int(fields["seq"])
        return SessionState(
            documents[past], tuple(documents[:past]), tuple(documents[past + 1 :]), seq
        )
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise StoreError(f"the written state is damaged: {error!r}") from error


def _versioned(value: Any) -> dict[str, Any]:
    return {"version": VERSION, **codec.write(value, _name(value))}


def _unversioned(kind: type[T], data: object, what: str) -> T:
    fields = _check_version(data, what)
    try:
        return codec.read(kind, {k: v for k, v in fields.items() if k != "version"}, what)
    except codec.CodecError as error:
        raise StoreError(str(error)) from error


def _check_version(data: object, what: str) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise StoreError(f"a written {what} must be an object, got {str(data)[:80]!r}")
    version = data.get("version")
    if isinstance(version, int) and version > VERSION:
        raise StoreError(
            f"the {what} has format {version}, this version of ArtiWorld reads up to {VERSION}; "
            "use the newer version that wrote it"
        )
    if version != VERSION:
        raise StoreError(f"the {what} has no format that ArtiWorld knows: {version!r}")
    return data


def _name(value: Any) -> str:
    return type(value).__name__.lower()


class _Shared:
    """Values that several documents hold, each written once."""

    def __init__(self) -> None:
        self.written: list[list[Any]] = []
        self._index: dict[int, int] = {}

    def ref(self, value: Any) -> int | None:
        """Its place in ``written``; None for None. The documents keep the objects alive."""
        if value is None:
            return None
        index = self._index.get(id(value))
        if index is None:
            index = self._index[id(value)] = len(self.written)
            tag = _TAGS[type(value)]
            self.written.append([tag, codec.write(value, tag)])
        return index


def _document(document: Document, before: Sequence[Any], shared: _Shared) -> dict[str, Any]:
    kept = 0
    for a, b in zip(before, document.prompts, strict=False):
        if a is not b:
            break
        kept += 1
    out: dict[str, Any] = {
        "kept": kept,
        "prompts": [shared.ref(p) for p in document.prompts[kept:]],
        "parts": [shared.ref(p) for p in document.parts],
    }
    out |= {name: shared.ref(getattr(document, name)) for name in _SHARED}
    return out | {name: codec.write(getattr(document, name), name) for name in _PLAIN}


def _value(item: Any, index: int) -> Any:
    tag, data = item
    return codec.read(_VALUES[tag], data, f"state.values[{index}]")


def _read_document(
    item: dict[str, Any], before: tuple[Any, ...], values: list[Any], where: str
) -> Document:
    fields = dict(item)
    own: dict[str, Any] = {
        "prompts": before[: fields.pop("kept")] + tuple(values[i] for i in fields.pop("prompts")),
        "parts": tuple(values[i] for i in fields.pop("parts")),
    }
    for name in _SHARED:
        ref = fields.pop(name, None)
        if ref is not None:
            own[name] = values[ref]
    return dataclasses.replace(codec.read(Document, fields, where), **own)
