"""Types are checked at run time in each function's first calls of every test."""

from dataclasses import dataclass

import beartype
import jaxtyping
import numpy as np
import pytest
from jaxtyping import Float

from tests import type_checks
from workbench.geometry.rotations import rotation_matrix


@jaxtyping.jaxtyped(typechecker=beartype.beartype)
def doubled(row: Float[np.ndarray, "n"], same: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """As the import hook has every function of the packages that it checks."""
    return row + same if len(same) < 9 else row[:1]


@jaxtyping.jaxtyped(typechecker=beartype.beartype)
@dataclass(frozen=True)
class Pair:
    row: Float[np.ndarray, "n"]
    same: Float[np.ndarray, "n"]


SHORT, LONG = np.zeros(2), np.zeros(3)


@pytest.mark.parametrize("make", [doubled, Pair], ids=["function", "record"])
def test_a_first_call_of_other_shapes_or_types_is_refused(make):
    for given in ((SHORT, LONG), (SHORT, SHORT.astype(int)), (SHORT, None)):
        with pytest.raises(jaxtyping.TypeCheckError, match="same"):
            make(*given)


def test_what_a_function_returns_is_checked():
    with pytest.raises(jaxtyping.TypeCheckError, match="return value"):
        doubled(np.zeros(9), np.zeros(9))


def test_later_calls_are_not_checked_until_another_test_begins():
    for _ in range(type_checks.CHECKED_CALLS):
        Pair(SHORT, SHORT)
    assert len(Pair(SHORT, LONG).same) == 3
    type_checks.begin_test()
    with pytest.raises(jaxtyping.TypeCheckError):
        Pair(SHORT, LONG)


def test_what_the_functions_of_the_workbench_are_given_is_checked():
    with pytest.raises(jaxtyping.TypeCheckError, match="rotation_matrix"):
        rotation_matrix(np.zeros(4))


def test_a_checked_function_keeps_its_name_and_words():
    assert doubled.__name__ == "doubled"
    assert doubled.__doc__.startswith("As the import hook")
