"""Modbus RTU over any serial port: the line with its one master, and ADCs on it."""
