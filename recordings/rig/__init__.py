"""The rig description: one TOML file that says what the mechanism is and what reads it."""

from recordings.rig.effect import DescribedEffect
from recordings.rig.instruments import CanPort, Channel, Device, SerialPort, TcpPort
from recordings.rig.interlocks import Interlocks, JointInterlock, Together
from recordings.rig.mechanism import (
    FREEDOMS,
    POSE,
    Distance,
    Fixture,
    Joint,
    Leg,
    PlatformMechanism,
    SerialMechanism,
)
from recordings.rig.parameters import Parameter, parameters
from recordings.rig.plan import Plan, Visit, visits
from recordings.rig.quantity import Quantity, Range
from recordings.rig.rig import Rig, bundled_rigs, load_plan, load_rig, parse_rig, rig_text
from recordings.rig.tracker import Marker, Tracker

__all__ = [
    "FREEDOMS",
    "POSE",
    "CanPort",
    "Channel",
    "DescribedEffect",
    "Device",
    "Distance",
    "Fixture",
    "Interlocks",
    "Joint",
    "JointInterlock",
    "Leg",
    "Marker",
    "Parameter",
    "Plan",
    "PlatformMechanism",
    "Quantity",
    "Range",
    "Rig",
    "SerialMechanism",
    "SerialPort",
    "TcpPort",
    "Together",
    "Tracker",
    "Visit",
    "bundled_rigs",
    "load_plan",
    "load_rig",
    "parameters",
    "parse_rig",
    "rig_text",
    "visits",
]
