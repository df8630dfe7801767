"""Numeric threads of the processes that compute, as far as the person hasn't chosen them."""

from __future__ import annotations

from collections.abc import Mapping

NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
"""Variables that numpy's and torch's libraries read."""

BY_DEFAULT = "ARTIWORLD_THREADS_BY_DEFAULT"
"""Holds those of :data:`NAMES` that :func:`with_threads` set and not the person."""


def with_threads(environment: Mapping[str, str], threads: int) -> dict[str, str]:
    """The environment of a child process with so many threads; what is set in it stays."""
    ours = [name for name in NAMES if name not in environment]
    return {**{name: str(threads) for name in ours}, BY_DEFAULT: ",".join(ours), **environment}


def chosen_by_person(environment: Mapping[str, str]) -> bool:
    """Whether the number of torch's threads was set by the user."""
    ours = environment.get(BY_DEFAULT, "").split(",")
    return any(n in environment and n not in ours for n in ("OMP_NUM_THREADS", "MKL_NUM_THREADS"))
