"""What a long run does about its memory."""

import sys

import jax
import pytest

from tests.memory import let_go_of_programs


@pytest.fixture
def traced():
    """A compiled function that counts how often it was traced."""
    count = []

    @jax.jit
    def double(x):
        count.append(x)
        return 2 * x

    double(1.0)
    return lambda: (double(1.0), len(count))[1]


def test_a_large_process_lets_go_of_its_programs(traced):
    assert let_go_of_programs(large=0)
    assert traced() == 2


def test_a_small_process_keeps_them(traced):
    assert not let_go_of_programs(large=sys.maxsize)
    assert traced() == 1
