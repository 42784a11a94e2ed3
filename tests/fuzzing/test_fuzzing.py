"""No reader of outside data fails but with the errors it documents: a bounded, repeatable run.

`python benchmarks/fuzz.py --minutes N` goes on from here, steered by coverage.
"""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzzing.mutation import flipped, mutated
from tests.fuzzing.target import Target
from tests.fuzzing.targets import TARGETS

RANDOM = st.randoms(use_true_random=False)
BOUNDED = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_valid_inputs_are_read(target: Target) -> None:
    for seed in target.seeds():
        target.check(seed)


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
@given(random=RANDOM)
@BOUNDED
def test_changed_inputs_are_read_or_refused(target: Target, random: Random) -> None:
    target.check(mutated(target, target.seeds(), random))


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
@given(data=st.binary(max_size=400))
@BOUNDED
def test_any_bytes_are_read_or_refused(target: Target, data: bytes) -> None:
    target.check(data)


@pytest.mark.parametrize(
    "target", [t for t in TARGETS if t.check_flips is not None], ids=lambda target: target.name
)
@given(random=RANDOM)
@BOUNDED
def test_a_turned_bit_is_never_taken_for_the_truth(target: Target, random: Random) -> None:
    assert target.check_flips is not None
    seed = random.choice(target.seeds())
    target.check_flips(seed, flipped(seed, random))


def test_a_reader_that_fails_is_found() -> None:
    """The fuzzer itself: a reader that stumbles over one thing in its format."""

    def check(data: bytes) -> None:
        assert b"7" not in data[:4]

    target = Target("bad", lambda: [b"0123 = 4567"], check, text=True)
    random = Random(1)
    found = 0
    for _ in range(500):
        try:
            check(mutated(target, target.seeds(), random))
        except AssertionError:
            found += 1
    assert 5 < found < 400
