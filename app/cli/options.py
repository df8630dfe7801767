"""Options that several commands share."""

from __future__ import annotations

import argparse

UP_AXES = ("x", "y", "z", "-x", "-y", "-z")


def add_reading(parser: argparse.ArgumentParser) -> None:
    """How files are read."""
    parser.add_argument(
        "--up-axis", choices=UP_AXES, metavar="AXIS",
        help=f"up axis of the files, one of {', '.join(UP_AXES)} (default: by format)",
    )  # fmt: skip
    parser.add_argument(
        "--unit-scale", type=positive_number, default=1.0, metavar="METRES",
        help="metres per unit of the files, 0.001 for millimetres (default: 1)",
    )  # fmt: skip


def add_json(parser: argparse.ArgumentParser) -> None:
    """Output for programs."""
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")


def positive_number(text: str) -> float:
    """A type of option: a finite number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise ValueError
    return value


def count(text: str) -> int:
    """A type of option: a whole number from 0."""
    value = int(text)
    if value < 0:
        raise ValueError
    return value


count.__name__ = "whole number"
positive_number.__name__ = "positive number"


def add_point_sam(parser: argparse.ArgumentParser) -> None:
    """``--point-sam PATH`` is ``--segmenter point-sam:PATH``."""
    parser.add_argument(
        "--point-sam", dest="segmenter", type="point-sam:{}".format, metavar="PATH",
        help="let Point-SAM answer, with the published weights at PATH")  # fmt: skip


def joined_axes(words: list[str]) -> list[str]:
    """argparse would take the -z of ``--up-axis -z`` for an option."""
    out: list[str] = []
    for word in words:
        if out and out[-1] == "--up-axis" and word in UP_AXES:
            out[-1] = f"--up-axis={word}"
        else:
            out.append(word)
    return out
