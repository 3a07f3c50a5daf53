"""Undo and redo for a value that is always replaced as a whole."""

import threading
from dataclasses import dataclass
from typing import Generic, TypeVar

from workbench.session.gesture import Gesture, Gestures

State = TypeVar("State")


@dataclass(frozen=True)
class Step(Generic[State]):
    """One entry of the history: the state before a change, and the label of the change."""

    state: State
    label: str


class History(Generic[State]):
    """The current state with its undo and redo steps. Thread-safe."""

    def __init__(self, state: State, longest: int) -> None:
        """`longest`: maximum number of undo steps."""
        self._present, self._longest = state, longest
        self._undo: list[Step[State]] = []
        self._redo: list[Step[State]] = []
        self._gestures = Gestures()
        self._lock = threading.RLock()

    @property
    def present(self) -> State:
        """The current state."""
        return self._present

    @property
    def previous(self) -> State | None:
        """The state that `undo` would bring back; None if there is none."""
        return self._undo[-1].state if self._undo else None

    @property
    def steps(self) -> tuple[Step[State], ...]:
        """The steps that can be undone, the newest last."""
        return tuple(self._undo)

    @property
    def undo_label(self) -> str | None:
        """Label of the change that `undo` would revert."""
        return self._undo[-1].label if self._undo else None

    @property
    def redo_label(self) -> str | None:
        """Label of the change that `redo` would repeat."""
        return self._redo[-1].label if self._redo else None

    def change(self, state: State, label: str = "", gesture: Gesture | str | None = None) -> bool:
        """Make this the current state: a new undo step, or part of the last one if it continues the same `gesture`.

        Returns False and adds no step if it equals the current state; a gesture that leads back leaves none.
        """
        with self._lock:
            if state == self._present:
                return False
            if not self._gestures.goes_on(gesture):
                self._undo = [*self._undo[-self._longest + 1 :], Step(self._present, label)]
            elif self._undo and self._undo[-1].state == state:  # dragged back to where it was
                self._undo.pop()
                self._gestures.end()
            self._redo = []
            self._present = state
        return True

    def undo(self) -> str | None:
        """Undo the last change. Returns its label; None if there is none."""
        return self._travel(self._undo, self._redo)

    def redo(self) -> str | None:
        """Redo the change that was undone last. Returns its label; None if there is none."""
        return self._travel(self._redo, self._undo)

    def _travel(self, source: list[Step[State]], target: list[Step[State]]) -> str | None:
        with self._lock:
            if not source:
                return None
            step = source.pop()
            target.append(Step(self._present, step.label))
            self._present = step.state
            self._gestures.end()
        return step.label
