"""The SDO server, byte for byte as CiA 301 lays out its transfers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_devices.canopen.dictionary import I8, U8, U16, U32, AbortCode, ObjectDictionary, Refused
from sim_devices.canopen.sdo import SdoServer

TEXT = "loopcal virtual encoder"


@pytest.fixture
def dictionary() -> ObjectDictionary:
    made = ObjectDictionary()
    made.add(0x1000, 0, U32, read=0x00010196)
    made.add_text(0x1008, TEXT)
    made.add_register(0x1017, 0, U16, 0)
    made.add_register(0x6060, 0, I8, 0, low=-1, high=4)
    made.add(0x2000, 1, U8, read=7)
    made.add_register(0x2000, 2, U32, 0)
    made.add(0x2001, 0, U16, write=lambda value: None)
    return made


@pytest.fixture
def server(dictionary: ObjectDictionary) -> SdoServer:
    return SdoServer(dictionary)


def ask(server: SdoServer, request: str) -> str:
    answer = server.answer(bytes.fromhex(request))
    assert answer is not None
    return answer.hex(" ")


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        # Upload of 4, 2 and 1 bytes, expedited: 0x43, 0x4B, 0x4F.
        ("40 00 10 00 00 00 00 00", "43 00 10 00 96 01 01 00"),
        ("40 17 10 00 00 00 00 00", "4b 17 10 00 00 00 00 00"),
        ("40 00 20 01 00 00 00 00", "4f 00 20 01 07 00 00 00"),
        # Download of 2 and 4 bytes with size, and without.
        ("2b 17 10 00 e8 03 00 00", "60 17 10 00 00 00 00 00"),
        ("23 00 20 02 01 02 03 04", "60 00 20 02 00 00 00 00"),
        ("22 17 10 00 e8 03 00 00", "60 17 10 00 00 00 00 00"),
        # Aborts: no object, no sub-index, read only, write only, too long, too short, range.
        ("40 00 30 00 00 00 00 00", "80 00 30 00 00 00 02 06"),
        ("40 00 20 09 00 00 00 00", "80 00 20 09 11 00 09 06"),
        ("23 00 10 00 00 00 00 00", "80 00 10 00 02 00 01 06"),
        ("40 01 20 00 00 00 00 00", "80 01 20 00 01 00 01 06"),
        ("23 17 10 00 00 00 00 00", "80 17 10 00 12 00 07 06"),
        ("2f 17 10 00 00 00 00 00", "80 17 10 00 13 00 07 06"),
        ("2f 60 60 00 05 00 00 00", "80 60 60 00 30 00 09 06"),
        # Block upload and block download, and an unused specifier.
        ("a0 08 10 00 7f 00 00 00", "80 08 10 00 01 00 04 05"),
        ("c2 17 10 00 02 00 00 00", "80 17 10 00 01 00 04 05"),
        ("e0 17 10 00 00 00 00 00", "80 17 10 00 01 00 04 05"),
        # A segment that belongs to nothing.
        ("60 00 00 00 00 00 00 00", "80 00 00 00 01 00 04 05"),
        ("00 00 00 00 00 00 00 00", "80 00 00 00 01 00 04 05"),
    ],
)
def test_one_request(server: SdoServer, request_: str, answer: str) -> None:
    assert ask(server, request_) == answer


def test_what_was_written_is_read(server: SdoServer) -> None:
    ask(server, "2b 17 10 00 e8 03 00 00")
    assert ask(server, "40 17 10 00 00 00 00 00") == "4b 17 10 00 e8 03 00 00"
    ask(server, "2f 60 60 00 ff 00 00 00")
    assert ask(server, "40 60 60 00 00 00 00 00") == "4f 60 60 00 ff 00 00 00"


def test_refused_write_changes_nothing(server: SdoServer) -> None:
    ask(server, "2f 60 60 00 04 00 00 00")
    ask(server, "2f 60 60 00 05 00 00 00")
    assert ask(server, "40 60 60 00 00 00 00 00") == "4f 60 60 00 04 00 00 00"


def test_text_comes_in_segments(server: SdoServer) -> None:
    assert ask(server, "40 08 10 00 00 00 00 00") == "41 08 10 00 17 00 00 00"
    # 23 bytes: three full segments, then two bytes with 5 unused and the last-segment bit.
    assert ask(server, "60 00 00 00 00 00 00 00") == "00 " + b"loopcal".hex(" ")
    assert ask(server, "70 00 00 00 00 00 00 00") == "10 " + b" virtua".hex(" ")
    assert ask(server, "60 00 00 00 00 00 00 00") == "00 " + b"l encod".hex(" ")
    assert ask(server, "70 00 00 00 00 00 00 00") == "1b 65 72 00 00 00 00 00"
    assert ask(server, "60 00 00 00 00 00 00 00").startswith("80 ")


def test_toggle_must_alternate(server: SdoServer) -> None:
    ask(server, "40 08 10 00 00 00 00 00")
    assert ask(server, "70 00 00 00 00 00 00 00") == "80 08 10 00 00 00 03 05"
    # The transfer is over.
    assert ask(server, "60 00 00 00 00 00 00 00") == "80 00 00 00 01 00 04 05"


def test_segmented_download(server: SdoServer) -> None:
    assert ask(server, "21 00 20 02 04 00 00 00") == "60 00 20 02 00 00 00 00"
    assert ask(server, "07 78 56 34 12 00 00 00") == "20 00 00 00 00 00 00 00"
    assert ask(server, "40 00 20 02 00 00 00 00") == "43 00 20 02 78 56 34 12"


def test_segmented_download_of_a_wrong_length_is_refused(server: SdoServer) -> None:
    ask(server, "21 00 20 02 07 00 00 00")
    assert ask(server, "01 01 02 03 04 05 06 07") == "80 00 20 02 12 00 07 06"
    ask(server, "21 17 10 00 ff ff 00 00")
    assert ask(server, "21 17 10 00 ff ff 00 00") == "80 17 10 00 05 00 04 05"


def test_abort_of_the_client_ends_the_transfer(server: SdoServer) -> None:
    ask(server, "40 08 10 00 00 00 00 00")
    assert server.answer(bytes.fromhex("80 08 10 00 00 00 04 05")) is None
    assert ask(server, "60 00 00 00 00 00 00 00") == "80 00 00 00 01 00 04 05"


@pytest.mark.parametrize("length", [0, 1, 7])
def test_short_request_gets_no_response(server: SdoServer, length: int) -> None:
    assert server.answer(bytes(length)) is None


@given(st.lists(st.binary(min_size=8, max_size=8), max_size=30))
def test_any_request_gets_eight_bytes_or_none(requests: list[bytes]) -> None:
    made = ObjectDictionary()
    made.add_text(0x1008, TEXT)
    made.add_register(0x1017, 0, U16, 0)
    server = SdoServer(made)
    for request in requests:
        answer = server.answer(request)
        assert (answer is None) == (request[0] >> 5 == 4)
        assert answer is None or len(answer) == 8


def test_refusal_says_its_code(dictionary: ObjectDictionary) -> None:
    with pytest.raises(Refused, match="0x06020000") as caught:
        dictionary.read(0x3000, 0)
    assert caught.value.code is AbortCode.NO_SUCH_OBJECT
