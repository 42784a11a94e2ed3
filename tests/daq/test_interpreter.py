"""What a session asks of the interpreter holds as long as the session, however it ends."""

from __future__ import annotations

import gc
import sys

import pytest

from daq.interpreter import SWITCH_S, set_for_a_session


def fail_in_a_session():
    with set_for_a_session():
        assert sys.getswitchinterval() == pytest.approx(SWITCH_S)
        assert gc.get_freeze_count() > 0
        raise ZeroDivisionError


def test_it_is_set_back_when_a_session_fails():
    before = sys.getswitchinterval()
    with pytest.raises(ZeroDivisionError):
        fail_in_a_session()
    assert sys.getswitchinterval() == before
    assert gc.get_freeze_count() == 0
