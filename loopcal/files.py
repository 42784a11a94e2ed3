"""Files that the command creates: never over another file."""

from __future__ import annotations

from pathlib import Path

from loopcal.console import fail


def in_a_folder(path: Path | None) -> Path | None:
    """``path``, asked before the work is done whose result is to be written there; ``-`` and None pass."""
    if path is not None and str(path) != "-" and not path.parent.is_dir():
        fail(f"cannot write '{path}': there is no folder '{path.parent}'; make it, or name another")
    return path


def create(path: Path, text: str) -> None:
    """Write ``text`` to a new file; anything that is there already stays, and is an error."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        fail(f"'{path}' exists already; choose another name, nothing was overwritten")
    except OSError as error:
        fail(f"cannot write '{path}': {error.strerror}")
