"""Virtual benches: nature, and the devices that measure and move it, from the wire's far end.

Two halves that meet at `sim_devices.plant_seam.Plant` only. `sim_devices.plant` is nature:
the mechanism, its flaws and its noise. Everything else here is wires: devices that speak
slcan, CANopen and Modbus RTU as bought hardware would, and the bench that puts them on
ports (`sim_devices.bench.run_bench`).

Shares no codec and no kinematics with the drivers or the solver: a simulator that shares
its subject's code hides symmetric bugs. For the same reason no CANopen or Modbus library is
used here; such libraries judge these devices in the tests.
"""
