"""What fuzzing has found and was mended: each input, made small, is read or refused."""

from __future__ import annotations

import pytest

from tests.fuzzing.can_targets import DBC
from tests.fuzzing.file_targets import URDF
from tests.fuzzing.targets import TARGETS

_BY_NAME = {target.name: target for target in TARGETS}
_RESULT = _BY_NAME["result"].seeds()[0]


def _cyclic() -> str:
    return URDF.replace('<parent link="base"/>', '<parent link="tool"/>')


FOUND = {
    "digits with signs, blanks and underscores": (
        "slcan",
        b"t+121AB\rt 121AB\rt1231 A \rT0_0000011AB\r",
    ),
    "a control character among digits": ("slcan", b"t1852\x10607\rt1231\x1cA\r"),
    "links in a loop": ("urdf", _cyclic().encode()),
    "an attribute without a value": (
        "urdf",
        URDF.replace('<origin xyz="0.1 0 0"/>', "<origin><xyz/></origin>").encode(),
    ),
    "an axis beyond all numbers": ("urdf", URDF.replace("1 0 0", "1e308 1e308 1e308").encode()),
    "limits beyond all numbers": ("urdf", URDF.replace('upper="2"', 'upper="inf"').encode()),
    "a number that is none": ("result", _RESULT.replace(b"0.1", b"NaN").replace(b"1.0", b"NaN")),
    "an infinite value": ("result", _RESULT.replace(b'"value": 0', b'"value": 1e999,"x": 0')),
    "a cycle time that is a text": (
        "dbc",
        DBC.replace("INT 0 65535", "STRING").replace("BO_ 291 10;", 'BO_ 291 "10";').encode(),
    ),
    "a pose number beyond the format": ("table", b"q1_deg,pose\n1,99999999999\n"),
    "a pose number of thousands of digits": ("table", b"q1_deg,pose\n1," + b"9" * 5000 + b"\n"),
}


@pytest.mark.parametrize("found", FOUND)
def test_it_is_read_or_refused(found: str) -> None:
    name, data = FOUND[found]
    _BY_NAME[name].check(data)
