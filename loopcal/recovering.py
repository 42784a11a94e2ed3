"""`loopcal recover`: a whole recording made of a damaged one, and what could not be saved."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from rich.text import Text

from loopcal.console import BAD_ANSWER, DONE, fail, out
from loopcal.progress import bar
from loopcal.surveying import code_of
from recordings.completeness import missing
from recordings.errors import RecordingsError
from recordings.recover import Recovery, recover
from recordings.rig import rig_text

_SHOWN = 10


def run_recover(path: Path, output: Path, *, rig: str | None) -> int:
    """Recover ``path`` to ``output`` and say what was lost; returns the exit code."""
    rig_toml = None if rig is None else rig_text(rig)[0]
    try:
        label = f"recovering {path.name}"
        with bar(label) as on_progress:
            done = recover(path, output, rig_toml=rig_toml, on_progress=partial(on_progress, label))
    except RecordingsError as error:
        fail(str(error), code_of(error))
    _show(done)
    return BAD_ANSWER if done.found.damage else DONE


def _show(done: Recovery) -> None:
    found = done.found
    counts = {name: found.channel(name) for name in found.readings}
    readings = sum(tally.count for tally in counts.values())
    out.print(
        f"{done.path}: {done.messages} messages, {readings} of them readings of "
        f"{len(counts)} channels, {len(found.dwells)} dwells",
        markup=False,
        soft_wrap=True,
    )
    if not found.damage:
        out.print(Text("nothing was damaged: all of it was copied", style="green"))
        return
    lines = list(missing(found))
    for line in lines[:_SHOWN]:
        out.print(Text(f"lost: {line}", style="yellow"), soft_wrap=True)
    if not lines:
        out.print(Text("lost: nothing that the numbers of its messages show", style="yellow"))
    for line in found.damage[:_SHOWN]:
        out.print(Text(f"  {line}"), soft_wrap=True)
    if len(found.damage) > _SHOWN:
        text = f"  and {len(found.damage) - _SHOWN} more; the new file's metadata lists them"
        out.print(Text(text))
