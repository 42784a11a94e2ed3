"""Kinematics of the two mechanism families, with analytic derivatives, vectorised over poses."""
