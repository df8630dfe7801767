"""Arrays come back exactly, are small, and damage is noticed."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from model.core.errors import StoreError
from sessions.storage import MAGIC, ArrayFiles

dtypes = st.sampled_from(
    [np.int8, np.int16, np.int32, np.int64, np.uint8, np.uint64, np.float32, np.float64, np.bool_]
)


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> ArrayFiles:
    return ArrayFiles(tmp_path_factory.mktemp("arrays"))


@settings(max_examples=150)
@given(array=hnp.arrays(dtypes, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=6)))
def test_any_array_comes_back(files, array):
    again = files.get(files.put(array))
    assert again.shape == array.shape
    assert again.dtype == array.dtype.newbyteorder("<")
    np.testing.assert_array_equal(again, array)
    assert not again.flags.writeable


@pytest.mark.parametrize(
    "array",
    [
        np.array([-(2**63), 2**63 - 1]),
        np.array([2**63 - 1, -(2**63)]),
        np.array([-(2**63), -1, 2**63 - 1]),
        np.array([0, 2**64 - 1], np.uint64),
        np.array([2**64 - 1, 2**64 - 2], np.uint64),
        np.array([-128, 127], np.int8),
        np.array([-32768, 32767, 32767], np.int16),
        np.array([-(2**63), 2**63 - 1, 2**63 - 1]),
        np.array([-32768, 32767, -32768], np.int16),
        np.array([5, 5, 5, 2**40, 2**40 + 1]),
        np.array([7]),
        np.zeros((0, 3), np.int64),
        np.arange(12).reshape(3, 4).T,
        np.arange(20)[::3],
        np.arange(5, dtype=">i4"),
    ],
    ids=str,
)
def test_the_ends_of_the_ranges_come_back(files, array):
    np.testing.assert_array_equal(files.get(files.put(array)), array)


def test_the_reference_is_the_content(files):
    labels = np.array([0, 1, 2], np.int16)
    assert files.put(labels) == files.put(labels.copy())
    others = [labels.astype(np.int32), labels.reshape(1, 3), labels[::-1], labels.astype(bool)]
    assert len({files.put(a) for a in [labels, *others]}) == 5


def test_a_million_labels_are_small(files):
    rng = np.random.default_rng(0)
    # Scans have no order: neighbours in the file are strangers in space.
    labels = rng.choice(np.arange(-1, 5, dtype=np.int16), 1_000_000)
    region = np.flatnonzero(labels == 3)
    assert files.path(files.put(labels)).stat().st_size < 450_000
    assert files.path(files.put(region)).stat().st_size < 200_000
    assert files.path(files.put(np.sort(labels))).stat().st_size < 5_000


@pytest.mark.parametrize("ref", ["", "../secret", "AB" * 32, "ab" * 31, "ab" * 32 + "/x"])
def test_only_references_lead_to_files(files, ref):
    with pytest.raises(StoreError, match="no reference of a stored array"):
        files.get(ref)


def test_other_kinds_of_arrays_are_refused(files):
    for array in (np.array(["a"]), np.array([object()]), np.array([1j])):
        with pytest.raises(StoreError, match="only numbers and booleans"):
            files.put(array)


def flipped(data: bytes) -> bytes:
    return data[:-6] + bytes([data[-6] ^ 1]) + data[-5:]


@pytest.mark.parametrize(
    "damage",
    [
        lambda d: b"",
        lambda d: d[: len(d) // 2],
        flipped,
        lambda d: b"x" * len(d),
        lambda d: MAGIC + b"[]\n" + d[-20:],
        lambda d: d.replace(b'"base": 1000', b'"base": 1001'),
    ],
    ids=["empty", "cut", "one bit", "garbage", "header", "another base"],
)
def test_damage_is_named_and_healed_by_writing_again(tmp_path, damage):
    files = ArrayFiles(tmp_path)
    array = np.random.default_rng(1).permutation(3000)[:500] + 1000
    array[:2] = 1000, 1001
    ref = files.put(array)
    path = files.path(ref)
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    assert path.read_bytes() != whole
    with pytest.raises(StoreError, match="is damaged") as error:
        files.get(ref)
    assert str(path) in str(error.value)
    assert files.put(array) == ref
    np.testing.assert_array_equal(files.get(ref), array)


def test_a_missing_file_is_named(files):
    with pytest.raises(StoreError, match=f"{'ef' * 32}.array: is missing"):
        files.get("ef" * 32)


def test_a_newer_format_is_named(tmp_path):
    files = ArrayFiles(tmp_path)
    path = files.path(files.put(np.arange(4)))
    path.write_bytes(path.read_bytes().replace(b"ARRAY 1\n", b"ARRAY 2\n"))
    with pytest.raises(StoreError, match="newer version"):
        files.get(path.stem)


def test_a_folder_that_can_not_be_written_is_named(tmp_path):
    (tmp_path / "arrays").write_text("a file where the folder should be")
    with pytest.raises(StoreError, match="can't be written"):
        ArrayFiles(tmp_path / "arrays").put(np.arange(3))


def test_nothing_half_written_stays(tmp_path, monkeypatch):
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    files = ArrayFiles(tmp_path)
    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(StoreError, match="No space left"):
        files.put(np.arange(3))
    assert [p for p in Path(tmp_path).rglob("*") if p.is_file()] == []
