"""The SDO server of a CANopen node (CiA 301, "Service data object"): 8 bytes in, 8 bytes out.

Expedited and segmented transfers both ways; block transfers are refused with "command
specifier not valid". One transfer at a time: a new initiate replaces an unfinished one, as
a client that gave up expects. Knows no clock, so an unfinished transfer waits for ever.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from sim_devices.canopen.dictionary import AbortCode, ObjectDictionary, Refused

MULTIPLEXER = struct.Struct("<BHB")
LONGEST_DOWNLOAD = 1024
"""A download that announces or sends more than this is refused: no object here is that long."""

SEGMENT = 7

CLIENT_DOWNLOAD_SEGMENT, CLIENT_DOWNLOAD, CLIENT_UPLOAD, CLIENT_UPLOAD_SEGMENT, ABORT = range(5)
"""Client command specifiers: the upper three bits of a request's first byte."""


@dataclass(slots=True)
class _Transfer:
    """A segmented transfer under way: ``data`` still to be sent, or received so far."""

    index: int
    sub: int
    upload: bool
    data: bytearray
    toggle: int = 0


class SdoServer:
    """Serves one client from an object dictionary."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._transfer: _Transfer | None = None

    def answer(self, request: bytes) -> bytes | None:
        """The response to a request: 8 bytes, or None where the protocol has none.

        Requests that are not 8 bytes long are no SDO requests and get no response.
        """
        if len(request) != 8:
            return None
        specifier = request[0] >> 5
        _, index, sub = MULTIPLEXER.unpack_from(request)
        if specifier in (CLIENT_DOWNLOAD_SEGMENT, CLIENT_UPLOAD_SEGMENT):
            index, sub = (self._transfer.index, self._transfer.sub) if self._transfer else (0, 0)
        try:
            if specifier == CLIENT_UPLOAD:
                return self._upload(index, sub)
            if specifier == CLIENT_DOWNLOAD:
                return self._download(request, index, sub)
            if specifier == CLIENT_UPLOAD_SEGMENT:
                return self._upload_segment(request[0])
            if specifier == CLIENT_DOWNLOAD_SEGMENT:
                return self._download_segment(request)
            if specifier == ABORT:
                self._transfer = None
                return None
            raise Refused(AbortCode.COMMAND_SPECIFIER_INVALID)
        except Refused as refused:
            self._transfer = None
            return MULTIPLEXER.pack(0x80, index, sub) + refused.code.to_bytes(4, "little")

    def _upload(self, index: int, sub: int) -> bytes:
        self._transfer = None
        data = self._dictionary.read(index, sub)
        if 1 <= len(data) <= 4:
            command = 0x43 | (4 - len(data)) << 2
            return MULTIPLEXER.pack(command, index, sub) + data.ljust(4, b"\0")
        self._transfer = _Transfer(index, sub, upload=True, data=bytearray(data))
        return MULTIPLEXER.pack(0x41, index, sub) + len(data).to_bytes(4, "little")

    def _upload_segment(self, command: int) -> bytes:
        transfer = self._under_way(command, upload=True)
        chunk = bytes(transfer.data[:SEGMENT])
        del transfer.data[:SEGMENT]
        last = not transfer.data
        response = transfer.toggle << 4 | (SEGMENT - len(chunk)) << 1 | last
        transfer.toggle ^= 1
        if last:
            self._transfer = None
        return bytes([response]) + chunk.ljust(SEGMENT, b"\0")

    def _download(self, request: bytes, index: int, sub: int) -> bytes:
        self._transfer = None
        expedited, sized = request[0] & 2, request[0] & 1
        if expedited:
            unused = request[0] >> 2 & 3 if sized else 0
            kind = self._dictionary.entry(index, sub).type
            # Without a size indication the object's own size tells how many bytes count.
            size = 4 - unused if sized or kind is None else min(4, kind.size)
            self._dictionary.write(index, sub, request[4 : 4 + size])
        else:
            if self._dictionary.entry(index, sub).write is None:
                raise Refused(AbortCode.READ_ONLY)
            if sized and int.from_bytes(request[4:8], "little") > LONGEST_DOWNLOAD:
                raise Refused(AbortCode.OUT_OF_MEMORY)
            self._transfer = _Transfer(index, sub, upload=False, data=bytearray())
        return MULTIPLEXER.pack(0x60, index, sub) + bytes(4)

    def _download_segment(self, request: bytes) -> bytes:
        transfer = self._under_way(request[0], upload=False)
        unused, last = request[0] >> 1 & 7, request[0] & 1
        transfer.data += request[1 : 8 - unused]
        if len(transfer.data) > LONGEST_DOWNLOAD:
            raise Refused(AbortCode.OUT_OF_MEMORY)
        response = 0x20 | transfer.toggle << 4
        transfer.toggle ^= 1
        if last:
            self._dictionary.write(transfer.index, transfer.sub, bytes(transfer.data))
            self._transfer = None
        return bytes([response]) + bytes(7)

    def _under_way(self, command: int, *, upload: bool) -> _Transfer:
        if self._transfer is None or self._transfer.upload != upload:
            raise Refused(AbortCode.COMMAND_SPECIFIER_INVALID)
        if command >> 4 & 1 != self._transfer.toggle:
            raise Refused(AbortCode.TOGGLE_NOT_ALTERNATED)
        return self._transfer
