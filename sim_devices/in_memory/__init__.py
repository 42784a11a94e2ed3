"""Virtual benches without wires or real time: hosts find their ports by URL in the same process.

A port is ``loopcal://NAME``, which pyserial opens like any other (`protocol_loopcal`), and so
does an slcan bus on it; a TCP port is an address that only `socket.create_connection` of this
process knows (`tcp`). Bytes are those of the wires; an answer is there as soon as the
device gives it, and time passes only while somebody waits for it or advances the clock
(`sim_devices.virtual_time`). One thread.
"""

from sim_devices.in_memory.bench import MemoryBench

__all__ = ["MemoryBench"]
