"""The pages for users of benches and writers of drivers say the truth: what they show works."""

from __future__ import annotations

import itertools
import re
import sys
import tomllib
import types
from collections.abc import Iterator
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import pytest
from cobs import cobs as theirs
from crccheck.crc import Crc16Ibm3740

from drivers import OptionError, driver_names, make_links, registry
from drivers.stream.cobs_adc import CobsAdcOptions, PacketDecoder
from drivers.stream.decoder import Sample
from recordings.events import Fault, Reading
from recordings.faults import FaultKind
from recordings.rig import Rig, parse_rig

ROOT = Path(__file__).parents[2]
BENCH, OWN = (
    (ROOT / "docs" / name).read_text("utf-8") for name in ("howto-bench.md", "howto-own-driver.md")
)
DBC = (Path(__file__).parent / "bench.dbc").read_text("utf-8")


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def sections(text: str) -> Iterator[tuple[str, list[str]]]:
    for part in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        yield part.partition("\n")[0], blocks(part, "toml")


# The page about benches.

PORTS = {
    "bus": '[[port]]\nkind = "can"\nname = "bus"\ninterface = "virtual"\nchannel = "docs"\n',
    "line": '[[port]]\nkind = "serial"\nname = "line"\npath = "/nowhere"\n',
}
SIGNALS = {
    "canopen-encoder": ["position"],
    "dbc-encoder": ["ElbowPosition.Angle"],
    "modbus-adc": ["x", "y"],
    "cobs-adc": ["x", "y"],
    "ascii-adc": ["x", "y"],
}


def rig_with(piece: str) -> Rig:
    """A rig around a piece of the page: what it does not say is added."""
    said = tomllib.loads(piece)
    text = 'schema = 1\nname = "docs"\n[mechanism]\nfamily = "serial"\n'
    text += "".join(f'[[mechanism.joint]]\nname = "joint{n}"\na_m = 0.1\n' for n in range(1, 9))
    named = {port["name"] for port in said.get("port", [])}
    text += "".join(
        PORTS[port]
        for port in dict.fromkeys(device["port"] for device in said.get("device", []))
        if port not in named
    )
    joints = itertools.count(1)
    for device in said.get("device", []):
        for signal in SIGNALS.get(device["driver"], []):
            n = next(joints)
            text += (
                f'[[channel]]\nname = "q{n}"\nsenses = "joint{n}"\ndevice = "{device["name"]}"\n'
            )
            text += f'signal = "{signal}"\ngain_deg_per_count = 0.1\n'
    if "channel" not in tomllib.loads(text):
        text += '[[channel]]\nname = "q8"\nsenses = "joint8"\ngain_deg_per_count = 0.1\n'
    if any("file" in device for device in said.get("device", [])):
        text += f"[files]\n'bench.dbc' = '''\n{DBC}'''\n"
    return parse_rig(text + "\n" + piece)


PIECES = [
    pytest.param(piece, id=f"{title} {k}")
    for title, found in sections(BENCH)
    for k, piece in enumerate(found, 1)
]


@pytest.mark.parametrize("piece", PIECES)
def test_every_piece_of_a_rig_is_accepted(piece, clock):
    rig = rig_with(piece)
    links = make_links(rig, clock)
    ports = {device.port for device in rig.devices}
    assert {link.name for link in links} == ports
    assert {n for link in links for n in link.losses()} == {
        channel.name for channel in rig.channels if channel.device
    }


def test_every_driver_is_on_the_page():
    shown = {d["driver"] for p in blocks(BENCH, "toml") for d in tomllib.loads(p).get("device", [])}
    assert shown == set(registry.BUILT_IN) & set(driver_names())


def options_of(driver: str) -> set[str]:
    model = registry.find_driver(driver).options
    return {
        f"{name}_{unit}" if units else name
        for name in model.model_fields
        for units in [model.quantities.get(name)]
        for unit in units or ("",)
    }


@pytest.mark.parametrize("driver", sorted(registry.BUILT_IN))
def test_every_option_is_on_the_page(driver):
    table = re.search(rf"^\| `{driver}` \|.*\n\|[-|]+\n((?:\|.*\n)+)", BENCH, re.MULTILINE)
    if table is None:  # a listener takes what its sentence lists
        (listed,) = re.findall(rf"^A `{driver}` takes(.*?)\n\n", BENCH, re.MULTILINE | re.DOTALL)
        shown = set(re.findall(r"`(\w+)`", listed))
    else:
        cells = [row.split("|")[1] for row in table[1].splitlines()]
        shown = {key for cell in cells for key in re.findall(r"`(\w+)`", cell)}
    assert shown == options_of(driver)


def test_the_recommended_packet_is_the_drivers_and_third_parties():
    text = (ROOT / "docs" / "formats.md").read_text("utf-8")
    part = text[text.index("## Packets of a streaming converter") :]
    packet, wire = (
        bytes.fromhex(found.replace("\n", " "))
        for found in re.findall(r"`((?:[0-9A-F]{2}\s){10,}[0-9A-F]{2})`", part)
    )
    assert Crc16Ibm3740.calc(packet[:-2]).to_bytes(2, "little") == packet[-2:]
    assert wire == theirs.encode(packet) + b"\0"
    fields = ["kind:u8=1", "flags:u8", "sequence:u16", "time:u32", "x:i32"]
    decoder = PacketDecoder(CobsAdcOptions.model_validate({"fields": fields}))
    decoder.feed(b"\0")
    assert decoder.feed(wire) == [Sample({"x": -2}, sequence=1, ticks=10_000)]


# The page about drivers.


@pytest.fixture
def gauge(monkeypatch) -> None:
    """The driver of the page, installed as the page says."""
    (code,) = blocks(OWN, "python")
    module = types.ModuleType("my_package.gauge")
    package = types.ModuleType("my_package")
    package.gauge = module  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "my_package", package)
    monkeypatch.setitem(sys.modules, "my_package.gauge", module)
    exec(compile(code, "howto-own-driver.md", "exec"), module.__dict__)
    points = tomllib.loads(blocks(OWN, "toml")[0])["project"]["entry-points"]
    found = EntryPoints(
        EntryPoint(name, value, group)
        for group, entries in points.items()
        for name, value in entries.items()
    )

    def entry_points(**wanted: Any) -> EntryPoints:
        return found.select(**wanted)

    monkeypatch.setattr(registry, "entry_points", entry_points)


def sample(number: int, count: int) -> bytes:
    body = bytes([0xA5, number % 256]) + count.to_bytes(2, "big", signed=True)
    return body + bytes([sum(body) % 256])


def own_rig(**options: str) -> Rig:
    piece = blocks(OWN, "toml")[1].replace('"leg1"', '"joint1"').replace("_mm_per", "_deg_per")
    for old, new in options.items():
        assert old in piece
        piece = piece.replace(old, new)
    head = 'schema = 1\nname = "docs"\n[mechanism]\nfamily = "serial"\n'
    return parse_rig(f'{head}[[mechanism.joint]]\nname = "joint1"\na_m = 0.1\n{piece}')


def test_the_gauge_of_the_page_is_read(gauge, line, clock, pump_until):
    (link,) = make_links(own_rig(), clock, {"gauge-line": line.path})
    link.open()
    try:
        link.start(100.0)
        line.write(sample(254, 100) + b"\x00" + sample(255, -5) + sample(2, 7))
        events = pump_until(link, Reading, 3)
        link.stop()
        losses = link.losses()["d1"]
    finally:
        link.close()
    readings = [event for event in events if isinstance(event, Reading)]
    assert [(r.raw, r.sequence) for r in readings] == [(-100, 254), (5, 255), (-7, 258)]
    assert [e.kind for e in events if isinstance(e, Fault)][:1] == [FaultKind.MALFORMED]
    assert (losses.expected, losses.lost_in_gaps) == (5, 2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"inverted = true": "inverted = 1"}, "'inverted' is 1"),
        ({"inverted = true": "inverse = true"}, "unknown key 'inverse'; did you mean 'inverted'"),
        ({'signal = "gap"': 'signal = "gape"'}, "has the signals gap"),
    ],
)
def test_what_a_rig_says_of_it_is_checked(gauge, clock, change, words):
    with pytest.raises(OptionError, match=words):
        make_links(own_rig(**change), clock)
