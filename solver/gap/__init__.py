"""The gap between simulation and measurement: where it is, what is missing, and how sure that is."""
