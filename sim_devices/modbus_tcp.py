"""A Modbus TCP server: bytes in, bytes out. Function codes are those of `sim_devices.modbus`.

    transaction u16, protocol u16 = 0, length u16, unit u8, PDU     all big-endian

Requests for other units get no answer, as from a gateway without that unit. A head that is
none (a protocol other than 0, an impossible length) ends the connection's sense: everything
after it is dropped, and counted once.

Source: Modbus Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3.
"""

from __future__ import annotations

from sim_devices.modbus import Functions, LineCounts, RegisterMap

HEAD = 7
LONGEST = 254
"""Largest length field: unit and PDU."""


class TcpServer:
    """One unit behind a connection; see `sim_devices.line.SerialDevice`.

    Attributes:
        unit_id: 0..255.
        counts: requests obeyed or refused, heads that were none, requests for other units.
    """

    def __init__(self, unit_id: int, registers: RegisterMap) -> None:
        self.unit_id = unit_id
        self.counts = LineCounts()
        self._functions = Functions(registers)
        self._buffer = b""
        self._lost = False

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes from the connection, in pieces of any size; returns what to answer."""
        if self._lost:
            return b""
        self._buffer += data
        answer = b""
        while len(self._buffer) >= HEAD:
            length = int.from_bytes(self._buffer[4:6], "big")
            if self._buffer[2:4] != b"\0\0" or not 2 <= length <= LONGEST:
                self.counts.bad_frames += 1
                self._lost = True
                break
            end = HEAD - 1 + length
            if len(self._buffer) < end:
                break
            frame, self._buffer = self._buffer[:end], self._buffer[end:]
            answer += self._serve(frame, time_s)
        return answer

    def tick(self, time_s: float) -> bytes:
        """Time means nothing here."""
        return b""

    def hang_up(self) -> None:
        """The host has closed the connection: the next begins anew."""
        self._buffer = b""
        self._lost = False

    def _serve(self, frame: bytes, time_s: float) -> bytes:
        if frame[6] != self.unit_id:
            self.counts.foreign += 1
            return b""
        self.counts.requests += 1
        pdu = self._functions.answer(frame[HEAD:], time_s)
        return frame[:4] + (1 + len(pdu)).to_bytes(2, "big") + frame[6:7] + pdu
