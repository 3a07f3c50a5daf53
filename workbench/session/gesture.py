"""Which changes belong together as one step of undo."""

import time
from dataclasses import dataclass

GESTURE_S = 0.8
"""Changes of one control that follow each other within this time are one step of undo."""


@dataclass(frozen=True)
class Gesture:
    """What moves a control: the control's name, and the number of the drag; 0 for keys and typed numbers."""

    name: str
    drag: int = 0


class Gestures:
    """Tells of each change whether it goes on with the one before: a drag however slow, the rest within 0.8 s."""

    def __init__(self) -> None:
        self._last: tuple[Gesture, float] | None = None

    def goes_on(self, gesture: Gesture | str | None) -> bool:
        """Take note of a change; whether it belongs to the step before. None: a step of its own."""
        gesture = Gesture(gesture) if isinstance(gesture, str) else gesture
        last, now = self._last, time.monotonic()
        self._last = None if gesture is None else (gesture, now)
        if gesture is None or last is None or last[0] != gesture:
            return False
        return gesture.drag > 0 or now - last[1] < GESTURE_S

    def end(self) -> None:
        """Whatever comes next is a step of its own."""
        self._last = None
