"""SDO access to a CANopen node: read and write objects of its dictionary (CiA 301).

The transfers are those of the ``canopen`` package; how an answer is awaited, and which
answer is accepted, is decided here. The package takes any answer for the one it waits for;
here an answer to the first frame of a transfer must name the object that was asked for, so
that the late answer to a request that was given up is passed over.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable

from canopen import Network, ObjectDictionary, SdoAbortedError, SdoCommunicationError
from canopen.sdo.client import SdoClient

from drivers.errors import DeviceRefused, DeviceSilent
from drivers.waiting import waits

SDO_TIMEOUT_S = 0.5
SDO_LENGTH = 8

ABORTED = 4
ANSWERS = {0: 1, 1: 3, 2: 2, 3: 0}
"""Command specifier of the answer (its upper 3 bits) to each of a request, by CiA 301."""

NAMES_ITS_OBJECT = (1, 2)
"""Requests (initiate download, initiate upload) whose answer repeats index and sub-index."""

EXPEDITED_WRITE = 0x23
TIMED_OUT = 0x0504_0000

AwaitAnswer = Callable[["queue.Queue[bytes]", float], bytes]
"""Waits for an entry of the queue for some seconds while the bus is served; raises queue.Empty."""

logging.getLogger("canopen").addHandler(logging.NullHandler())


def answers(request: bytes, answer: bytes) -> bool:
    """Whether ``answer`` can be the answer to ``request``, both 8 bytes."""
    asked, answered = request[0] >> 5, answer[0] >> 5
    if answered not in (ANSWERS.get(asked), ABORTED):
        return False
    return asked not in NAMES_ITS_OBJECT or answer[1:4] == request[1:4]


class _Client(SdoClient):
    """The package's client, waiting for its answers in our way."""

    def __init__(self, network: Network, node_id: int, await_answer: AwaitAnswer) -> None:
        dictionary = ObjectDictionary()  # type: ignore[no-untyped-call]
        super().__init__(0x600 + node_id, 0x580 + node_id, dictionary)  # type: ignore[no-untyped-call]
        self.network = network
        self._await_answer = await_answer

    def request_response(self, sdo_request: bytes) -> bytes:
        self.responses = queue.Queue()
        self.send_request(sdo_request)  # type: ignore[no-untyped-call]
        for wait_s in waits(SDO_TIMEOUT_S):
            try:
                answer = self._await_answer(self.responses, wait_s)
            except queue.Empty:
                continue
            if answers(sdo_request, answer):
                if answer[0] >> 5 == ABORTED:
                    raise SdoAbortedError(int.from_bytes(answer[4:8], "little"))
                return answer
        self.abort(TIMED_OUT)  # type: ignore[no-untyped-call]
        raise SdoCommunicationError("no answer")


class Sdo:
    """The object dictionary of one node. Any thread may use it; transfers take turns."""

    def __init__(self, network: Network, node_id: int, await_answer: AwaitAnswer) -> None:
        self._client = _Client(network, node_id, await_answer)
        self._node_id = node_id
        self._lock = threading.Lock()
        network.subscribe(0x580 + node_id, self._client.on_response)

    def read(self, index: int, sub: int = 0) -> bytes:
        """Bytes of an object; raises DeviceSilent, DeviceRefused or LinkBroken."""
        with self._lock:
            try:
                return bytes(self._client.upload(index, sub))
            except SdoAbortedError as error:
                raise self._refused("reading", index, sub, error) from error
            except SdoCommunicationError as error:
                raise self._silent("reading", index, sub, error) from error

    def read_integer(self, index: int, sub: int = 0, *, signed: bool = False) -> int:
        """Value of an integer object; raises as `read`."""
        return int.from_bytes(self.read(index, sub), "little", signed=signed)

    def read_text(self, index: int, sub: int = 0) -> str:
        """Value of a string object; raises as `read`."""
        return self.read(index, sub).decode("utf-8", "replace").rstrip("\0")

    def write(self, index: int, sub: int, value: int, size: int) -> None:
        """Write an integer object of ``size`` bytes, 1 to 4; raises as `read`."""
        data = value.to_bytes(size, "little", signed=value < 0)
        command = EXPEDITED_WRITE | (4 - size) << 2
        request = bytes([command, index & 0xFF, index >> 8, sub]) + data.ljust(4, b"\0")
        with self._lock:
            try:
                self._client.request_response(request)
            except SdoAbortedError as error:
                raise self._refused("writing", index, sub, error) from error
            except SdoCommunicationError as error:
                raise self._silent("writing", index, sub, error) from error

    def _refused(self, doing: str, index: int, sub: int, error: Exception) -> DeviceRefused:
        return DeviceRefused(
            f"node {self._node_id} refused {doing} object 0x{index:04X}:{sub}: {error}"
        )

    def _silent(self, doing: str, index: int, sub: int, error: Exception) -> DeviceSilent:
        return DeviceSilent(
            f"node {self._node_id} gave no valid answer within {SDO_TIMEOUT_S} s to {doing} object "
            f"0x{index:04X}:{sub} ({error}); check its node id, the bit rate, power and wiring"
        )
