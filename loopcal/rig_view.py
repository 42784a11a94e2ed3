"""What `loopcal rig check`, `loopcal rig choose` and `loopcal rig sensitivity` print."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.table import Table

from loopcal.console import err, out
from loopcal.files import create
from recordings.rig import Rig, SerialMechanism, load_rig, parameters
from solver.parameter_choice import SURE, choose_parameters
from solver.report.notation import figures
from solver.rig_check import RigCheck, check_rig
from solver.sensitivity import generic_sensitivity


def show_check(name: str) -> bool:
    """Print the findings about a rig; whether it has mistakes."""
    rig = load_rig(name)
    found = check_rig(rig)
    mistakes = [*found.mistakes, *_device_mistakes(rig), *_interlock_mistakes(rig)]
    out.print(f"[bold]{rig.title or rig.name}[/bold]")
    if rig.description:
        out.print(rig.description, markup=False)
    out.print(_facts(rig, found))
    out.print(_identified(rig))
    for text in found.remarks:
        out.print(f"remark: {text}", markup=False, soft_wrap=True)
    for text in mistakes:
        err.print(f"mistake: {text}", style="red", markup=False, soft_wrap=True)
    if not mistakes:
        out.print("no mistakes found", style="green")
    return bool(mistakes)


def _device_mistakes(rig: Rig) -> list[str]:
    """What the drivers say about their devices' options, without opening anything."""
    from daq.clock import HostClock
    from drivers import DriverError, make_links

    try:
        make_links(rig, HostClock())
    except DriverError as error:
        return [str(error)]
    return []


def _interlock_mistakes(rig: Rig) -> tuple[str, ...]:
    """What in the rig's own plan its interlocks would refuse."""
    from daq.errors import PlanNotPossible
    from daq.interlocks import Interlocks
    from loopcal.loop_mobility import mobility_of
    from recordings.rig import visits
    from solver.errors import MechanismError

    if rig.plan is None:
        return ()
    try:
        return Interlocks(rig, mobility_of(rig)).of_plan(rig.plan, visits(rig.plan))
    except (MechanismError, PlanNotPossible) as error:
        return (str(error),)


def _facts(rig: Rig, found: RigCheck) -> Table:
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    mechanism = rig.mechanism
    if isinstance(mechanism, SerialMechanism):
        kind = f"serial chain of {len(mechanism.joints)} joints, closed by constraint '{mechanism.closure.constraint}'"
    else:
        kind = f"platform, {mechanism.plate} plate, {len(mechanism.legs)} legs"
    table.add_row("mechanism", kind)
    table.add_row("mobility", f"{found.mobility}")
    table.add_row(
        "sensed", ", ".join(f"{place} by {channel}" for place, channel in found.sensed.items())
    )
    table.add_row("unsensed", ", ".join(found.unsensed) or "nothing")
    table.add_row("equations", f"{found.redundancy} a pose for {len(found.identified)} unknowns")
    if found.identifiability is not None:
        table.add_row(
            "rank", f"{found.identifiability.rank} of {len(found.identified)} at generic poses"
        )
    if rig.plan is not None:
        drives = f", driving {' and '.join(rig.plan.drives)}" if rig.plan.drives else ""
        table.add_row(
            "plan", f"{rig.plan.mode}, {rig.plan.poses} poses{drives}, {rig.plan.sample:g} Hz"
        )
    return table


def _identified(rig: Rig) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    table.add_column("to identify")
    table.add_column("nominal", justify="right")
    table.add_column("uncertainty", justify="right")
    table.add_column("unit")
    for p in parameters(rig):
        if p.identify:
            uncertainty = "" if p.uncertainty is None else f"{p.uncertainty / p.to_si:g}"
            table.add_row(p.name, f"{p.nominal / p.to_si:g}", uncertainty, p.unit)
    return table


def show_choice(name: str, condition: float) -> None:
    """Print how a well-posed set of parameters is reached, one held a step, and the set."""
    found = choose_parameters(load_rig(name), condition=condition)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for heading in ("free", "sigma_L", "product", "condition"):
        table.add_column(heading, justify="right")
    table.add_column("held next")
    for step in found.steps:
        table.add_row(
            f"{step.free}",
            f"{step.sigma_min:.3g}",
            f"{step.product:.3g}",
            f"{step.condition:.3g}",
            step.held or "nothing: these will do",
        )
    out.print(table)
    out.print(
        f"Indices of the whitened Jacobian at generic poses, columns in plausible errors. Stops at "
        f"sigma_L of at least {SURE:g} and a condition number of at most {condition:g}.",
        markup=False,
        soft_wrap=True,
    )
    out.print(f"identify: {', '.join(found.chosen)}", markup=False, soft_wrap=True)


def show_sensitivity(name: str, source: Path | None, report: Path | None) -> None:
    """Print how far an error of each parameter moves the endpoint or plate; the page goes to ``report``."""
    from loopcal.planning import calibrated_values

    rig = load_rig(name)
    found = generic_sensitivity(rig, None if source is None else calibrated_values(rig, source))
    kinds = []
    if found.shifts:
        kinds.append(("mm", 1e-3, found.displacement_rms, found.displacement_max))
    if found.turns:
        kinds.append(("deg", np.pi / 180.0, found.rotation_rms, found.rotation_max))
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    table.add_column("\nparameter", no_wrap=True)
    table.add_column("\nerror", justify="right", no_wrap=True)
    for unit, *_ in kinds:
        for heading in (f"{unit}\nRMS", f"{unit}\nworst", "per\nunit"):
            table.add_column(heading, justify="right", no_wrap=True)
    for i, (parameter, (unit, step)) in enumerate(zip(found.space.names, found.steps, strict=True)):
        said = "" if found.stated[i] else "\u00a0*"
        row = [parameter, f"{found.errors[i] / step:.6g}\u00a0{unit}{said}"]
        for _, factor, rms, most in kinds:
            row += [figures(rms[i] / factor), figures(most[i] / factor)]
            row.append(figures(rms[i] / factor * found.per_unit[i]))
        table.add_row(*row)
    out.print(table)
    out.print(
        f"Error of the endpoint or plate if one parameter alone is off by its stated uncertainty, over {found.poses} "
        "poses within reach; per unit: for 1 mm, 1 deg or 1 %. * states none: one unit is taken.",
        markup=False,
        soft_wrap=True,
    )
    if report is not None:
        from solver.report.report import render_sensitivity

        create(report, render_sensitivity(rig, found))
        out.print(f"wrote {report}", markup=False)
