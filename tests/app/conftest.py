"""What the tests of the application share."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def _shared_workers(workers_of_all_servers: None) -> None: ...
