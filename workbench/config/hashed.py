"""How a provenance names what was used: by its name and its content."""

from typing import NamedTuple, Self

_BETWEEN = " sha256:"


class Hashed(NamedTuple):
    """A file, folder or model and the SHA-256 of what it held; as text "talk.mp4 sha256:9f86d0…"."""

    name: str
    """A path as it was typed, or a model's name."""
    sha256: str

    def __str__(self) -> str:
        return f"{self.name}{_BETWEEN}{self.sha256}"

    @classmethod
    def read(cls, text: str) -> Self:
        """The entry in a text; one without a hash, for example in a file edited by hand, is a name."""
        name, between, sha256 = text.rpartition(_BETWEEN)
        return cls(name, sha256) if between else cls(text, "")
