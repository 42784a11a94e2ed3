"""Files that the command creates: never over another file."""

from __future__ import annotations

from pathlib import Path

from loopcal.console import fail


def create(path: Path, text: str) -> None:
    """Write ``text`` to a new file; anything that is there already stays, and is an error."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        fail(f"'{path}' exists already; choose another name, nothing was overwritten")
    except OSError as error:
        fail(f"cannot write '{path}': {error.strerror}")
