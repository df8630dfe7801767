"""What the tests of the application share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.app.shared_workers import shared_workers


@pytest.fixture(scope="session", autouse=True)
def _shared_workers() -> Iterator[None]:
    with shared_workers():
        yield
