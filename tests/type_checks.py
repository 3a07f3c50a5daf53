"""Types are checked at run time in each function's first calls of every test, not in all: a check takes longer than
most calls, and a test that fits a clip makes a hundred thousand.

pytest's option `--jaxtyping-packages` names what is checked.
"""

from collections.abc import Callable
from dataclasses import is_dataclass
from functools import wraps
from inspect import isclass
from typing import Any

import jaxtyping

CHECKED_CALLS = 5
"""Of each function in each test."""
_checked = jaxtyping.jaxtyped


class _Turn:
    """The test that runs, by its number."""

    test = 0


def begin_test() -> None:
    """Check every function's next calls again."""
    _Turn.test += 1


def first_calls_checked(function: Callable, **options: Any) -> Callable:
    """A function that checks its first calls of each test; what checks is made when the first one comes."""
    checked, test, calls = None, -1, 0

    @wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked, test, calls
        if test != _Turn.test:
            test, calls = _Turn.test, 0
        calls += 1
        if calls > CHECKED_CALLS:
            return function(*args, **kwargs)
        if checked is None:
            checked = _checked(function, **options)
        return checked(*args, **kwargs)

    return called


def _check(target: Any = None, **options: Any) -> Any:
    """In the place of `jaxtyping.jaxtyped`, which the import hook puts on every function and class."""
    if target is None:
        return lambda target: _check(target, **options)
    if not isclass(target):
        return first_calls_checked(target, **options)
    if is_dataclass(target):
        target.__init__ = first_calls_checked(target.__init__, **options)
    return target


def install() -> None:
    """Check so what is imported from now on."""
    jaxtyping.jaxtyped = _check
