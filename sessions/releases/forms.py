"""The forms of a release."""

from __future__ import annotations

from typing import Final, Literal, get_args

Form = Literal["folder", "webdataset", "huggingface"]
FORMS: Final[tuple[str, ...]] = get_args(Form)
