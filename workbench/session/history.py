"""Undo and redo of one value that is replaced as a whole."""

import threading
from dataclasses import dataclass
from typing import Generic, TypeVar

from workbench.session.gesture import Gesture, Gestures

State = TypeVar("State")


@dataclass(frozen=True)
class Step(Generic[State]):
    """One entry of the history: the state before a change, and what the change was called."""

    state: State
    label: str


class History(Generic[State]):
    """The present state, and the steps that lead back from it and forth again. Calls may come from any thread."""

    def __init__(self, state: State, longest: int) -> None:
        """`longest`: steps that can be taken back."""
        self._present, self._longest = state, longest
        self._undo: list[Step[State]] = []
        self._redo: list[Step[State]] = []
        self._gestures = Gestures()
        self._lock = threading.RLock()

    @property
    def present(self) -> State:
        """The state as it is."""
        return self._present

    @property
    def undo_label(self) -> str | None:
        """What `undo` would take back."""
        return self._undo[-1].label if self._undo else None

    @property
    def redo_label(self) -> str | None:
        """What `redo` would make again."""
        return self._redo[-1].label if self._redo else None

    def change(self, state: State, label: str = "", gesture: Gesture | str | None = None) -> bool:
        """Make this the present state: one step of undo, or part of the last one if the `gesture` goes on.

        False, and no step, where it is the present state already.
        """
        with self._lock:
            if state == self._present:
                return False
            if not self._gestures.goes_on(gesture):
                self._undo = [*self._undo[-self._longest + 1 :], Step(self._present, label)]
            self._redo = []
            self._present = state
        return True

    def amend(self, state: State) -> None:
        """Make this the present state without a step: what no user did, no undo takes back."""
        with self._lock:
            self._present = state

    def undo(self) -> str | None:
        """Take back the last change; its label, None if there is none."""
        return self._travel(self._undo, self._redo)

    def redo(self) -> str | None:
        """Make the change again that was taken back last; its label, None if there is none."""
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
