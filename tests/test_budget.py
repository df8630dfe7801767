"""The budget counts what it says, and its limits only fall."""

import ast
import tomllib

import pytest

from tests.budget import FILE, ROOT, counts, limits_of, members, problems, raised, vague

TEXT = (ROOT / FILE).read_text()


def test_every_row_has_a_limit_and_one_above_it_is_a_problem():
    now, limits = counts(), limits_of(TEXT)
    assert {table: set(rows) for table, rows in now.items()} == {
        table: set(rows) for table, rows in limits.items()
    }
    now["house"]["files"] = 103
    limits["house"]["files"] = 100
    assert "files: 103, 3 above the limit" in [*problems(now, limits)]


def test_a_limit_that_rises_is_told_and_one_that_falls_is_not():
    before = {"house": {"files": 700, "lines": 100_000}}
    now = {"house": {"files": 701, "lines": 90_000}}
    assert [*raised(now, before)] == ["files: the limit rose from 700 to 701"]
    moved = {"packages": {"app": 4, "model": 6}}, {"packages": {"app": 5, "model": 5}}
    assert not [*raised(*moved)]
    grown = {"packages": {"app": 6, "model": 5}}, {"packages": {"app": 5, "model": 5}}
    assert [*raised(*grown)] == ["packages: the limit rose from 10 to 11"]


def test_an_allowance_raises_the_lines_by_what_was_used_and_no_more_than_it_says():
    used = tomllib.loads(TEXT)["allowances"]["real scans and their waiting"]["used"]
    entry = '"real scans and their waiting" = { most = 900, used = '
    spent = TEXT.replace(f"{entry}{used}", f"{entry}{used + 1}")
    assert limits_of(spent)["house"]["lines"] == limits_of(TEXT)["house"]["lines"] + 1
    assert limits_of(spent)["packages"]["app"] == limits_of(TEXT)["packages"]["app"] + 1
    with pytest.raises(ValueError, match="used 9999 of 900"):
        limits_of(TEXT.replace(f"{entry}{used}", f"{entry}9999"))


def test_members_and_vague_docstrings_are_counted():
    (node,) = ast.parse(
        'class Wide:\n    """Whether it is."""\n    a: int\n    b = 1\n    _c = 2\n'
        "    def __init__(self):\n        self.d = self._e = 0\n    def f(self): ...\n"
    ).body
    assert members(node) == {"a", "b", "d", "f"} and vague(node)
    assert not vague(ast.parse('def f():\n    """Width in metres."""').body[0])
