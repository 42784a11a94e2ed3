"""Devices whose CAN messages a DBC file describes: encoders, joint drives, and drives of others."""
