import re

from hypothesis import given
from hypothesis import strategies as st

from app.viewer.tab import plain


@given(st.text(max_size=200))
def test_nothing_of_markdown_html_or_mdx_survives(text: str) -> None:
    out = plain(text, 400)
    bare = re.sub(r"&#\d+;", "", out)
    assert not set(bare) & set('<>{}[]`*~#|\\!&\n"$@=')


@given(st.text(max_size=200))
def test_it_reads_as_it_was_typed(text: str) -> None:
    shown = re.sub(r"&#(\d+);", lambda m: chr(int(m.group(1))), plain(text, 400))
    assert shown == text


def test_long_text_is_cut() -> None:
    assert len(plain("a" * 500, 50)) <= 50 + len("&#8230;")
