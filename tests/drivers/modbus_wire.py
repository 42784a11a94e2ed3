"""A serial line in memory with scripted Modbus slaves; checksums are those of pymodbus."""

from __future__ import annotations

from pymodbus.framer import FramerRTU

from recordings.rig import SerialPort


def frame(*body: int) -> bytes:
    return bytes(body) + FramerRTU.compute_CRC(bytes(body)).to_bytes(2, "big")


class Adc:
    """A converter with a counter in register 0 and its signals behind; each read is a sample."""

    def __init__(self, unit: int = 1) -> None:
        self.unit = unit
        self.samples = 0
        self.frozen = False

    def answer(self, request: bytes) -> bytes:
        unit, function = request[0], request[1]
        address, count = int.from_bytes(request[2:4], "big"), int.from_bytes(request[4:6], "big")
        if unit != self.unit:
            return b""
        if function != 4:
            return frame(unit, function | 0x80, 1)
        self.samples += not self.frozen
        registers = [self.samples % 65536, (1000 + self.samples) % 65536, 0xFFFE]
        data = b"".join(r.to_bytes(2, "big") for r in registers[address : address + count])
        return frame(unit, function, len(data), *data)


class Wire:
    """A serial stream in memory. ``mangle`` turns the reply to request number n into what arrives.

    What ``mangle`` withholds into ``held`` comes in front of the next reply: a late reply.
    """

    def __init__(self, *slaves: Adc) -> None:
        self.slaves = slaves
        self.requests: list[bytes] = []
        self.plugged = True
        self.opened = 0
        self.held = b""
        self.mangle = lambda number, reply: reply
        self._buffer = b""

    def connect(self, _port: SerialPort) -> Wire:
        self._check()
        self.opened += 1
        return self

    def _check(self) -> None:
        if not self.plugged:
            raise FileNotFoundError(2, "No such file or directory")

    def read(self, timeout_s: float | None) -> bytes:
        self._check()
        data, self._buffer = self._buffer, b""
        return data

    def write(self, data: bytes) -> None:
        self._check()
        self.requests.append(bytes(data))
        reply = b"".join(slave.answer(data) for slave in self.slaves)
        late, self.held = self.held, b""
        self._buffer += late + self.mangle(len(self.requests), reply)

    def close(self) -> None:
        pass

    def arrive(self, data: bytes) -> None:
        self._buffer += data
