"""What can go wrong on the wire, how soon each driver notices, and as what it is reported.

One table for all built-in drivers: `DETECTION`. Times count from the moment at which the fault
begins until its event, at a sampling of `SAMPLE_HZ` and with the link being pumped; they are
what a session may rely on, and the fault matrix (``docs/fault-matrix.md``) holds each driver
to them. Where a fault cannot occur, or cannot be told by anybody, the table says why.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from recordings.faults import FaultKind

SAMPLE_HZ = 100.0


class Trouble(StrEnum):
    """What can go wrong between a device and its host."""

    UNPLUG = "unplug, replug"
    BUS_OFF = "bus-off"
    SILENCE = "silence"
    BABBLE = "babble"
    STUCK = "stuck value"
    WRONG_ID = "wrong node id"
    DUPLICATE = "duplicated node"
    CHECKSUM = "checksum errors"
    LATE = "late replies"
    FOREIGN = "foreign replies"
    GAPS = "sequence gaps"
    RESTART = "device restarts"


@dataclass(frozen=True, slots=True)
class Detected:
    """A fault is reported as the first of ``kinds`` within ``within_s`` seconds."""

    within_s: float
    kinds: tuple[FaultKind, ...]


Detection = Mapping[Trouble, Detected | str]
"""How each trouble is noticed; a text says why it cannot be."""


def _as(within_s: float, *kinds: FaultKind) -> Detected:
    return Detected(within_s, kinds)


_PORT: dict[Trouble, Detected | str] = {
    Trouble.UNPLUG: _as(0.1, FaultKind.BROKEN),
}
_CAN: dict[Trouble, Detected | str] = {
    **_PORT,
    Trouble.BUS_OFF: _as(0.2, FaultKind.BUS_OFF),
    Trouble.BABBLE: _as(0.6, FaultKind.BABBLE),
    # A line of an slcan adapter has no checksum: a digit that becomes another one is not noticed.
    Trouble.CHECKSUM: _as(0.5, FaultKind.MALFORMED, FaultKind.LOSING),
    Trouble.LATE: "data come unasked, or are tied to their request by the object that they name",
    Trouble.FOREIGN: "every frame names its sender",
}
_SERIAL: dict[Trouble, Detected | str] = {
    **_PORT,
    Trouble.BUS_OFF: "only a CAN controller can leave its bus",
}
_STREAM: dict[Trouble, Detected | str] = {
    **_SERIAL,
    Trouble.SILENCE: _as(0.2, FaultKind.SILENT),
    Trouble.BABBLE: _as(0.3, FaultKind.MALFORMED),
    Trouble.STUCK: _as(1.1, FaultKind.STUCK),
    Trouble.WRONG_ID: "the one sender of a stream has no number",
    Trouble.DUPLICATE: _as(0.3, FaultKind.MALFORMED),
    Trouble.CHECKSUM: _as(0.3, FaultKind.MALFORMED),
    Trouble.LATE: "it sends unasked: there is nothing to be late for",
    Trouble.FOREIGN: "a line has one sender; what two send at once is a duplicated node",
    Trouble.GAPS: _as(0.5, FaultKind.LOSING),
    Trouble.RESTART: _as(0.4, FaultKind.SILENT, FaultKind.RESTARTED),
}
_CANOPEN: dict[Trouble, Detected | str] = {
    **_CAN,
    Trouble.WRONG_ID: _as(0.6, FaultKind.FOREIGN, FaultKind.SILENT),
    Trouble.RESTART: _as(0.4, FaultKind.RESTARTED),
}

_NO_READING = "it delivers no reading; what stops to move shows in the sensor of its joint"
_NO_NUMBER = "it is known by the identifiers of its DBC file alone; under others it is silent"
_RECEIVES = "who only receives is driven to error passive at most, never off the bus"

_DBC: dict[Trouble, Detected | str] = {
    **_CAN,
    Trouble.SILENCE: _as(0.2, FaultKind.SILENT),
    Trouble.WRONG_ID: _NO_NUMBER,
    Trouble.DUPLICATE: _as(1.1, FaultKind.DUPLICATED),
    Trouble.RESTART: _as(0.4, FaultKind.SILENT, FaultKind.RESTARTED),
}
_DBC_DRIVE: dict[Trouble, Detected | str] = {
    **_DBC,
    Trouble.STUCK: _NO_READING,
    Trouble.GAPS: "it delivers no reading; its status is repeated, and the last one counts",
}

DETECTION: Mapping[str, Detection] = MappingProxyType(
    {
        "canopen-encoder": {
            **_CANOPEN,
            Trouble.SILENCE: _as(0.6, FaultKind.SILENT),
            Trouble.STUCK: _as(1.1, FaultKind.STUCK),
            Trouble.DUPLICATE: _as(0.3, FaultKind.DUPLICATED),
            Trouble.GAPS: _as(0.5, FaultKind.LOSING),
        },
        "canopen-joint": {
            **_CANOPEN,
            Trouble.SILENCE: _as(1.3, FaultKind.SILENT),
            Trouble.CHECKSUM: _as(1.0, FaultKind.MALFORMED),
            Trouble.STUCK: _NO_READING,
            Trouble.DUPLICATE: _as(1.2, FaultKind.DUPLICATED),
            Trouble.GAPS: "it delivers no reading; commands are answered, and repeated by who gives them",
        },
        "canopen-listener": {
            **_CAN,
            Trouble.BUS_OFF: _RECEIVES,
            Trouble.SILENCE: "a drive of another controller may have nothing to say",
            Trouble.STUCK: _NO_READING,
            Trouble.WRONG_ID: "it is heard under the number that the rig says, and no other",
            Trouble.DUPLICATE: "what two drives report under one number are reports like any other",
            Trouble.GAPS: "it delivers no reading; what another controller sends has no counter",
            Trouble.RESTART: _as(0.4, FaultKind.RESTARTED),
        },
        "dbc-encoder": {
            **_DBC,
            Trouble.BUS_OFF: _RECEIVES,
            Trouble.STUCK: _as(1.1, FaultKind.STUCK),
            Trouble.GAPS: _as(0.5, FaultKind.LOSING),
        },
        "dbc-joint": _DBC_DRIVE,
        "dbc-listener": {**_DBC_DRIVE, Trouble.BUS_OFF: _RECEIVES},
        "modbus-adc over TCP": {
            **_SERIAL,
            Trouble.SILENCE: _as(0.2, FaultKind.SILENT),
            Trouble.BABBLE: _as(0.1, FaultKind.BROKEN),
            Trouble.STUCK: _as(1.1, FaultKind.STUCK),
            Trouble.WRONG_ID: _as(0.2, FaultKind.SILENT),
            Trouble.DUPLICATE: "a connection leads to one server",
            Trouble.CHECKSUM: "TCP repeats what arrives damaged, until it arrives whole",
            Trouble.LATE: _as(0.3, FaultKind.LATE, FaultKind.SILENT),
            Trouble.FOREIGN: _as(0.2, FaultKind.FOREIGN),
            Trouble.GAPS: _as(0.4, FaultKind.SILENT, FaultKind.LOSING),
            Trouble.RESTART: _as(0.4, FaultKind.SILENT, FaultKind.RESTARTED),
        },
        "cobs-adc": _STREAM,
        "ascii-adc": _STREAM,
        "modbus-adc": {
            **_SERIAL,
            Trouble.SILENCE: _as(0.2, FaultKind.SILENT),
            Trouble.BABBLE: _as(0.6, FaultKind.BABBLE),
            Trouble.STUCK: _as(1.1, FaultKind.STUCK),
            Trouble.WRONG_ID: _as(0.2, FaultKind.SILENT),
            Trouble.DUPLICATE: _as(0.3, FaultKind.MALFORMED),
            Trouble.CHECKSUM: _as(0.3, FaultKind.MALFORMED),
            Trouble.LATE: _as(0.3, FaultKind.LATE, FaultKind.SILENT),
            Trouble.FOREIGN: _as(0.2, FaultKind.FOREIGN),
            Trouble.GAPS: _as(0.4, FaultKind.SILENT, FaultKind.LOSING),
            Trouble.RESTART: _as(0.4, FaultKind.SILENT, FaultKind.RESTARTED),
        },
    }
)
"""Of each built-in driver, how each trouble is noticed; a driver for two kinds of port has two rows."""
