"""Notes of a tab: few, none twice, none longer than its reason."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from app.viewer.tab import MOST, Notes


@pytest.fixture
def client() -> Any:
    """What a page shows: ``shown`` holds its notes."""
    shown: list[Any] = []

    def add(title: str, body: str, **_: Any) -> Any:
        note = SimpleNamespace(text=(title, body))
        note.remove = lambda: shown.remove(note)
        shown.append(note)
        return note

    return SimpleNamespace(shown=shown, add_notification=add)


def texts(client: Any) -> list[tuple[str, str]]:
    return [n.text for n in client.shown]


def test_a_note_takes_the_place_of_one_of_its_title(client: Any) -> None:
    notes = Notes(client)
    for k in range(6):
        notes.show("Not possible", f"try {k}", "yellow", 10.0)
    assert texts(client) == [("Not possible", "try 5")]


def test_there_are_few_at_a_time_and_the_newest_stay(client: Any) -> None:
    notes = Notes(client)
    for k in range(MOST + 2):
        notes.show(f"note {k}", "", "blue", 5.0)
    assert [t for t, _ in texts(client)] == [f"note {k}" for k in range(2, MOST + 2)]


def test_a_note_ends_with_its_reason_and_news_stay(client: Any) -> None:
    notes = Notes(client)
    notes.show("Not accepted yet", "press Y again", "yellow", 10.0, (1, 7))
    notes.show("Accepted", "saved", "green", 5.0)
    notes.end_others((1, 7))
    assert len(client.shown) == 2
    notes.end_others((1, 8))
    assert texts(client) == [("Accepted", "saved")]
