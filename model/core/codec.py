"""Frozen dataclasses to JSON values and back, driven by their annotations, strictly.

Reading never converts silently: a wrong type, NaN, an unknown or a missing field is a
:class:`CodecError` that names the field and the value.
"""

from __future__ import annotations

import dataclasses
import enum
import math
import types
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from model.core.errors import ArtiworldError

T = TypeVar("T")


class CodecError(ValueError):
    """A value that doesn't fit; the message names the field and the value."""


def write(value: Any, where: str = "value") -> Any:
    """``value`` in dicts, lists, text, numbers and None only.

    Args:
        value: a dataclass, tuple, set, mapping, number, text or None; numpy numbers are taken.
        where: how errors call it.

    Raises:
        CodecError: on NaN, infinity, or a type that JSON can't hold.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, enum.Enum):
        value = value.value
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise CodecError(f"{where}: must be finite, got {value}")
        return value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            f.name: write(getattr(value, f.name), f"{where}.{f.name}")
            for f in dataclasses.fields(value)
        }
    if isinstance(value, Mapping):
        return {str(k): write(v, f"{where}[{k!r}]") for k, v in value.items()}
    if isinstance(value, (set, frozenset)):
        return [write(v, where) for v in sorted(value)]
    if isinstance(value, (tuple, list)):
        return [write(v, f"{where}[{i}]") for i, v in enumerate(value)]
    raise CodecError(f"{where}: {type(value).__name__} can't be written as JSON")


def read(kind: type[T], data: object, where: str = "value") -> T:
    """The value of type ``kind`` that :func:`write` turned into ``data``.

    Fields that are missing take their default where they have one, so that later versions can add
    fields.

    Raises:
        CodecError: naming the field and the value.
    """
    return _read(kind, data, where)


def read_fields(kind: type, data: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The values of some fields of the dataclass ``kind``, without making one.

    Raises:
        CodecError: naming the field and the value.
    """
    fields = _fields(kind)
    unknown = sorted(set(data) - set(fields), key=str)
    if unknown:
        raise CodecError(
            f"{where}: unknown field {unknown[0]!r}; a newer version of ArtiWorld may have written "
            f"it (known: {', '.join(fields)})"
        )
    return {name: _read(fields[name][0], v, f"{where}.{name}") for name, v in data.items()}


def _read(kind: Any, data: Any, where: str) -> Any:
    simple = _SIMPLE.get(kind)
    if simple is not None:
        return simple(data, where)
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return kind(_literal(tuple(m.value for m in kind), data, where))
    origin = get_origin(kind)
    if origin is Literal:
        return _literal(get_args(kind), data, where)
    if origin in (Union, types.UnionType):
        return _optional(get_args(kind), data, where)
    if origin is tuple:
        return _tuple(get_args(kind), data, where)
    if origin is frozenset:
        return frozenset(_tuple((*get_args(kind), ...), data, where))
    if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        return _mapping(get_args(kind), data, where)
    if dataclasses.is_dataclass(kind):
        return _dataclass(kind, data, where)
    raise AssertionError(f"no codec for {kind}")


def _wrong(where: str, expected: str, data: Any) -> CodecError:
    shown = repr(data)
    return CodecError(f"{where}: expected {expected}, got {shown[:80]}")


def _bool(data: Any, where: str) -> bool:
    if not isinstance(data, bool):
        raise _wrong(where, "true or false", data)
    return data


def _int(data: Any, where: str) -> int:
    if isinstance(data, bool) or not isinstance(data, int):
        raise _wrong(where, "a whole number", data)
    return data


def _float(data: Any, where: str) -> float:
    if isinstance(data, bool) or not isinstance(data, (int, float)):
        raise _wrong(where, "a number", data)
    if not -1e308 < data < 1e308:
        raise _wrong(where, "a finite number", data)
    return float(data)


def _str(data: Any, where: str) -> str:
    if not isinstance(data, str):
        raise _wrong(where, "text", data)
    return data


def _none(data: Any, where: str) -> None:
    if data is not None:
        raise _wrong(where, "null", data)


_SIMPLE: Mapping[Any, Callable[[Any, str], Any]] = {
    bool: _bool,
    int: _int,
    float: _float,
    str: _str,
    type(None): _none,
}


def _literal(choices: tuple[Any, ...], data: Any, where: str) -> Any:
    if not isinstance(data, str) or data not in choices:
        raise _wrong(where, "one of " + ", ".join(map(str, choices)), data)
    return data


def _optional(options: tuple[Any, ...], data: Any, where: str) -> Any:
    rest = [o for o in options if o is not type(None)]
    assert len(rest) == 1, "only X | None is written without a tag"
    return None if data is None else _read(rest[0], data, where)


def _tuple(items: tuple[Any, ...], data: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(data, list):
        raise _wrong(where, "a list", data)
    if items[-1] is ...:
        items = items[:1] * len(data)
    if len(items) != len(data):
        raise _wrong(where, f"{len(items)} values", data)
    return tuple(
        _read(k, v, f"{where}[{i}]") for i, (k, v) in enumerate(zip(items, data, strict=True))
    )


def _mapping(items: tuple[Any, ...], data: Any, where: str) -> dict[Any, Any]:
    if not isinstance(data, dict):
        raise _wrong(where, "an object", data)
    key_kind, value_kind = items
    out: dict[Any, Any] = {}
    for key, value in data.items():
        name = _whole(key, where) if key_kind is int else key
        out[name] = _read(value_kind, value, f"{where}[{key!r}]")
    return out


def _whole(key: Any, where: str) -> int:
    try:
        return int(key)  # JSON has text keys only
    except (TypeError, ValueError):
        raise _wrong(where, "whole numbers as keys", key) from None


@cache
def _fields(kind: Any) -> dict[str, tuple[Any, bool]]:
    """Field name → (type, whether it must be there)."""
    hints = get_type_hints(kind)
    missing = dataclasses.MISSING
    return {
        f.name: (hints[f.name], f.default is missing and f.default_factory is missing)
        for f in dataclasses.fields(kind)
    }


def _dataclass(kind: Any, data: Any, where: str) -> Any:
    if not isinstance(data, dict):
        raise _wrong(where, "an object", data)
    values = read_fields(kind, data, where)
    absent = [n for n, (_, needed) in _fields(kind).items() if needed and n not in data]
    if absent:
        raise CodecError(f"{where}: field {absent[0]!r} is missing")
    try:
        return kind(**values)
    except ArtiworldError as error:
        raise CodecError(f"{where}: {error}") from error
