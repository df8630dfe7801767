"""Every message of validation renders with sample values."""

from string import Formatter

import pytest

from model.core.joint import Joint
from model.validation import messages

TABLE = """at=104°|by= by 3 mm|cause=, pushed by the collision shapes of door 1
command=pip install 'artiworld[physics]'|depth=121 mm|driven=drawer 2 is
engine=MuJoCo|error=XML Error: mesh|first=door 1|free=0° to 90°|gap=290 mm|height=1.7|name=dor
how=becomes unstable|message=The part is a single point.|nearest=base
other=carcass 0|part=base|percent=35|range=0° to 485.8°|ratio=1.3
second=drawer 2|support=carcass 0|turns=1.3|value=3 mm"""
SAMPLES = dict(entry.split("=", 1) for entry in TABLE.replace("\n", "|").split("|"))
TEMPLATES = {k: v for k, v in vars(messages).items() if k.isupper() and isinstance(v, str)}


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_renders_with_sample_values(name: str) -> None:
    template = TEMPLATES[name]
    fields = {field for _, field, _, _ in Formatter().parse(template) if field}
    text = template.format(**{field: SAMPLES[field] for field in fields})
    assert 0 < len(text) <= 120 and "{" not in text and "  " not in text
    assert all(SAMPLES[field] in text for field in fields)


def test_values_are_formatted_with_their_units() -> None:
    hinge = Joint("hinge", "revolute", "a", "b", lower=0.0, upper=1.0)
    assert messages.interval(hinge, 0.0, 1.5707963) == "0° to 90°"
    assert [messages.length(v) for v in (0.0041, 0.121)] == ["4.1 mm", "121 mm"]
    assert messages.sentence(messages.OF_PART, part="base", message="x") == "Base: x"
