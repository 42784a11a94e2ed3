"""Messages and signals of a DBC file, found by the names that a rig uses.

The file is parsed by ``cantools``. Which bits a signal has is `drivers.dbc.layout`'s; this
module says which frame carries it, when a multiplexed signal is present, and how often the
message should come (attribute ``GenMsgCycleTime``).
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass, replace

from cantools.database import load_string
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import Error

from drivers.can_bus import EXTENDED
from drivers.dbc.layout import SignalLayout
from drivers.errors import OptionError

_LONGEST_CYCLE_MS = 86_400_000


@dataclass(frozen=True, slots=True)
class DbcSignal:
    """A signal of a message.

    Attributes:
        layout: where it is.
        present_if: multiplexer signals and the values with which this one is present; all hold.
    """

    layout: SignalLayout
    present_if: tuple[tuple[SignalLayout, frozenset[int]], ...]

    @property
    def multiplexed(self) -> bool:
        """Whether only some frames of its message have it."""
        return bool(self.present_if)

    @property
    def reader(self) -> Callable[[bytes], int | None]:
        """The same as `raw`, without asking each frame what is true of all."""
        return self.raw if self.present_if else self.layout.raw

    @property
    def unsigned(self) -> DbcSignal:
        """The same bits as a number from 0 on."""
        return replace(self, layout=replace(self.layout, signed=False))

    def raw(self, data: bytes) -> int | None:
        """Raw value in a frame's ``data``, None where this frame has it not; raises Malformed."""
        for switch, values in self.present_if:
            if switch.raw(data) not in values:
                return None
        return self.layout.raw(data)


class DbcMessage:
    """A message.

    Attributes:
        name: as in the DBC.
        identifier: CAN identifier, bit 31 set where it has 29 bits.
        length: bytes.
        period_ns: time between two of them, None where the DBC does not say.
    """

    def __init__(self, message: Message, where: str) -> None:
        self.name = message.name
        self.identifier = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        self.length = message.length
        self.period_ns = _period_ns(message.cycle_time)
        self._signals = {signal.name: signal for signal in message.signals}
        self._where = f"{where}: message '{message.name}'"

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Names of its signals."""
        return tuple(self._signals)

    def signal(self, name: str) -> DbcSignal:
        """The signal called ``name``; raises OptionError where there is none, or it has no counts."""
        if name not in self._signals:
            raise OptionError(
                f"{self._where} has no signal '{name}'; it has: {', '.join(self._signals)}"
            )
        signal = self._signals[name]
        if signal.is_float:
            raise OptionError(
                f"{self._where}: signal '{name}' is a floating-point number, but counts are "
                f"recorded; choose an integer signal"
            )
        switches = []
        inner = signal
        while inner.multiplexer_signal is not None:
            outer = self._signals[inner.multiplexer_signal]
            switches.append((_layout(outer), frozenset(inner.multiplexer_ids or ())))
            inner = outer
        return DbcSignal(_layout(signal), tuple(switches))


class DbcFile:
    """The messages of one DBC file.

    Args:
        text: the file.
        where: what to call it in messages.

    Raises:
        OptionError: it is no DBC file.
    """

    def __init__(self, text: str, where: str) -> None:
        self._where = where
        try:
            # Vendors' files have overlapping signals; what is asked for can be read all the same.
            database = load_string(text, database_format="dbc", strict=False)
        except (Error, ValueError, KeyError) as error:
            raise OptionError(f"{where} is not a DBC file: {error}") from error
        if not isinstance(database, Database):
            raise OptionError(f"{where} describes no CAN messages")
        self._messages = {message.name: message for message in database.messages}

    def message(self, name: str) -> DbcMessage:
        """The message called ``name``; raises OptionError."""
        if name not in self._messages:
            near = difflib.get_close_matches(name, self._messages, n=3) or list(self._messages)[:20]
            raise OptionError(
                f"{self._where} has no message '{name}'; it has {len(self._messages)}, "
                f"such as: {', '.join(near)}"
            )
        return DbcMessage(self._messages[name], self._where)

    def find(self, reference: str) -> tuple[DbcMessage, str]:
        """The message and signal that ``Message.Signal``, or a ``Signal`` of one message, names.

        Raises:
            OptionError: there is none, or several messages have such a signal.
        """
        owner, dot, name = reference.rpartition(".")
        if dot:
            message = self.message(owner)
            message.signal(name)
            return message, name
        owners = [m.name for m in self._messages.values() if _has(m, name)]
        if len(owners) != 1:
            raise OptionError(
                f"{self._where} has the signal '{name}' in "
                f'{"no message" if not owners else ", ".join(owners)}; write "MESSAGE.SIGNAL"'
            )
        return self.message(owners[0]), name


def _period_ns(cycle_ms: object) -> int | None:
    """A cycle time; None where the file gives none, or something else than a time."""
    if not isinstance(cycle_ms, int | float) or not 0 < cycle_ms < _LONGEST_CYCLE_MS:
        return None
    return round(cycle_ms * 1e6)


def _has(message: Message, name: str) -> bool:
    return any(signal.name == name for signal in message.signals)


def _layout(signal: Signal) -> SignalLayout:
    return SignalLayout(
        name=signal.name,
        start=signal.start,
        length=signal.length,
        little_endian=signal.byte_order == "little_endian",
        signed=signal.is_signed,
    )
