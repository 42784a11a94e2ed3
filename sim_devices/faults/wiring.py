"""Where the faults of a virtual bench take hold: its ports, its devices, what they sense.

Built beside the bench, from outside in: ports get a plug, lines of slcan adapters can be
damaged, buses and lines get a babbler, devices a slot, the plant channels that can be held.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any, Protocol

from recordings.rig import CanPort, Device, Rig, TcpPort
from sim_devices.bus_port import BusPort
from sim_devices.can_bus import CanBus
from sim_devices.faults.babble import Babbler, BabblingDevice, BabblingNode
from sim_devices.faults.injector import Active
from sim_devices.faults.plug import DamagedLine, Plug
from sim_devices.faults.script import Order
from sim_devices.faults.slots import CanSlot, Disturbance, LineSlot, undamaged
from sim_devices.faults.stuck import StuckPlant
from sim_devices.line import Line, SerialLine, SlcanLine
from sim_devices.plant_seam import Plant
from sim_devices.port import Port


class Controller(Protocol):
    """A CAN controller: ``bus_off`` says whether something drives it off its bus."""

    bus_off: bool


class Corruptible(Protocol):
    """A way to the host: ``corrupt`` is the probability that a message is damaged there."""

    corrupt: float


class Wiring:
    """The places of one bench where faults take hold.

    Attributes:
        plant: nature as the devices sense it.
    """

    def __init__(self, rig: Rig, plant: Plant, seed: int) -> None:
        self.plant = StuckPlant(plant)
        self._rig = rig
        self._seed = seed
        self._devices = {device.name: device for device in rig.devices}
        self._can = {port.name for port in rig.ports if isinstance(port, CanPort)}
        self._tcp = {port.name for port in rig.ports if isinstance(port, TcpPort)}
        self._slots: dict[str, CanSlot | LineSlot] = {}
        self._babblers: dict[str, Babbler] = {}
        self._ways: dict[str, Corruptible] = {}
        self._controllers: dict[str, Controller] = {}
        self._plugs: dict[str, Plug] = {}

    # What the bench is built with.

    def place(self, device: Device, make: Callable[[Device], Any]) -> Any:
        """The slot of ``device``, in which ``make`` builds what answers."""

        def power_off() -> None:
            if device.joint is not None:
                self.plant.command(device.joint, "off", 0)

        if device.port in self._can:
            slot: CanSlot | LineSlot = CanSlot(device, make, power_off, undamaged, self._seed)
        else:
            slot = LineSlot(device, make, power_off, self._seed, tcp=device.port in self._tcp)
        self._slots[device.name] = slot
        return slot

    def bus(self, port: str, bus: CanBus) -> CanBus:
        """``bus`` with a babbler on it."""
        return CanBus([bus, BabblingNode(self._babbler(port))])

    def line(self, port: str, line: SerialLine) -> SerialLine:
        """``line`` with a babbler on it."""
        return SerialLine([line, BabblingDevice(self._babbler(port))])

    def adapter(self, port: str, line: SlcanLine) -> Line:
        """The line of an slcan adapter, whose bytes can be damaged."""
        damaged = DamagedLine(line, self._seed_of(port))
        self._controllers[port] = line.adapter
        self._ways[port] = damaged
        return damaged

    def interface(self, port: BusPort) -> BusPort:
        """A CAN interface, whose controller tells of errors in frames of its own."""
        self._controllers[port.name] = self._ways[port.name] = port
        return port

    def plug(self, port: Port) -> Port:
        """``port``, which can be unplugged."""
        self._plugs[port.name] = Plug(port)
        return self._plugs[port.name]

    def dropped(self, device: str) -> int:
        """Messages of a device that faults have taken from it."""
        return self._slots[device].dropped

    # What faults do; see `sim_devices.faults.injector.Wired`.

    def happen(self, order: Order, time_s: float) -> None:
        """Power that goes and comes back, devices that appear twice."""
        slot = self._slots.get(order.target)
        if slot is None:
            return
        match order.fault.verb:
            case "restart":
                slot.restart(time_s)
            case "duplicate":
                slot.double(not order.ends, time_s)
            case "renumber":
                slot.renumber(None if order.ends else round(order.amount or 0), time_s)

    def disturb(self, active: Active) -> None:
        """Disturb what the active faults disturb, and nothing else."""
        for name, slot in self._slots.items():
            slot.disturbance = self._disturbance(name, active)
        for name, plug in self._plugs.items():
            alone = [d.name for d in self._rig.devices if d.port == name]
            names = [name, *alone] if len(alone) == 1 else [name]
            plug.plugged = not any(("unplug", each) in active for each in names)
        for name, babbler in self._babblers.items():
            babbler.rate_hz = _amount(active, "babble", name)
        for name, controller in self._controllers.items():
            controller.bus_off = ("bus-off", name) in active
        for name, way in self._ways.items():
            way.corrupt = _amount(active, "corrupt", name) / 100.0
        stuck = {target for verb, target in active if verb == "stick"}
        channels = self._rig.channels
        self.plant.hold({c.name for c in channels if c.name in stuck or c.device in stuck})

    def _disturbance(self, name: str, active: Active) -> Disturbance:
        names = (name, self._devices[name].port)

        def on(verb: str) -> bool:
            return any((verb, each) in active for each in names)

        def most(verb: str) -> float:
            return max(_amount(active, verb, each) for each in names)

        return Disturbance(
            detached=("unplug", name) in active,
            silent=on("silence"),
            drop=most("drop") / 100.0,
            corrupt=most("corrupt") / 100.0,
            delay_s=most("delay"),
            foreign=on("foreign"),
        )

    def _babbler(self, port: str) -> Babbler:
        self._babblers[port] = Babbler(self._seed_of(port))
        return self._babblers[port]

    def _seed_of(self, port: str) -> int:
        return zlib.crc32(f"{self._seed} {port}".encode())


def _amount(active: Active, verb: str, target: str) -> float:
    order = active.get((verb, target))
    return 0.0 if order is None or order.amount is None else order.amount
