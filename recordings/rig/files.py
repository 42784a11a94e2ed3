"""Files that describe a rig's devices (DBC), carried inside the rig's own text.

A device names its file, which lies beside the rig file. When the rig is read, the file's text
is appended to the rig's as an entry of the table ``[files]``: what is captured with, recorded
and solved is then one text that needs no other file, and a rig taken out of a recording can
be captured with again. A rig that has the entry already is taken as it stands.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from recordings.errors import RigError

ENCODINGS = ("utf-8", "cp1252")
"""Tried in turn. DBC files come in the code page of their editor, which is mostly the latter."""


def with_files(text: str, path: Path) -> str:
    """The text of the rig file at ``path`` with the files that its devices name.

    Raises:
        RigError: a file is missing or is no text, or the rig has a table ``[files]`` without it.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        # Whoever parses the text will say what is wrong, and where.
        return text
    held = table.get("files", {})
    missing = [name for name in _named(table) if name not in held]
    if not missing:
        return text
    if "files" in table:
        raise RigError(
            f"{path} has a table [files], but not the file '{missing[0]}' that a device names; "
            f"put its text there, or remove the table to have all files read from beside the rig"
        )
    entries = [f"{_quoted(name)} = {_quoted(_read(path.parent / name))}\n" for name in missing]
    return f"{text.rstrip()}\n\n[files]\n{''.join(entries)}"


def _named(table: object) -> list[str]:
    """Names of files, each once, in the order of the devices."""
    devices = table.get("device") if isinstance(table, dict) else None
    found = [d.get("file") for d in devices if isinstance(d, dict)] if devices else []
    return list(dict.fromkeys(name for name in found if isinstance(name, str)))


def _read(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RigError(
            f"cannot read '{path}', the file of a device: {error.strerror}; its name is relative "
            f"to the rig file"
        ) from error
    for encoding in ENCODINGS:
        try:
            return data.decode(encoding).replace("\r\n", "\n")
        except UnicodeDecodeError:
            continue
    raise RigError(f"'{path}', the file of a device, is no text in {' or '.join(ENCODINGS)}")


def _quoted(text: str) -> str:
    """A TOML string: literal over several lines where the text allows it, for people to read."""
    if "\n" in text and "'''" not in text and not text.endswith("'") and _plain(text):
        return f"'''\n{text}'''"
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return (
        '"' + "".join(c if _plain(c) and c != "\n" else f"\\u{ord(c):04x}" for c in escaped) + '"'
    )


def _plain(text: str) -> bool:
    """Whether TOML allows every character as it is: no control characters but tab and newline."""
    return all(c in "\t\n" or (c >= " " and c != "\x7f") for c in text)
