"""CANopen nodes (CiA 301) as sans-IO state machines: frames in, frames out, told the time.

`node.Node` is the communication profile; `encoder.Encoder` (CiA 406) and `drive.JointDrive`
(CiA 402) put their objects into its dictionary. Their module docstrings list every object
and every PDO.
"""

from sim_devices.canopen.drive import JointDrive
from sim_devices.canopen.encoder import Encoder
from sim_devices.canopen.node import Node

__all__ = ["Encoder", "JointDrive", "Node"]
