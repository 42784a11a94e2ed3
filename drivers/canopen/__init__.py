"""CANopen over any CAN interface: the bus master, encoders (CiA 406), joint drives (CiA 402)."""
