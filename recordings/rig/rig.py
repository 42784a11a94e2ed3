"""A rig: mechanism, channels, devices, ports and capture plan, in one TOML file.

Owns the file format, its cross-checks and its error texts. The file's own bytes are kept,
because a recording carries them exactly as they were.
"""

from __future__ import annotations

import tomllib
from collections import Counter
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import Field, ValidationError, model_validator

from recordings.errors import RigError
from recordings.rig.effect import DescribedEffect
from recordings.rig.files import with_files
from recordings.rig.instruments import CanPort, Channel, Device, SerialPort, TcpPort
from recordings.rig.interlocks import Interlocks
from recordings.rig.mechanism import PlatformMechanism, SerialMechanism
from recordings.rig.parameters import quantities
from recordings.rig.plan import Plan
from recordings.rig.quantity import Described, fail
from recordings.rig.tracker import Tracker

Port = Annotated[CanPort | SerialPort | TcpPort, Field(discriminator="kind")]
Mechanism = Annotated[SerialMechanism | PlatformMechanism, Field(discriminator="family")]


_Kind = TypeVar("_Kind", bound=Described)


class PlanFile(Described):
    """A plan in a file of its own: the ``[plan]`` table of a rig, alone."""

    plan: Plan


class Rig(Described):
    """A validated rig description."""

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {"gravity": ("m_per_s2",)}

    schema_version: Literal[1] = Field(alias="schema")
    name: str
    title: str = ""
    description: str = ""
    mechanism: Mechanism
    channels: tuple[Channel, ...] = Field(alias="channel", min_length=1)
    devices: tuple[Device, ...] = Field(alias="device", default=())
    ports: tuple[Port, ...] = Field(alias="port", default=())
    trackers: tuple[Tracker, ...] = Field(alias="tracker", default=())
    effects: tuple[DescribedEffect, ...] = Field(alias="effect", default=())
    files: dict[str, str] = Field(default_factory=dict)
    plan: Plan | None = None
    interlocks: Interlocks = Interlocks()
    gravity: tuple[float, float, float] | None = None

    def channel(self, name: str) -> Channel:
        """The channel called ``name``; raises KeyError."""
        return {channel.name: channel for channel in self.channels}[name]

    @property
    def places(self) -> tuple[str, ...]:
        """What a channel can sense: joints or legs, then coordinates of tracked markers."""
        tracked = (place for tracker in self.trackers for place in tracker.places)
        return (*self.mechanism.places, *tracked)

    def dimension_of(self, place: str) -> str:
        """What a channel at ``place`` measures; coordinates of markers are lengths."""
        inside = place in self.mechanism.places
        return self.mechanism.dimension_of(place) if inside else "length"

    def sensed_by(self, place: str) -> Channel | None:
        """The channel that senses ``place``, or None where it is unsensed."""
        return next((channel for channel in self.channels if channel.senses == place), None)

    @model_validator(mode="after")
    def _names_are_unique(self) -> Rig:
        mechanism = self.mechanism
        if isinstance(mechanism, SerialMechanism):
            parts = [joint.name for joint in mechanism.joints] + list(mechanism.fixture_names)
            parts += ["tip"] if mechanism.tip is not None else []
        else:
            points = (*mechanism.base_points, *mechanism.plate_points)
            parts = [point.name for point in points] + list(mechanism.places)
        for tracker in self.trackers:
            parts += [tracker.name, *(marker.name for marker in tracker.markers)]
        groups = {
            "joints, points, legs, trackers, markers and channels": parts
            + [channel.name for channel in self.channels],
            "devices and ports": [d.name for d in self.devices] + [p.name for p in self.ports],
        }
        for what, names in groups.items():
            twice = sorted(name for name, count in Counter(names).items() if count > 1)
            if twice:
                raise fail(f"the name '{twice[0]}' is given twice among {what}; names must differ")
            for name in names:
                if not name or not all(c.isalnum() or c in "-_" for c in name):
                    raise fail(f"the name '{name}' may hold letters, digits, '-' and '_' only")
        return self

    @model_validator(mode="after")
    def _references_exist(self) -> Rig:
        places, devices = self.mechanism.places, [d.name for d in self.devices]
        for channel in self.channels:
            _known(f"channel '{channel.name}' senses", channel.senses, self.places)
            if channel.device is not None:
                _known(f"channel '{channel.name}' has the device", channel.device, devices)
            dimension = self.dimension_of(channel.senses)
            if channel.gain.dimension != f"{dimension}/count":
                raise fail(
                    f"channel '{channel.name}' senses {channel.senses}, which is of dimension {dimension}, "
                    f"but its gain is given as {channel.gain.dimension}"
                )
            if channel.offset.dimension not in ("", dimension):
                raise fail(
                    f"channel '{channel.name}' senses {channel.senses}, which is of dimension {dimension}, "
                    f"but its offset is given as {channel.offset.dimension}"
                )
            if channel.gain.tie is None and channel.gain.nominal == 0:
                raise fail(f"channel '{channel.name}' has a gain of 0")
        twice = [
            place for place, count in Counter(c.senses for c in self.channels).items() if count > 1
        ]
        if twice:
            raise fail(f"'{twice[0]}' is sensed by two channels; one is allowed")
        for device in self.devices:
            _known(
                f"device '{device.name}' is on the port", device.port, [p.name for p in self.ports]
            )
            if device.joint is not None:
                _known(f"device '{device.name}' moves the joint", device.joint, places)
            if device.file is not None:
                _known(
                    f"device '{device.name}' is described by the file", device.file, [*self.files]
                )
        if self.plan is not None:
            driven = [d.joint for d in self.devices if d.joint is not None]
            for name in self.plan.drives:
                _known("the plan drives", name, places)
                if self.devices:
                    _known("the plan drives, but no device moves,", name, driven)
                if self.sensed_by(name) is None:
                    raise fail(f"the plan drives '{name}', which no channel senses")
        return self

    @model_validator(mode="after")
    def _interlocks_fit_the_joints(self) -> Rig:
        places = self.mechanism.places
        for joint in self.interlocks.joints:
            _known("the interlocks name", joint.name, places)
            dimension = self.mechanism.dimension_of(joint.name)
            if joint.travel is not None and joint.travel.dimension != dimension:
                raise fail(
                    f"'travel' of '{joint.name}' in the interlocks is given as {joint.travel.dimension}, "
                    f"but the joint's variable is of dimension {dimension}"
                )
            watched = joint.travel is not None or joint.speed is not None
            if watched and self.sensed_by(joint.name) is None:
                raise fail(
                    f"the interlocks limit travel or speed of '{joint.name}', which no channel senses"
                )
        for together in self.interlocks.together:
            for name in together.joints:
                _known("'together' of the interlocks names", name, places)
        return self

    @model_validator(mode="after")
    def _effects_are_unique(self) -> Rig:
        labels = [effect.label for effect in self.effects]
        twice = sorted(label for label, count in Counter(labels).items() if count > 1)
        if twice:
            raise fail(f"the effect '{twice[0]}' is given twice; give it once, with all its values")
        return self

    @model_validator(mode="after")
    def _ties_lead_to_free_parameters(self) -> Rig:
        given = {name: quantity for name, quantity, _ in quantities(self)}
        for name, quantity in given.items():
            if quantity.tie is None:
                continue
            _known(f"'{name}' is tied to", quantity.tie.parameter, list(given))
            if given[quantity.tie.parameter].tie is not None:
                raise fail(
                    f"'{name}' is tied to '{quantity.tie.parameter}', which is itself tied; tie it to the free one"
                )
            if given[quantity.tie.parameter].dimension != quantity.dimension:
                raise fail(
                    f"'{name}' is tied to '{quantity.tie.parameter}', which has another dimension"
                )
        return self


def _known(what: str, name: str, names: list[str] | tuple[str, ...]) -> None:
    if name not in names:
        raise fail(f"{what} '{name}', expected one of: {', '.join(names) or '(there are none)'}")


def parse_rig(text: str, source: str = "rig") -> Rig:
    """Read a rig description.

    Args:
        text: the TOML document.
        source: what to call it in an error.

    Raises:
        RigError: not TOML, or not a valid rig; the message has a line for each fault.
    """
    return _parse(Rig, text, source, "rig description")


def _parse(kind: type[_Kind], text: str, source: str, what: str) -> _Kind:
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RigError(f"{source} is not a TOML file: {error}") from error
    try:
        return kind.model_validate(table)
    except ValidationError as error:
        lines = [f"  {_where(fault['loc'], table)}{_what(fault)}" for fault in _faults(error)]
        raise RigError(f"{source} is not a valid {what}:\n" + "\n".join(lines)) from error


def _faults(error: ValidationError) -> list[Any]:
    """The faults worth telling: a list is not too short because of an item that is wrong."""
    return [
        fault for fault in error.errors() if not (fault["type"] == "too_short" and fault["input"])
    ]


def _where(loc: tuple[int | str, ...], table: Any) -> str:
    """Path of a fault in the words of the file: ``channel 'q1', noise_counts: ``."""
    words: list[str] = []
    for step in loc:
        if isinstance(step, int) and isinstance(table, list) and step < len(table):
            table = table[step]
            name = table.get("name") if isinstance(table, dict) else None
            words[-1] += f" '{name}'" if isinstance(name, str) else f" number {step + 1}"
        elif isinstance(table, dict) and step in table:
            table = table[step]
            words.append(str(step))
        elif isinstance(step, str) and step not in ("can", "serial", "tcp", "platform"):
            words.append(step)
    return f"{', '.join(words)}: " if words else ""


_EXPECTED = {
    "too_short": "more items",
    "too_long": "fewer items",
    "missing": "more items",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "string_type": "a text",
    "int_type": "an integer",
    "bool_type": "true or false",
}


def _what(fault: Any) -> str:
    if fault["type"] == "rig":
        return str(fault["msg"])
    if fault["type"] in ("union_tag_not_found", "union_tag_invalid"):
        context = fault.get("ctx", {})
        key = str(context.get("discriminator", "")).strip("'")
        found = fault["input"].get(key) if isinstance(fault["input"], dict) else fault["input"]
        allowed = context.get(
            "expected_tags", "'can', 'serial', 'tcp'" if key == "kind" else "'serial', 'platform'"
        )
        was = f"missing key '{key}'" if found is None else f"'{key}' is {found!r}"
        return f"{was}, expected one of {allowed}"
    expected = _EXPECTED.get(fault["type"]) or str(fault["msg"]).removeprefix("Input should be ")
    found = list(fault["input"]) if isinstance(fault["input"], tuple) else fault["input"]
    return f"found {found!r:.80}, expected {expected}"


def bundled_rigs() -> tuple[str, ...]:
    """Names of the rigs that come with the program."""
    folder = resources.files("recordings.rig") / "bundled"
    return tuple(
        sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))
    )


def rig_text(rig: str) -> tuple[str, str]:
    """Text of a rig given by path or by bundled name, and what to call it in messages.

    The text holds the files that the rig's devices name, so that it needs no other file.

    Raises:
        RigError: no such file, not readable as UTF-8 text, or no such bundled rig; a file that
            a device names cannot be read.
    """
    if rig in bundled_rigs():
        bundled = resources.files("recordings.rig") / "bundled" / f"{rig}.toml"
        return bundled.read_bytes().decode("utf-8"), f"bundled rig '{rig}'"
    path = Path(rig)
    if not path.exists():
        raise RigError(
            f"there is no rig file '{rig}', and no bundled rig of that name; "
            f"bundled rigs: {', '.join(bundled_rigs())}"
        )
    return with_files(_read(path, "rig file"), path), str(path)


def _read(path: Path, what: str) -> str:
    """The text of a file, byte for byte."""
    try:
        return path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(f"cannot read the {what} '{path}': {error}") from error


def load_rig(rig: str) -> Rig:
    """A rig by path or by the name of a bundled one; raises RigError."""
    text, source = rig_text(rig)
    return parse_rig(text, source)


def load_plan(path: Path) -> Plan:
    """The plan in a plan file; raises RigError."""
    return _parse(PlanFile, _read(path, "plan file"), str(path), "plan file").plan
