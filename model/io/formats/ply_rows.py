"""The rows of a PLY file: elements of scalar and list properties, as columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.io.formats.loaded import numbers

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Property:
    """A column: its numpy type code, and for a list that of its count."""

    name: str
    type: str
    count_type: str | None = None


@dataclass
class Element:
    """A kind of row as the header declares it."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    @property
    def smallest(self) -> int:
        """Fewest bytes (binary) that one row can take."""
        return sum(np.dtype(p.count_type or p.type).itemsize for p in self.properties)


@dataclass(frozen=True)
class Ragged:
    """A list property: rows after each other."""

    values: Array
    sizes: Array


Table = dict[str, "Array | Ragged"]


def cut_off(path: Path, element: Element) -> InputFileError:
    """The error for a file that ends too early."""
    return InputFileError(
        path,
        f"ends inside its {element.count} rows of {element.name!r}",
        "the file is cut off; download or export it again",
    )


# Binary


def read_binary(
    path: Path, body: memoryview, elements: list[Element], order: str
) -> dict[str, Table]:
    """Element → its columns, from what follows a binary header; ``order`` is ``<`` or ``>``.

    Raises:
        InputFileError: where the file ends too early.
    """
    tables, at = {}, 0
    for e in elements:
        lists = [p for p in e.properties if p.count_type]
        table: Table
        if not lists:
            dtype = np.dtype([(p.name, order + p.type) for p in e.properties])
            if at + e.count * dtype.itemsize > len(body):
                raise cut_off(path, e)
            rows = np.frombuffer(body, dtype, e.count, at)
            table = {p.name: rows[p.name] for p in e.properties}
            at += e.count * dtype.itemsize
        else:
            table, at = _binary_lists(path, body, e, order, at)
        tables.setdefault(e.name, table)
    return tables


def _binary_lists(
    path: Path, body: memoryview, e: Element, order: str, at: int
) -> tuple[Table, int]:
    """Rows with lists. Nearly always all lists are as long as in the first row."""
    if e.count == 0:
        empty = np.zeros(0, np.int64)
        return {p.name: Ragged(empty, empty) if p.count_type else empty for p in e.properties}, at
    sizes = _first_sizes(path, body, e, order, at)
    fields: list[tuple[Any, ...]] = []
    for i, p in enumerate(e.properties):
        if p.count_type:
            fields.append((f"#{i}", order + p.count_type))
            fields.append((f"@{i}", order + p.type, (sizes[i],)))
        else:
            fields.append((f"@{i}", order + p.type))
    dtype = np.dtype(fields)
    if at + e.count * dtype.itemsize <= len(body):
        rows = np.frombuffer(body, dtype, e.count, at)
        if all((rows[f"#{i}"] == n).all() for i, n in sizes.items()):
            table: Table = {}
            for i, p in enumerate(e.properties):
                column = rows[f"@{i}"]
                table[p.name] = (
                    Ragged(column.reshape(-1), np.full(e.count, sizes[i], np.int64))
                    if p.count_type
                    else column
                )
            return table, at + e.count * dtype.itemsize
    return _binary_ragged(path, body, e, order, at)


def _first_sizes(path: Path, body: memoryview, e: Element, order: str, at: int) -> dict[int, int]:
    sizes = {}
    for i, p in enumerate(e.properties):
        width = np.dtype(p.type).itemsize
        if p.count_type:
            count = np.dtype(order + p.count_type)
            if at + count.itemsize > len(body):
                raise cut_off(path, e)
            sizes[i] = int(np.frombuffer(body, count, 1, at)[0])
            at += count.itemsize
            width *= sizes[i]
        at += width
        if width < 0 or at > len(body):
            raise cut_off(path, e)
    return sizes


def _binary_ragged(
    path: Path, body: memoryview, e: Element, order: str, at: int
) -> tuple[Table, int]:
    """Row by row to find where each property begins, then gathered at once."""
    begins = np.zeros((len(e.properties), e.count), np.int64)
    sizes = np.ones((len(e.properties), e.count), np.int64)
    plan = []
    for p in e.properties:
        count = np.dtype(p.count_type or "u1")
        plan.append(
            (p.count_type is not None, count.itemsize, count.kind == "i", np.dtype(p.type).itemsize)
        )
    byteorder, end = ("big" if order == ">" else "little"), len(body)
    if any(p.count_type in ("f4", "f8") for p in e.properties):
        raise InputFileError(path, f"the lists of {e.name!r} are counted in floats")
    for row in range(e.count):
        for i, (is_list, head, signed, width) in enumerate(plan):
            n = 1
            if is_list:
                n = int.from_bytes(body[at : at + head], byteorder, signed=signed)
                at += head
            begins[i, row], sizes[i, row] = at, n
            at += n * width
            if n < 0 or at > end:
                raise cut_off(path, e)
    raw = np.frombuffer(body, np.uint8)

    def picked(p: Property, starts: Array, inside: Array) -> Array:
        dtype = np.dtype(order + p.type)
        first = starts + inside * dtype.itemsize
        rows = raw[first[:, None] + np.arange(dtype.itemsize)]
        return np.ascontiguousarray(rows).view(dtype).reshape(-1)

    return _gathered(e, begins, sizes, picked), at


def _gathered(
    e: Element, begins: Array, sizes: Array, picked: Callable[[Property, Array, Array], Array]
) -> Table:
    """Columns of rows with lists of many lengths.

    Args:
        begins, sizes: (properties, rows) start and length of each value.
        picked: values of a property, at (N,) starts and numbers within their lists.
    """
    table: Table = {}
    for i, p in enumerate(e.properties):
        inside = np.arange(int(sizes[i].sum())) - np.repeat(
            np.cumsum(sizes[i]) - sizes[i], sizes[i]
        )
        column = picked(p, np.repeat(begins[i], sizes[i]), inside)
        table[p.name] = Ragged(column, sizes[i]) if p.count_type else column
    return table


# ASCII


def read_ascii(path: Path, body: bytes, elements: list[Element]) -> dict[str, Table]:
    """Element → its columns, from what follows an ASCII header.

    Raises:
        InputFileError: where it ends too early or something is no number.
    """
    values = numbers(path, body.decode("latin-1"), "PLY")
    tables, at = {}, 0
    for e in elements:
        width = len(e.properties)
        table: Table
        if not any(p.count_type for p in e.properties):
            if at + e.count * width > len(values):
                raise cut_off(path, e)
            rows = values[at : at + e.count * width].reshape(e.count, width)
            table = {p.name: _typed(rows[:, i], p) for i, p in enumerate(e.properties)}
            at += e.count * width
        else:
            table, at = _ascii_lists(path, values, e, at)
        tables.setdefault(e.name, table)
    return tables


def _typed(column: Array, p: Property) -> Array:
    """ASCII numbers keep double precision; colours are recognised by their integer type."""
    if p.type in ("f4", "f8"):
        return column
    info = np.iinfo(p.type)
    return np.clip(np.nan_to_num(column), info.min, info.max).astype(p.type)


def _ascii_lists(path: Path, values: Array, e: Element, at: int) -> tuple[Table, int]:
    begins = np.zeros((len(e.properties), e.count), np.int64)
    sizes = np.ones((len(e.properties), e.count), np.int64)
    if e.properties and e.count and len(e.properties) == 1 and at < len(values):
        # One list a row, all of one length, is by far the most common.
        n = values[at]
        if 0 <= n <= 4096 and n == int(n) and at + e.count * (int(n) + 1) <= len(values):
            rows = values[at : at + e.count * (int(n) + 1)].reshape(e.count, -1)
            if (rows[:, 0] == n).all():
                name, lengths = e.properties[0].name, np.full(e.count, int(n))
                return {name: Ragged(rows[:, 1:].reshape(-1), lengths)}, at + rows.size
    end = len(values)
    is_list = [p.count_type is not None for p in e.properties]
    for row in range(e.count):
        for i, listed in enumerate(is_list):
            n = 1
            if listed:
                if at >= end or not 0 <= values[at] <= end:
                    raise cut_off(path, e)
                n = int(values[at])
                at += 1
            begins[i, row], sizes[i, row] = at, n
            at += n
            if at > end:
                raise cut_off(path, e)

    def picked(p: Property, starts: Array, inside: Array) -> Array:
        column = values[starts + inside]
        return column if p.count_type else _typed(column, p)

    return _gathered(e, begins, sizes, picked), at
