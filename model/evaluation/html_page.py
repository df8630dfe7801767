"""HTML pages of one file: templates beside the modules that fill them, every value escaped."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from model.core.files import draft_of, written_to


def write_page(path: Path, template: Path, **values: Any) -> Path:
    """Write ``template`` filled with ``values``; ``|png`` makes an address of a PNG file's bytes.

    Raises:
        InputFileError: where it can't be written.
    """
    environment = Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined,
        loader=FileSystemLoader(template.parent),
    )  # fmt: skip
    environment.filters["png"] = _png
    page = environment.get_template(template.name).render(values)
    with written_to(path), draft_of(path) as draft:
        draft.write_text(page, encoding="utf-8")
    return path


def _png(data: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(data).decode('ascii')}"
