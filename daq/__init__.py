"""A capture session: from a rig and its links to a recording and its ledger.

Owns the host's clock, preflight, the mode commands of a session, standstill detection and
recording. Knows no wire protocol (`drivers`), no file format (`recordings`) and no
kinematics.
"""

from daq.arming import Arming
from daq.capturing import capture
from daq.clock import Clock, HostClock, ManualClock
from daq.errors import (
    ArmingExpired,
    CannotRecord,
    DaqError,
    Interlocked,
    NotAllowed,
    NotArmed,
    NotReady,
    PlanNotPossible,
    SessionFailed,
    StopRequested,
)
from daq.mobility import Mobility
from daq.options import CaptureOptions
from daq.progress import ChannelProgress, Phase, Progress
from daq.stop import Stop
from daq.summary import CaptureSummary, Ending

__all__ = [
    "Arming",
    "ArmingExpired",
    "CannotRecord",
    "CaptureOptions",
    "CaptureSummary",
    "ChannelProgress",
    "Clock",
    "DaqError",
    "Ending",
    "HostClock",
    "Interlocked",
    "ManualClock",
    "Mobility",
    "NotAllowed",
    "NotArmed",
    "NotReady",
    "Phase",
    "PlanNotPossible",
    "Progress",
    "SessionFailed",
    "Stop",
    "StopRequested",
    "capture",
]
