"""Faults of a virtual bench: scripts that say when, an injector that makes them happen.

    faults = Injector(rig, "at 3 s unplug wrist-adc for 2 s")
    run_bench(rig, plant, stop=stop, faults=faults)      # in one thread
    faults.inject("silence encoder-3 for 1 s")           # from another

Faults are of three places: a port (`plug`), a device on its bus or line (`slots`), and what
the devices sense (`stuck`). `wiring` puts them there. Nothing here knows a driver, and the
devices do not know that they are disturbed.
"""

from sim_devices.faults.injector import Injector
from sim_devices.faults.script import Order, ScriptError, parse
from sim_devices.faults.vocabulary import FAULTS, FaultType

__all__ = ["FAULTS", "FaultType", "Injector", "Order", "ScriptError", "parse"]
