"""Parts of a clip: ranges of consecutive frames, in the notation users type."""

from collections.abc import Iterable, Sequence

from workbench.errors import InputError

Part = tuple[int, int]
"""First and last frame."""


def parts_of(frames: Iterable[int]) -> tuple[Part, ...]:
    """Group frames into maximal parts of consecutive frames."""
    parts: list[Part] = []
    for frame in sorted(set(frames)):
        if parts and frame == parts[-1][1] + 1:
            parts[-1] = (parts[-1][0], frame)
        else:
            parts.append((frame, frame))
    return tuple(parts)


def frames_of(parts: Iterable[Part]) -> set[int]:
    """The frames of parts."""
    return {frame for first, last in parts for frame in range(first, last + 1)}


def parts_text(parts: Sequence[Part], most: int = 6) -> str:
    """Parts as text such as "40-52, 60"; beyond `most` only their number is given."""
    words = [f"{first}-{last}" if last > first else str(first) for first, last in parts]
    rest = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(words[:most]) + rest


def read_parts(text: str) -> tuple[Part, ...]:
    """Parts from "40-52, 60". Raises `InputError` for anything else."""
    parts = []
    for word in text.replace("–", "-").replace(",", " ").split():
        first, _, last = word.partition("-")
        if not (first.isdigit() and (last or first).isdigit() and int(first) <= int(last or first)):
            raise InputError(f"Write frames as 40-52 or 60, got {word!r}.")
        parts.append((int(first), int(last or first)))
    return tuple(parts)
