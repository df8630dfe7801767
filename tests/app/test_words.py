"""Every word of the screens, rendered with sample values."""

from __future__ import annotations

import importlib
import inspect
import itertools
import pkgutil
import re
from collections.abc import Iterator
from string import Formatter
from typing import Any

import pytest

from app.viewer import words
from app.viewer.words.common import Message
from model.validation.report import Severity

SAMPLES: dict[str, tuple[Any, ...]] = {
    "bool": (False, True),
    "int": (0, 1, 2),
    "float": (0.0, 0.5),
    "tuple[int, ...]": ((), (1, 3)),
    "dict[int, int]": ({}, {1: 5}),
    "dict[str, int]": ({}, {"accepted": 2, "todo": 1}),
    "list[str]": ([], ["one", "two"]),
    "tuple[float, float, float]": ((0.1, -0.2, 3.0),),
    "Severity": tuple(Severity),
    "dict[Severity, int]": ({}, dict.fromkeys(Severity, 1), dict.fromkeys(Severity, 2)),
}
NAMED_SAMPLES = {
    ("common", "job"): {"name": ("predict",)},
    ("scene", "job"): {"name": ("read",)},
    ("prepare", "kind"): {"kind": (1, 2, 3)},
    ("review", "finding"): {"titles": (["one"], ["one", "two", "three"])},
    ("joints", "tree_line"): {"confidence": ("", "87 %", "edited")},
}
OUR_OWN = re.compile(
    r"\b(gate|mend|mended|sure|told|tells|wants|looked|broken|held|judg\w+|seen|crumbs|leftovers"
    r"|take off|put back|look at|once round|in vain)\b",
    re.IGNORECASE,
)
"""Words that people of the field don't say."""
MODULES = [module.name for module in pkgutil.iter_modules(words.__path__)]


def module_of(name: str) -> Any:
    return importlib.import_module(f"{words.__name__}.{name}")


def texts_in(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from itertools.chain.from_iterable(texts_in(v) for v in value.values())
    elif isinstance(value, (tuple, list)):
        yield from itertools.chain.from_iterable(texts_in(v) for v in value)
    elif hasattr(value, "hint"):
        yield from (value.label, *value.tools, value.hint)


def places(message: Message) -> Iterator[tuple[str, str]]:
    """Name and format of each place."""
    for _, name, spec, _ in Formatter().parse(message):
        if name:
            yield name, spec or ""


def rendered(name: str) -> Iterator[tuple[str, str]]:
    """Name and text of everything that a file of words says."""
    module = module_of(name)
    for key, value in vars(module).items():
        if inspect.isfunction(value) and value.__module__ == module.__name__:
            known = NAMED_SAMPLES.get((name, key), {})
            choices = [
                known.get(p.name) or SAMPLES.get(str(p.annotation), ("door 1", ""))
                for p in inspect.signature(value).parameters.values()
            ]
            for values in itertools.product(*choices):
                yield from ((f"{key}{values}", text) for text in texts_in(value(*values)))
        elif isinstance(value, Message):
            samples = {name: 7 if spec else "door 1" for name, spec in places(value)}
            yield key, value(*samples.values())
        elif key.isupper() and not inspect.ismodule(value):
            yield from ((key, text) for text in texts_in(value))


@pytest.mark.parametrize("name", MODULES)
def test_every_message_is_rendered_in_the_words_of_the_field(name: str) -> None:
    for key, text in rendered(name):
        assert not re.search(r"[{}]|\bNone\b|nan|  \S.*  \S", text), (key, text)
        assert not OUR_OWN.search(text), (key, text)
        assert len(text) <= 240, (key, text)


@pytest.mark.parametrize("name", MODULES)
def test_labels_are_in_sentence_case(name: str) -> None:
    """Labels and titles begin with a capital and go on without; states are written small."""
    for key, value in vars(module_of(name)).items():
        if not key.isupper() or not isinstance(value, str) or len(value) > 40:
            continue
        words_of = re.findall(r"[A-Za-z][\w']*", re.sub(r"\(.*?\)", "", value))
        later = [w for w in words_of[1:] if w[0].isupper() and not w.isupper()]
        allowed = {"Esc", "Tab", "Review", "Annotate", "Joints", "Shift"}
        if not re.search(r"\. |[:|]", value):  # neither sentences nor a row of a table
            assert set(later) <= allowed, (key, value)


def test_counts_have_their_plural() -> None:
    review = module_of("review")
    found = dict(zip(reversed(Severity), (1, 4, 3), strict=True))
    assert review.checks(found) == "**Checks: ✖ 1 error · ▲ 4 warnings · ✓ 3 OK**"
    assert review.moment("detached", 0.29) == "290 mm gap"
    names = [f"drawer {k}" for k in (1, 2, 3, 4)]
    said = [review.finding(Severity.WARNING, names[:k]) for k in (1, 2, 4)]
    told = "drawer 1", "drawer 1 and drawer 2", "drawer 1, drawer 2 and 2 more"
    assert said == [f"▲ {who}: warning" for who in told]
    assert review.state("to review", "root") == "**Predicted** by root, waiting for review"
    assert "**2 on hold** (Shift+Y)" in module_of("queue").progress({"todo": 3}, 0, 2)
