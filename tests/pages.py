"""The README and the pages of the documentation, as text that tests read."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (
        ROOT / "README.md",
        *sorted((ROOT / "docs").glob("*.md")),
        *sorted((ROOT / "docs" / "guides").glob("*.md")),
    )
}
"""The text of each page that somebody wrote, by its path in the repository."""
EVERYTHING = "\n".join(PAGES.values())


def code_blocks(language: str) -> list[tuple[str, str]]:
    """(page, text) of every block of code in a language."""
    return [
        (page, text) for page, whole in PAGES.items() for text in re.findall(rf"```{language}\n(.*?)```", whole, re.S)
    ]


def snippet(word: str) -> str:
    """The Python snippet that has a word in it; on several pages it must be the same."""
    found = {text for _, text in code_blocks("python") if word in text}
    assert len(found) == 1, f"{len(found)} different snippets in the documentation have {word!r} in them"
    return found.pop()
