"""The running bench: all virtual devices of a rig, on ports, in real time.

Thin shell around sans-IO parts: opens a port for each port of the rig, moves the plant, hands
bytes and frames over, and closes everything at the end. One thread does it all, the
caller's; the only thing shared with other threads is the stop event.
"""

from __future__ import annotations

import selectors
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from types import FrameType

from recordings.rig import CanPort, Rig, SerialPort, TcpPort
from sim_devices.bus_port import BusPort
from sim_devices.can_bus import CanBus
from sim_devices.errors import DeviceNotSimulated
from sim_devices.faults.injector import Injector
from sim_devices.faults.wiring import Wiring
from sim_devices.kinds import can_bus, serial_line
from sim_devices.line import Line, SlcanLine
from sim_devices.plant_seam import Plant
from sim_devices.port import Port
from sim_devices.pty_port import PtyPort
from sim_devices.socketcand import GREETING, SocketcandLine
from sim_devices.tcp_port import TcpServerPort

SOCKETCAND_PORT = 29_536
STEP_S = 0.005
"""Devices are ticked this often, and the plant moves at least so often."""

PLANT_RESOLUTION_S = 0.001
"""The plant is not asked to move less than this: many requests in a row see one moment."""

POLL_S = 0.001
"""Longest wait while a port must be polled."""

Clock = Callable[[], float]


def run_bench(
    rig: Rig,
    plant: Plant,
    *,
    stop: threading.Event,
    ports: Mapping[str, str] | None = None,
    ready: Callable[[Mapping[str, str]], None] | None = None,
    clock: Clock = time.monotonic,
    faults: Injector | None = None,
    seed: int = 0,
    each_tick: Callable[[], None] | None = None,
) -> None:
    """Run the virtual devices of a rig until ``stop`` is set; takes at most `STEP_S` to end.

    Args:
        rig: what to build: its devices, on its ports.
        plant: nature; time 0 is when the ports are open.
        stop: ends the bench.
        ports: paths by port name, in place of those in the rig. A CAN port given a path is an
            slcan adapter there, whatever its interface in the rig.
        ready: called once, when a host may open the ports, with their addresses by port name.
        clock: monotonic time [s].
        faults: what goes wrong, and when; lines can be injected into it while the bench runs.
        seed: of all that is random in faults.
        each_tick: called every `STEP_S` or so, in the bench's thread; may not wait.

    Raises:
        DeviceNotSimulated: the rig asks for what no virtual device offers.
        PortTaken: a path belongs to something else.
        PortUnavailable: the system or a CAN interface refuses.
    """
    faults = faults or Injector(rig)
    wiring = Wiring(rig, plant, seed)
    built = build_ports(rig, wiring, ports or {})
    faults.bind(wiring)
    bench = Bench([wiring.plug(port) for port in built], plant, clock, faults, each_tick)
    with bench.opened():
        bench.turn()  # what boots has booted before a host asks it for anything
        if ready is not None:
            ready(bench.addresses)
        while not stop.is_set():
            bench.turn()


def build_ports(
    rig: Rig,
    wiring: Wiring,
    paths: Mapping[str, str],
    at: Callable[[str, str, Line], Port] | None = None,
) -> list[Port]:
    """The ports of a rig with their devices, not open yet; raises DeviceNotSimulated.

    Args:
        rig: what to build.
        wiring: where faults take hold of it.
        paths: addresses by port name, in place of those in the rig.
        at: makes a port that carries bytes, from its name, its address and its far end; by
            default one of the operating system.
    """
    names = [port.name for port in rig.ports]
    if not names:
        raise DeviceNotSimulated(f"the rig '{rig.name}' has no ports, so there is nothing to run")
    for name in paths:
        if name not in names:
            raise DeviceNotSimulated(
                f"a path is given for the port '{name}'; the rig has: {', '.join(names)}"
            )
    built: list[Port] = []
    for port in rig.ports:
        if isinstance(port, TcpPort):
            path = paths.get(port.name, port.address)
            line = wiring.line(port.name, serial_line(rig, port, wiring.plant, wiring.place))
            built.append((at or TcpServerPort)(port.name, path, line))
        elif isinstance(port, SerialPort):
            path = paths.get(port.name, port.path)
            line = wiring.line(port.name, serial_line(rig, port, wiring.plant, wiring.place))
            built.append((at or port_at)(port.name, path, line))
        elif port.interface == "socketcand" and port.name not in paths:
            bus = wiring.bus(port.name, can_bus(rig, port, wiring.plant, wiring.place))
            built.append(_daemon(port, bus))
        elif port.interface == "slcan" or port.name in paths:
            # python-can takes the serial baud rate behind an '@' of the channel.
            path = paths.get(port.name, port.channel.partition("@")[0])
            bus = wiring.bus(port.name, can_bus(rig, port, wiring.plant, wiring.place))
            adapter = wiring.adapter(port.name, SlcanLine(bus))
            built.append((at or port_at)(port.name, path, adapter))
        else:
            bus = wiring.bus(port.name, can_bus(rig, port, wiring.plant, wiring.place))
            built.append(wiring.interface(BusPort(port, bus)))
    return built


class Bench:
    """Ports served in turn, and a plant that moves in real time."""

    def __init__(
        self,
        ports: list[Port],
        plant: Plant,
        clock: Clock,
        faults: Injector | None = None,
        each_tick: Callable[[], None] | None = None,
    ) -> None:
        self._ports = ports
        self._plant = plant
        self._clock = clock
        self._faults = faults
        self._each_tick = each_tick
        self._start_s = 0.0
        self._plant_s = 0.0
        self._next_tick_s = 0.0
        self._watched: dict[str, int] = {}

    @property
    def addresses(self) -> Mapping[str, str]:
        """Where hosts find the ports, by port name; a free TCP port is known once it is open."""
        return {port.name: port.address for port in self._ports}

    @contextmanager
    def opened(self) -> Iterator[None]:
        """All ports open inside; if one cannot be, none is."""
        with ExitStack() as stack:
            self._selector = stack.enter_context(selectors.DefaultSelector())
            for port in self._ports:
                port.open()
                stack.callback(port.close)
            self._start_s = self._clock()
            self._plant.advance(0.0)
            yield

    def turn(self) -> None:
        """Wait for the next thing to do, at most until the next tick, and do it."""
        for port in self._ports:
            self._watch(port)
        wait_s = self._next_tick_s - self._now_s()
        if any(port.polled for port in self._ports):
            wait_s = min(wait_s, POLL_S)
        ready = [key.data for key, _ in self._selector.select(max(wait_s, 0.0))]
        ready += [port for port in self._ports if port.polled]
        now_s = self._now_s()
        if ready:
            self._move_plant(now_s)
        for port in ready:
            port.serve(now_s)
        if now_s >= self._next_tick_s:
            self._move_plant(now_s)
            for port in self._ports:
                port.tick(now_s)
            if self._each_tick is not None:
                self._each_tick()
            if self._faults is not None:
                self._faults.advance(now_s)
            # From now, not from when it was due: a bench that was held up does not race.
            self._next_tick_s = now_s + STEP_S

    def _now_s(self) -> float:
        return self._clock() - self._start_s

    def _move_plant(self, now_s: float) -> None:
        if now_s - self._plant_s >= PLANT_RESOLUTION_S:
            self._plant.advance(now_s)
            self._plant_s = now_s

    def _watch(self, port: Port) -> None:
        """Select on the port's descriptor as long as it has one."""
        descriptor, watched = port.fileno(), self._watched.get(port.name)
        if descriptor == watched:
            return
        if watched is not None:
            self._selector.unregister(watched)
            del self._watched[port.name]
        if descriptor is not None:
            self._selector.register(descriptor, selectors.EVENT_READ, port)
            self._watched[port.name] = descriptor


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set; only in the main thread. Handlers are put back."""
    stop = threading.Event()

    def handle(_number: int, _frame: FrameType | None) -> None:
        stop.set()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def port_at(name: str, address: str, line: Line) -> Port:
    """A port that carries bytes: at a path, or listening at ``socket://HOST:PORT``.

    Raises:
        DeviceNotSimulated: the address is neither.
    """
    if address.startswith("socket://"):
        return TcpServerPort(name, address, line)
    if "://" in address or not address:
        raise DeviceNotSimulated(
            f"port '{name}' is at '{address}', but a virtual port appears at a path or listens at "
            f"socket://HOST:PORT; give one of these for it"
        )
    return PtyPort(name, address, line)


def _daemon(port: CanPort, bus: CanBus) -> Port:
    """A socketcand daemon where the rig expects one."""
    address = f"{port.options.get('host', '')}:{port.options.get('port', SOCKETCAND_PORT)}"
    return TcpServerPort(port.name, address, SocketcandLine(bus, port.channel), GREETING)
