"""Messages with places for values."""

from __future__ import annotations

from string import Formatter


class Message(str):
    """A text with named places, ``"{count} of {total}"``; a call fills them in their order."""

    __slots__ = ()

    @property
    def places(self) -> tuple[str, ...]:
        """The names, in order, each once."""
        found = (name for _, name, _, _ in Formatter().parse(self) if name)
        return tuple(dict.fromkeys(found))

    def __call__(self, *values: object) -> str:
        """Fill the places."""
        return self.format(**dict(zip(self.places, values, strict=True)))
