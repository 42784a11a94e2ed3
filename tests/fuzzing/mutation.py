"""Changes to valid inputs: bytes, and for text also lines, words and numbers. Pure.

All choices come from the `random.Random` that is handed in, so that a seed, or hypothesis,
repeats them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from random import Random

from tests.fuzzing.target import Target

MOST_CHANGES = 6
LONGEST = 1 << 20

_NUMBERS = (
    b"0 1 -1 -0 2 3 7 8 255 256 65535 65536 2147483648 -2147483649 9223372036854775807 "
    b"-9223372036854775808 9223372036854775808 1e308 1e309 -1e309 1e-320 0.1 1.5 nan inf -inf "
    b"NaN Infinity 1_000 0x10 +5 99999999999999999999999999 '' [] {} true false null"
).split()
_STRANGE = tuple(
    "\0 \ufeff \u2028 ä 😀 \udce4 \x1b[31m % {} ' \" \\ , ; = [ ] # \n \r \t ../x".encode(
        "utf-8", "surrogatepass"
    ).split(b" ")
)
_WORD = re.compile(rb"[A-Za-z_][\w.-]*")
_NUMBER = re.compile(rb"[-+]?\d[\d_]*\.?\d*(?:[eE][-+]?\d+)?")
_SIZES = (0, 1, 7, 8, 255, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63)


def mutated(target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    """One of ``seeds``, changed in one to six ways."""
    data = random.choice(seeds)
    changes = _BYTES + _TEXT if target.text else _BYTES
    for _ in range(random.randint(1, MOST_CHANGES)):
        data = random.choice(changes)(data, target, seeds, random)[:LONGEST]
    return data


def flipped(data: bytes, random: Random) -> bytes:
    """``data`` with one to three bits turned."""
    out = bytearray(data)
    for bit in random.sample(range(8 * len(out)), min(random.randint(1, 3), 8 * len(out))):
        out[bit // 8] ^= 1 << bit % 8
    return bytes(out)


def _span(data: bytes, random: Random) -> tuple[int, int]:
    """A stretch of ``data``: most are short."""
    start = random.randint(0, len(data))
    size = random.choice((1, 2, 4, 8, 9, 31, 64, 500, len(data)))
    return start, min(len(data), start + random.randint(0, size))


def _flip(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    return flipped(data, random)


def _set_byte(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    at = random.randint(0, max(len(data) - 1, 0))
    return data[:at] + bytes([random.randint(0, 255)]) + data[at + 1 :]


def _set_size(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    """A number as formats hold their lengths, extreme or near the length of the input."""
    width = random.choice((1, 2, 4, 8))
    value = random.choice((*_SIZES, len(data), random.randint(0, len(data) + 10)))
    order = random.choice(("little", "big"))
    at = random.randint(0, len(data))
    return data[:at] + (value % 2 ** (8 * width)).to_bytes(width, order) + data[at + width :]


def _drop(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    start, end = _span(data, random)
    return data[:start] + data[end:]


def _cut(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    return data[: random.randint(0, len(data))]


def _repeat(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    start, end = _span(data, random)
    at, times = random.randint(0, len(data)), random.choice((1, 1, 2, 50))
    return data[:at] + data[start:end] * times + data[at:]


def _splice(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    other = random.choice(seeds)
    start, end = _span(other, random)
    at, upto = _span(data, random)
    return data[:at] + other[start:end] + data[upto:]


def _insert(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    known = (*target.tokens, random.randbytes(random.randint(1, 12)))
    at = random.randint(0, len(data))
    return data[:at] + random.choice(known) + data[at:]


def _change_number(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    return _replaced(data, _NUMBER, random.choice(_NUMBERS), random)


def _change_word(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    words = _WORD.findall(random.choice(seeds)) or [b"x"]
    return _replaced(data, _WORD, random.choice((*words, *target.tokens, *_STRANGE)), random)


def _change_line(data: bytes, target: Target, seeds: Sequence[bytes], random: Random) -> bytes:
    lines = data.split(b"\n")
    at, other = random.randrange(len(lines)), random.randrange(len(lines))
    what = random.randrange(4)
    if what == 0:
        del lines[at]
    elif what == 1:
        lines.insert(at, lines[other])
    elif what == 2:
        lines[at], lines[other] = lines[other], lines[at]
    else:
        lines[at] = lines[at] + random.choice((*_STRANGE, *target.tokens))
    return b"\n".join(lines)


def _replaced(data: bytes, what: re.Pattern[bytes], by: bytes, random: Random) -> bytes:
    found = list(what.finditer(data))
    if not found:
        return data + by
    start, end = random.choice(found).span()
    return data[:start] + by + data[end:]


_Change = Callable[[bytes, Target, Sequence[bytes], Random], bytes]
_BYTES: tuple[_Change, ...] = (
    _flip,
    _set_byte,
    _set_size,
    _drop,
    _cut,
    _repeat,
    _splice,
    _insert,
)
_TEXT: tuple[_Change, ...] = 2 * (_change_number, _change_word, _change_line)
