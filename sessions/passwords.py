"""Passwords: what is allowed, and their argon2 hashes."""

from __future__ import annotations

import secrets
import threading
from functools import cache

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from model.core.errors import ConfigurationError

MIN_LENGTH = 10
"""Characters; the least that NIST SP 800-63B allows is 8."""
MAX_LENGTH = 1000
"""Characters, so that nobody has the server hash megabytes."""

hasher = PasswordHasher()
"""argon2id with the library's parameters: the second ones of RFC 9106, 64 MiB."""
_slots = threading.BoundedSemaphore(2)
"""Hashes at a time: each takes 64 MiB, and visitors decide how many are asked for."""


def check_password(password: str, name: str) -> None:
    """Refuse a password that is too short, too long, or the name.

    Raises:
        ConfigurationError: with what would be right.
    """
    if not MIN_LENGTH <= len(password) <= MAX_LENGTH:
        raise ConfigurationError(
            f"the password has {len(password)} characters; give {MIN_LENGTH} to {MAX_LENGTH}"
        )
    if name.casefold() in password.casefold() and len(password) < len(name) + MIN_LENGTH:
        raise ConfigurationError("the password is little more than the name; choose another")


def hash_password(password: str) -> str:
    """Return the argon2id hash with its parameters."""
    with _slots:
        return hasher.hash(password)


def is_password(stored: str | None, password: str) -> bool:
    """True if ``password`` belongs to the stored hash; None takes the same work and is False."""
    with _slots:
        dummy = dummy_hash()  # here, so that the first question of either kind makes it
        try:
            right = hasher.verify(stored or dummy, password[:MAX_LENGTH])
        except (VerificationError, InvalidHashError):
            return False
    return right and stored is not None and len(password) <= MAX_LENGTH


@cache
def dummy_hash() -> str:
    """A hash of nothing anybody knows, for accounts that have no password."""
    return hasher.hash(secrets.token_bytes(32))
