"""An arming lasts as long as it was granted for, and no longer."""

from __future__ import annotations

import pytest

from daq import Arming, ManualClock


def test_it_lasts_from_its_grant_and_each_renewal() -> None:
    clock = ManualClock()
    arming = Arming(clock, 10.0)
    assert arming.left_s == 0.0
    arming.grant()
    clock.advance(9.0)
    assert arming.left_s == pytest.approx(1.0)
    assert arming.renew()
    clock.advance(9.0)
    assert arming.left_s == pytest.approx(1.0)


def test_once_ended_it_cannot_be_renewed_only_granted_anew() -> None:
    clock = ManualClock()
    arming = Arming(clock, 10.0)
    assert not arming.renew()
    arming.grant()
    clock.advance(10.0)
    assert arming.left_s == 0.0
    assert not arming.renew()
    assert arming.left_s == 0.0
    arming.grant()
    assert arming.left_s == pytest.approx(10.0)


def test_it_must_last_for_some_time() -> None:
    with pytest.raises(ValueError, match="above 0"):
        Arming(ManualClock(), 0.0)
