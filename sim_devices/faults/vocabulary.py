"""Every fault that a virtual bench can have: its verb, what it can befall, and how much of it.

This table is the vocabulary of fault scripts, the source of their error messages and of the
table in ``docs/howto-faults.md``. What a fault does is said by `sim_devices.faults.wiring`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class Target(StrEnum):
    """What a fault can befall."""

    CAN_PORT = "a CAN port"
    LINE_PORT = "a serial or TCP port"
    CAN_DEVICE = "a device on a CAN port"
    LINE_DEVICE = "a device on a serial or TCP port"
    CHANNEL = "a channel"


class Amount(StrEnum):
    """How much of a fault there is, as it is written."""

    NONE = ""
    PERCENT = "P %"
    RATE = "N /s"
    ADDRESS = "to N"
    TIME = "T s"


PORTS = (Target.CAN_PORT, Target.LINE_PORT)
DEVICES = (Target.CAN_DEVICE, Target.LINE_DEVICE)


@dataclass(frozen=True, slots=True)
class FaultType:
    """One kind of fault.

    Attributes:
        verb: how scripts call it.
        befalls: what it can befall.
        amount: how much of it there is.
        lasts: whether it has a duration; what does not, happens once.
        text: what it does, in a sentence.
    """

    verb: str
    befalls: tuple[Target, ...]
    amount: Amount
    lasts: bool
    text: str

    @property
    def target(self) -> str:
        """What it can befall, in words."""
        words: list[str] = list(self.befalls)
        for group, word in ((PORTS, "a port"), (DEVICES, "a device")):
            if set(group) <= set(self.befalls):
                words = [word, *(each for each in words if each not in group)]
        return " or ".join(words)


FAULTS: Mapping[str, FaultType] = {
    fault.verb: fault
    for fault in (
        FaultType(
            "unplug",
            (*PORTS, *DEVICES),
            Amount.NONE,
            True,
            "The port disappears; a device on a shared bus neither hears nor is heard.",
        ),
        FaultType(
            "bus-off",
            (Target.CAN_PORT,),
            Amount.NONE,
            True,
            "The CAN controller leaves the bus; it comes back when the channel is opened again afterwards.",
        ),
        FaultType(
            "silence",
            (*PORTS, *DEVICES),
            Amount.NONE,
            True,
            "Devices hear and obey, and say nothing.",
        ),
        FaultType(
            "babble",
            PORTS,
            Amount.RATE,
            True,
            "Frames (CAN) or bytes (serial) that nobody asked for, so many a second.",
        ),
        FaultType(
            "stick",
            (*DEVICES, Target.CHANNEL),
            Amount.NONE,
            True,
            "What is sensed keeps the value that it has; everything else goes on.",
        ),
        FaultType(
            "renumber",
            DEVICES,
            Amount.ADDRESS,
            True,
            "The device loses its power and comes back with another node or unit number.",
        ),
        FaultType(
            "duplicate",
            DEVICES,
            Amount.NONE,
            True,
            "A second device of the same number appears; on a serial line what they say collides.",
        ),
        FaultType(
            "corrupt",
            (*PORTS, Target.LINE_DEVICE),
            Amount.PERCENT,
            True,
            "So many of the messages arrive with a bit flipped; on a CAN interface other than slcan, as error frames.",
        ),
        FaultType(
            "drop",
            (*PORTS, *DEVICES),
            Amount.PERCENT,
            True,
            "So many of the messages are lost on the way to the host.",
        ),
        FaultType(
            "delay",
            (*PORTS, *DEVICES),
            Amount.TIME,
            True,
            "What is said arrives so much later.",
        ),
        FaultType(
            "foreign",
            (Target.LINE_DEVICE,),
            Amount.NONE,
            True,
            "A valid Modbus reply of another unit comes in front of each of its own.",
        ),
        FaultType(
            "restart",
            DEVICES,
            Amount.NONE,
            False,
            "The device loses its power and boots: counters and settings begin anew.",
        ),
    )
}

ADDRESS_KEYS = ("node_id", "unit_id")
"""Options that are a device's number on its bus or line."""

END = "end"
"""``end VERB TARGET`` ends a fault that was begun without a duration."""

REPLUG = "replug"
"""``replug TARGET`` is another way to say ``end unplug TARGET``."""
