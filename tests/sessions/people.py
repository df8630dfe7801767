"""Accounts for tests, with cheap hashes."""

from argon2 import PasswordHasher

from sessions import accounts
from sessions.store import Store

PASSWORD = "correct horse battery"


def add_people(store: Store) -> None:
    """Add ann (annotator), bob (annotator), rob (reviewer) and mia (manager)."""
    accounts.hasher = PasswordHasher(time_cost=1, memory_cost=64, parallelism=1)
    roles = {"mia": "manager", "ann": "annotator", "bob": "annotator", "rob": "reviewer"}
    for name, role in roles.items():
        store.people.accounts.add(name, role, PASSWORD)
