"""The clocks of virtual devices are as wrong as real ones, and always in the same way."""

from __future__ import annotations

import pytest

from sim_devices.crystal import LARGEST_ERROR, PERFECT, Crystal, crystal_of


def test_a_crystal_counts_fast_or_slow() -> None:
    assert Crystal(20e-6).elapsed(1e6) == pytest.approx(1e6 + 20.0)
    assert PERFECT.elapsed(3.0) == 3.0


def test_devices_have_crystals_of_their_own() -> None:
    errors = [crystal_of(f"encoder{n}").error for n in range(200)]
    assert crystal_of("encoder7").error == errors[7]
    assert max(abs(error) for error in errors) <= LARGEST_ERROR
    assert min(errors) < -0.5 * LARGEST_ERROR
    assert max(errors) > 0.5 * LARGEST_ERROR
