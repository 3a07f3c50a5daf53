"""Grouping of changes into undo steps."""

import time
from dataclasses import dataclass

GESTURE_S = 0.8
"""Successive changes of one control within this time are one undo step."""


@dataclass(frozen=True)
class Gesture:
    """What moves a control: the control's name and the number of the drag; 0 for keys and typed numbers."""

    name: str
    drag: int = 0


class Gestures:
    """Decides whether a change continues the previous one: within a drag always, otherwise within 0.8 s."""

    def __init__(self) -> None:
        self._last: tuple[Gesture, float] | None = None

    def goes_on(self, gesture: Gesture | str | None) -> bool:
        """Record a change; returns whether it continues the previous step. None always starts a new step."""
        gesture = Gesture(gesture) if isinstance(gesture, str) else gesture
        last, now = self._last, time.monotonic()
        self._last = None if gesture is None else (gesture, now)
        if gesture is None or last is None or last[0] != gesture:
            return False
        return gesture.drag > 0 or now - last[1] < GESTURE_S

    def end(self) -> None:
        """Make the next change start a new step."""
        self._last = None
