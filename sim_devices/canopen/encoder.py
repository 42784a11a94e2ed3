"""A virtual absolute encoder (CiA 406) that measures one channel of the plant.

    0x1000  u32  0x00010196 absolute single-turn rotary, 0x00080196 absolute linear
    0x1008  text "loopcal virtual encoder"
    0x2000  u16  sample counter: samples sent by TPDO1 since power on, modulo 65,536
    0x2001  u16  device time since power on [100 us], modulo 65,536 (wraps every 6.5536 s)
    0x6000  u16  operating parameters, 0
    0x6001  u32  measuring units per revolution, the channel's modulus (0: not rotary)
    0x6002  u32  total measuring range in measuring units, the same
    0x6004  u32  position, raw counts of the channel, measured when it is read
    0x6500  u16  operating status, 0
    0x6501  u32  single-turn resolution, as 0x6001
    0x6502  u16  number of distinguishable revolutions, 1

TPDO1 (0x180 + id), 8 bytes, on every SYNC by default:

    bytes 0-3    position 0x6004
    bytes 4-5    sample counter 0x2000: one more than in the PDO before, so that a gap shows loss
    bytes 6-7    device time 0x2001 of the sample

The counter grows only when TPDO1 is sent; a position read by SDO is a sample of its own and
leaves the counter alone.
"""

from __future__ import annotations

from recordings.rig import Channel
from sim_devices.canopen.dictionary import U16, U32, ObjectDictionary
from sim_devices.canopen.node import Identity, Node
from sim_devices.canopen.pdo import Mapped, Pdo, PdoDefaults
from sim_devices.crystal import PERFECT, Crystal
from sim_devices.plant_seam import Plant

PROFILE = 406
ABSOLUTE_ROTARY = 1 << 16 | PROFILE
ABSOLUTE_LINEAR = 8 << 16 | PROFILE
PRODUCT_CODE = 406
TICKS_PER_S = 10_000

MAPPING = (Mapped(0x6004, 0, 32), Mapped(0x2000, 0, 16), Mapped(0x2001, 0, 16))


class Encoder(Node):
    """The encoder of ``channel``; the device type follows the unit of the channel's gain."""

    def __init__(
        self,
        node_id: int,
        device: str,
        channel: Channel,
        plant: Plant,
        crystal: Crystal = PERFECT,
    ) -> None:
        self._crystal = crystal
        self._plant = plant
        self._channel = channel.name
        self._modulus = channel.modulus_counts or 0
        self.transmit_pdos = (PdoDefaults(1, 0x180 + node_id, 1, MAPPING),)
        rotary = channel.gain.dimension == "angle/count"
        kind = ABSOLUTE_ROTARY if rotary else ABSOLUTE_LINEAR
        super().__init__(Identity(node_id, device, "encoder", kind, PRODUCT_CODE))

    def _install_application(self, dictionary: ObjectDictionary) -> None:
        self._samples = 0
        self._started_s = self.time_s
        add = dictionary.add
        add(0x2000, 0, U16, read=lambda: self._samples, mappable=True)
        add(0x2001, 0, U16, read=self._device_time, mappable=True)
        add(0x6000, 0, U16, read=0)
        add(0x6001, 0, U32, read=self._modulus)
        add(0x6002, 0, U32, read=self._modulus)
        add(0x6004, 0, U32, read=lambda: self._plant.sense(self._channel), mappable=True)
        add(0x6500, 0, U16, read=0)
        add(0x6501, 0, U32, read=self._modulus)
        add(0x6502, 0, U16, read=1)

    def _before_transmit(self, pdo: Pdo) -> None:
        if pdo.number == 1:
            self._samples += 1

    def _device_time(self) -> int:
        return int(self._crystal.elapsed(self.time_s - self._started_s) * TICKS_PER_S)
