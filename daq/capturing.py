"""`capture`: one session, from looking at the plan to what it left behind.

Order of a session: look at path, plan and interlocks; open and ask every device; arm; sample,
until every channel has delivered; only then create the file, and only then move. However the
session ends, the drives go to safe mode first, then the links stop, then the file is
completed and closed. All threads have ended when `capture` returns or raises.
"""

from __future__ import annotations

import socket
import uuid
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from daq.arming import Arming
from daq.clock import Clock, HostClock
from daq.errors import PlanNotPossible
from daq.interlocks import Interlocks
from daq.interpreter import set_for_a_session
from daq.mobility import Mobility, counted
from daq.options import CaptureOptions
from daq.preflight import arm_drives, check_drives, check_path, check_plan, open_all
from daq.progress import Progress
from daq.session import RunningSession
from daq.stop import Stop, signals_set
from daq.summary import CaptureSummary
from drivers import Link, make_links
from recordings.rig import Plan, Rig, visits
from recordings.session import Session


def _refuse(joints: tuple[str, ...]) -> bool:
    return False


def _ignore(progress: Progress) -> None:
    return None


def capture(
    rig: Rig,
    rig_toml: str,
    path: str | Path,
    *,
    links: Sequence[Link] | None = None,
    clock: Clock | None = None,
    arm: Callable[[tuple[str, ...]], bool] = _refuse,
    arming: Arming | None = None,
    arm_virtual: bool = False,
    mobility: Mobility | None = None,
    on_progress: Callable[[Progress], None] = _ignore,
    stop: Stop | None = None,
    operator: str = "",
    notes: str = "",
    plan_override: Plan | None = None,
    options: CaptureOptions | None = None,
) -> CaptureSummary:
    """Execute the plan of a rig and record it.

    SIGINT (Ctrl-C), SIGTERM and SIGHUP end the session like ``stop``, when called from the main
    thread: safe mode, complete file, summary. A second one changes nothing.

    Args:
        rig: the rig, as parsed from ``rig_toml``.
        rig_toml: the rig description, recorded exactly as it is.
        path: the recording to create; never replaced.
        links: links made for this rig and ``clock``; they are closed at the end. None makes
            them from the rig.
        clock: time of the session; None takes the host's.
        arm: asked for permission before the joints named are moved; only joints of drives
            that do not say that they are virtual. Refuses unless given.
        arming: how long that permission lasts, made for ``clock``, to be renewed by the operator
            or a live service. None takes the rig's ``arming_s``, and nobody renews it.
        arm_virtual: whether it may run out on virtual drives too.
        mobility: how the mechanism can move, which limits what may be held in position
            together; None counts joints and constraints.
        on_progress: takes a snapshot about five times a second, in the calling thread.
        stop: set it from anywhere to end the session.
        operator: who runs it, for the record.
        notes: free text, for the record.
        plan_override: plan to execute in place of the rig's.
        options: timeouts and limits.

    Returns:
        what was recorded and lost, and how the session ended: a failure after the recording
        began is an ending, not an exception.

    Raises:
        CannotRecord: the file exists already or cannot be created.
        NotReady: ports, devices or channels do not answer; all of them are named.
        PlanNotPossible: there is no plan, or it does not fit the rig.
        NotArmed: arming was refused.
        NotAllowed: a mistake of the program, after the session was made safe.
        StopRequested: stopped before the recording began.
        OptionError: a device's options do not fit its driver (from `drivers`).
    """
    plan = plan_override or rig.plan
    if plan is None:
        raise PlanNotPossible(f"the rig '{rig.name}' has no [plan]; add one, or give a plan")
    target = Path(path)
    options = options or CaptureOptions()
    check_path(target, options.storage)
    stops = visits(plan)
    interlocks = Interlocks(rig, mobility or counted(rig))
    check_plan(rig, plan, stops, interlocks)
    clock = clock or HostClock()
    stop = stop or Stop()
    links = make_links(rig, clock) if links is None else links
    with ExitStack() as closing:
        for link in links:
            closing.callback(link.close)
        joints = {joint: drive for link in links for joint, drive in link.joints.items()}
        check_drives(plan, joints)
        statuses = open_all(links)
        arming = arming or Arming(clock, rig.interlocks.arming)
        limited = arm_drives(rig, joints, statuses, arm) or arm_virtual
        arming.grant()
        with signals_set(stop), set_for_a_session():
            session = RunningSession(
                rig=rig,
                plan=plan,
                stops=stops,
                links=links,
                joints=joints,
                interlocks=interlocks,
                arming=arming if limited else None,
                clock=clock,
                stop=stop,
                options=options,
            )
            metadata = Session(
                session_id=uuid.uuid4().hex,
                start_ns=clock.now_ns(),
                operator=operator,
                notes=notes,
                host=socket.gethostname(),
            )
            session.start()
            return session.record(target, rig_toml, metadata, on_progress)
