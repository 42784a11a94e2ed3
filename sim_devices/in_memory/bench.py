"""A virtual bench in memory, by virtual time: what `sim_devices.bench` is on real ports."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial

import serial  # type: ignore[import-untyped]

from recordings.rig import CanPort, Rig, SerialPort, TcpPort
from sim_devices.bench import STEP_S, build_ports
from sim_devices.faults.injector import Injector
from sim_devices.faults.plug import Plug
from sim_devices.faults.wiring import Wiring
from sim_devices.in_memory.port import SCHEME, TCP_HOST, MemoryPort, attempts
from sim_devices.in_memory.tcp import connections_in_memory
from sim_devices.line import Line
from sim_devices.moving import moved_rig
from sim_devices.plant_seam import Plant
from sim_devices.port import Port
from sim_devices.virtual_time import VirtualClock, time_is

PACKAGE = "sim_devices.in_memory"
_numbers = itertools.count(1)


class MemoryBench:
    """The virtual devices of a rig, reachable from this process and thread only.

    Args:
        rig: what to build. Its CAN ports become slcan adapters, whatever they are.
        plant: nature.
        clock: virtual time of the devices.
        faults: what goes wrong, and when.
        seed: of all that is random in faults.

    Attributes:
        rig: the rig for the host: the same, with the ports at their addresses in memory.
        faults: injects faults.

    Raises:
        DeviceNotSimulated: the rig asks for what no virtual device offers.
    """

    def __init__(
        self,
        rig: Rig,
        plant: Plant,
        clock: VirtualClock,
        faults: Injector | None = None,
        seed: int = 0,
    ) -> None:
        self._clock = clock
        self._plant = plant
        self.faults = faults or Injector(rig)
        wiring = self._wiring = Wiring(rig, plant, seed)
        paths = {port.name: _place(port) for port in rig.ports}
        self._made: list[MemoryPort] = []
        built = build_ports(rig, wiring, paths, self._port)
        self._ports = [wiring.plug(port) for port in built]
        self.faults.bind(wiring)
        addresses = {port.name: port.address for port in built}
        self._addresses = addresses
        self.rig = moved_rig(rig, addresses)

    def _port(self, name: str, path: str, line: Line) -> Port:
        address = path if path.startswith(TCP_HOST) else f"{SCHEME}://{path}"
        port = MemoryPort(name, address, line)
        self._made.append(port)
        return port

    @contextmanager
    def running(self) -> Iterator[None]:
        """Inside, the ports are open and all time of this process is the bench's."""
        with ExitStack() as stack:
            if PACKAGE not in serial.protocol_handler_packages:
                serial.protocol_handler_packages.append(PACKAGE)
                stack.callback(serial.protocol_handler_packages.remove, PACKAGE)
            self._start_s = self._clock.time_s
            self._plant.advance(0.0)
            for plug, port in zip(self._ports, self._made, strict=True):
                port.on_written = partial(self._serve, plug)
                plug.open()
                stack.callback(attempts.pop, port.address, None)
                stack.callback(plug.close)
            self._tick(self._clock.time_s)
            stack.enter_context(self._clock.calling(STEP_S, self._tick))
            stack.enter_context(time_is(self._clock))
            stack.enter_context(connections_in_memory())
            yield

    def attempts(self, port: str) -> int:
        """How often hosts have tried to open a port while the bench was running."""
        return attempts.get(self._addresses[port], 0)

    def dropped(self, device: str) -> int:
        """Messages of a device that were lost on their way, by the fault of that name."""
        return self._wiring.dropped(device)

    def _serve(self, port: Plug | Port) -> None:
        now_s = self._clock.time_s - self._start_s
        self._plant.advance(now_s)
        port.serve(now_s)

    def _tick(self, time_s: float) -> None:
        now_s = time_s - self._start_s
        self._plant.advance(now_s)
        for port in self._ports:
            port.tick(now_s)
        self.faults.advance(now_s)


def _place(port: CanPort | SerialPort | TcpPort) -> str:
    number = next(_numbers)
    return f"{TCP_HOST}:{number}" if isinstance(port, TcpPort) else f"{number}/{port.name}"
