"""Effects beyond the plain mechanism and straight sensors, and the model that they grow."""
