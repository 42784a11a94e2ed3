"""Virtual streaming converters, built from a rig. Options are those of ``cobs-adc``, ``ascii-adc``."""

from __future__ import annotations

import re

from recordings.rig import Device, Rig
from sim_devices.crystal import crystal_of
from sim_devices.errors import DeviceNotSimulated
from sim_devices.options import channels_of, number, option, text
from sim_devices.plant_seam import Plant
from sim_devices.streams import CRCS, PacketFormat, StreamAdc, StreamText, line_of

DEFAULT_HZ = 100.0
FIELD = re.compile(r"([A-Za-z][\w-]*):[ui](8|16|32|64)(?:=(\d+))?")


def cobs_adc(rig: Rig, device: Device, plant: Plant) -> StreamAdc:
    """A converter that streams COBS packets."""
    fields = []
    for each in device.options.get("fields", ()):
        match = FIELD.fullmatch(each) if isinstance(each, str) else None
        if match is None:
            raise DeviceNotSimulated(
                f"option 'fields' of device '{device.name}' has {each!r}, expected NAME:TYPE"
            )
        name, bits, constant = match.groups()
        fields.append((name, int(bits), None if constant is None else int(constant)))
    crc = text(device, "crc", "ccitt-false")
    order = text(device, "byte_order", "little")
    if crc not in (*CRCS, "none") or order not in ("little", "big"):
        raise DeviceNotSimulated(f"device '{device.name}': crc '{crc}', byte_order '{order}'")
    packets = PacketFormat(
        fields=fields,
        crc=CRCS.get(crc),
        byte_order="little" if order == "little" else "big",
        tick_us=option(device, "time_tick_us", 1, 1_000_000, 1),
    )
    signals = _signals(rig, device, [name for name, _, _ in fields])
    return StreamAdc(
        number(device, "sample_hz", DEFAULT_HZ),
        signals,
        plant,
        packets.encode,
        crystal_of(device.name),
        _text(device),
    )


def ascii_adc(rig: Rig, device: Device, plant: Plant) -> StreamAdc:
    """A converter that sends lines of text."""
    pattern = text(device, "pattern")
    named = re.findall(r"\{([A-Za-z][\w-]*)\}", pattern)
    signals = _signals(rig, device, named)
    unsensed = [name for name in named if name not in (*signals, "sequence", "time")]
    for name in unsensed:
        pattern = pattern.replace(f"{{{name}}}", "0")
    widths = {
        "sequence": option(device, "sequence_bits", 1, 64, 32),
        "time": option(device, "time_bits", 1, 64, 32),
    }
    tick_us = option(device, "time_tick_us", 1, 1_000_000, 1)
    written = line_of(pattern, number(device, "resolution", 1.0), tick_us, widths)
    return StreamAdc(
        number(device, "sample_hz", DEFAULT_HZ),
        signals,
        plant,
        written,
        crystal_of(device.name),
        _text(device),
    )


def _signals(rig: Rig, device: Device, known: list[str]) -> dict[str, str]:
    signals: dict[str, str] = {}
    for channel in channels_of(rig, device):
        if not isinstance(channel.signal, str) or channel.signal not in known:
            raise DeviceNotSimulated(
                f"channel '{channel.name}' has the signal {channel.signal!r}, expected one of "
                f"{', '.join(known)}: the stream of '{device.name}' has no other"
            )
        signals[channel.signal] = channel.name
    return signals


def _text(device: Device) -> StreamText:
    start, stop = text(device, "start_text", ""), text(device, "stop_text", "")
    return StreamText(start.encode(), stop.encode())
