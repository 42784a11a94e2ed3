"""Fault scripts: plain lines to orders. Pure; knows the rig's names, no bench and no clock.

    at 3 s unplug wrist-adc for 2 s      # a comment
    at 5 s silence encoder-3 for 1 s
    at 2 s corrupt wrist-adc 10 %
    at 9 s end corrupt wrist-adc
    restart encoder-2

    line   = [ "at" TIME ] VERB TARGET [ AMOUNT ] [ "for" TIME ]
           | [ "at" TIME ] "end" VERB TARGET
           | [ "at" TIME ] "replug" TARGET
    TIME   = NUMBER ( "s" | "ms" )
    AMOUNT = NUMBER "%" | NUMBER "/s" | "to" NUMBER | TIME

Verbs, what they can befall and their amounts are the table `vocabulary.FAULTS`. A unit may
stand at its number without a space. Without ``at``, a line means now: the beginning of a script,
or the moment at which it is typed. Without ``for``, a fault lasts until it is ended.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from recordings.rig import CanPort, Rig
from sim_devices.errors import SimDevicesError
from sim_devices.faults.vocabulary import (
    ADDRESS_KEYS,
    END,
    FAULTS,
    REPLUG,
    Amount,
    FaultType,
    Target,
)

NUMBER = re.compile(r"(\d+(?:\.\d+)?)(.*)")
TIME_UNITS = {"s": 1.0, "ms": 1e-3}


class ScriptError(SimDevicesError):
    """A fault script that cannot be understood; the message names line and word."""


@dataclass(frozen=True, slots=True)
class Order:
    """One line of a script.

    Attributes:
        at_s: when [s of the bench's time], or None for now.
        fault: what begins or ends.
        target: port, device or channel of the rig.
        ends: whether it ends what was begun.
        amount: how much [per cent, 1/s, number, or s], None where there is none.
        for_s: how long [s], None until it is ended.
        text: the line as it was written, without its time.
    """

    at_s: float | None
    fault: FaultType
    target: str
    ends: bool = False
    amount: float | None = None
    for_s: float | None = None
    text: str = ""


def parse(text: str, rig: Rig) -> tuple[Order, ...]:
    """The orders of a script, in the order of its lines; raises ScriptError."""
    orders = []
    for number, line in enumerate(text.splitlines(), start=1):
        order = parse_line(line, rig, number)
        if order is not None:
            orders.append(order)
    return tuple(orders)


def parse_line(line: str, rig: Rig, number: int = 1) -> Order | None:
    """The order of one line, None where there is nothing but a comment; raises ScriptError."""
    words = line.partition("#")[0].split()
    return _Line(words, rig, number).order() if words else None


def targets(rig: Rig) -> dict[str, set[Target]]:
    """What a script can name in ``rig``, with what it is; a name may be more than one thing."""
    found: dict[str, set[Target]] = {}
    can = {port.name for port in rig.ports if isinstance(port, CanPort)}
    for port in rig.ports:
        kind = Target.CAN_PORT if port.name in can else Target.LINE_PORT
        found.setdefault(port.name, set()).add(kind)
    for device in rig.devices:
        kind = Target.CAN_DEVICE if device.port in can else Target.LINE_DEVICE
        found.setdefault(device.name, set()).add(kind)
    for channel in rig.channels:
        found.setdefault(channel.name, set()).add(Target.CHANNEL)
    return found


class _Line:
    """A recursive-descent reader of one line."""

    def __init__(self, words: Sequence[str], rig: Rig, number: int) -> None:
        self._words = list(words)
        self._text = " ".join(words)
        self._at = 0
        self._number = number
        self._rig = rig
        self._said = self._text
        self._targets = targets(rig)

    def order(self) -> Order:
        at_s = self._time("at") if self._take("at") else None
        self._said = " ".join(self._words[self._at :])
        if self._take(REPLUG):
            fault = FAULTS["unplug"]
            order = Order(at_s, fault, self._target(fault), ends=True, text=self._said)
        elif self._take(END):
            fault = self._fault()
            if not fault.lasts:
                raise self._wrong(f"'{fault.verb}' happens once and has no end", back=1)
            order = Order(at_s, fault, self._target(fault), ends=True, text=self._said)
        else:
            order = self._begin(at_s)
        if self._at < len(self._words):
            raise self._wrong("the line should end here" + self._rest_of(order))
        return order

    def _begin(self, at_s: float | None) -> Order:
        fault = self._fault()
        target = self._target(fault)
        amount = self._amount(fault)
        for_s: float | None = None
        if fault.lasts and self._take("for"):
            for_s = self._time("for")
        return Order(at_s, fault, target, amount=amount, for_s=for_s, text=self._said)

    def _fault(self) -> FaultType:
        known = sorted(FAULTS)
        word = self._next(f"a fault: {', '.join(known)}")
        if word not in FAULTS:
            first = [*known, END, REPLUG, *(["at"] if self._at == 1 else [])]
            raise self._wrong(
                f"expected a fault ({', '.join(known)}), '{END}' or '{REPLUG}'{_near(word, first)}",
                back=1,
            )
        return FAULTS[word]

    def _target(self, fault: FaultType) -> str:
        fitting = sorted(n for n, kinds in self._targets.items() if kinds & set(fault.befalls))
        befalls = fault.target
        known = ", ".join(fitting) or "(this rig has none)"
        word = self._next(f"{befalls}: {known}")
        if word not in self._targets:
            raise self._wrong(
                f"expected {befalls}, of this rig: {known}{_near(word, fitting)}", back=1
            )
        if fault.amount is Amount.ADDRESS and not self._numbered(word):
            raise self._wrong(
                f"that has no {' or '.join(ADDRESS_KEYS)} in the rig, so it cannot have another",
                back=1,
            )
        if word not in fitting:
            kinds = " and ".join(sorted(self._targets[word]))
            raise self._wrong(
                f"that is {kinds}; '{fault.verb}' befalls {befalls}, of this rig: {known}", back=1
            )
        return word

    def _numbered(self, name: str) -> bool:
        options = [device.options for device in self._rig.devices if device.name == name]
        return not options or any(key in options[0] for key in ADDRESS_KEYS)

    def _amount(self, fault: FaultType) -> float | None:
        what = f"'{fault.verb}' needs '{fault.amount}'"
        match fault.amount:
            case Amount.NONE:
                return None
            case Amount.TIME:
                return self._time(fault.verb)
            case Amount.ADDRESS:
                if not self._take("to"):
                    raise self._wrong(f"{what}, such as 'to 9'")
                number = self._value(what)
                if number != int(number) or not 1 <= number <= 247:
                    raise self._wrong(f"{what}, N a whole number from 1 to 247", back=1)
                return number
            case Amount.PERCENT:
                number = self._value(what)
                if not self._take("%"):
                    raise self._wrong(f"{what}, such as '10 %'")
                if not 0 < number <= 100:
                    raise self._wrong(f"{what}, P above 0 and at most 100", back=1)
                return number
            case Amount.RATE:
                number = self._value(what)
                if not self._take("/s"):
                    raise self._wrong(f"{what}, such as '5000 /s'")
                return number

    def _time(self, after: str) -> float:
        what = f"expected a time after '{after}', such as '3 s' or '250 ms'"
        value = self._value(what)
        unit = self._next(", ".join(TIME_UNITS))
        if unit not in TIME_UNITS:
            raise self._wrong(f"{what}; units of time are: {', '.join(TIME_UNITS)}", back=1)
        return value * TIME_UNITS[unit]

    def _value(self, what: str) -> float:
        word = self._next(what)
        found = NUMBER.fullmatch(word)
        if found is None:
            raise self._wrong(what, back=1)
        if found[2]:
            self._words.insert(self._at, found[2])
        return float(found[1])

    def _take(self, word: str) -> bool:
        if self._at < len(self._words) and self._words[self._at] == word:
            self._at += 1
            return True
        return False

    def _next(self, expected: str) -> str:
        if self._at >= len(self._words):
            raise ScriptError(
                f"line {self._number} of the fault script, '{self._text}', ends too early; "
                f"expected {expected}"
            )
        self._at += 1
        return self._words[self._at - 1]

    def _wrong(self, complaint: str, back: int = 0) -> ScriptError:
        at = self._at - back
        word = f"word {at + 1}, '{self._words[at]}'" if at < len(self._words) else "the end"
        return ScriptError(
            f"line {self._number} of the fault script, '{self._text}', {word}: {complaint}"
        )

    def _rest_of(self, order: Order) -> str:
        if order.ends or order.for_s is not None:
            return ""
        if not order.fault.lasts:
            return f"; '{order.fault.verb}' happens once and has no duration"
        return ", or go on with 'for' and a time"


def _near(word: str, known: Iterable[str]) -> str:
    found = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean '{found[0]}'?" if found else ""
