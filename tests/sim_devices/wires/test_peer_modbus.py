"""Third parties as judges: pymodbus and minimalmodbus as clients, through a real pty."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import minimalmodbus
import pytest
import serial
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from recordings.rig import Rig, parse_rig
from tests.drivers.families import FAMILIES

pytestmark = [pytest.mark.wires, pytest.mark.usefixtures("no_leaks")]

PATIENCE_S = 60.0


@pytest.fixture
def address(shoulder_here: Rig, plant, running) -> Iterator[str]:
    plant.counts = {"d1": 2048, "d2": 0, "d3": 4095, "d4": -1}
    with running(shoulder_here, plant) as addresses:
        yield addresses["shoulder-adc"]


@pytest.fixture
def client(address: str) -> Iterator[ModbusSerialClient]:
    made = ModbusSerialClient(address, baudrate=115_200, timeout=PATIENCE_S, retries=0)
    assert made.connect()
    yield made
    made.close()


@pytest.fixture
def instrument(address: str) -> Iterator[minimalmodbus.Instrument]:
    made = minimalmodbus.Instrument(address, 1)
    made.serial.baudrate = 115_200
    made.serial.timeout = PATIENCE_S
    yield made
    made.serial.close()


def test_pymodbus_reads_and_writes(client: ModbusSerialClient) -> None:
    first = client.read_input_registers(0, count=7, device_id=1).registers
    assert first[:5] == [1, 2048, 0, 4095, 0xFFFF]
    again = client.read_holding_registers(0, count=7, device_id=1).registers
    assert again[:5] == [2, 2048, 0, 4095, 0xFFFF]
    assert again[5] << 16 | again[6] >= first[5] << 16 | first[6]
    assert not client.write_register(0xF001, 4711, device_id=1).isError()
    assert not client.write_registers(0xF000, [8, 4712], device_id=1).isError()
    assert client.read_holding_registers(0xF000, count=2, device_id=1).registers == [8, 4712]


@pytest.mark.parametrize(("address_", "count", "code"), [(7, 1, 2), (0, 8, 2)])
def test_pymodbus_sees_exceptions(
    client: ModbusSerialClient, address_: int, count: int, code: int
) -> None:
    answer = client.read_input_registers(address_, count=count, device_id=1)
    assert answer.isError()
    assert answer.exception_code == code


def test_pymodbus_sees_illegal_function_and_value(client: ModbusSerialClient) -> None:
    assert client.read_coils(0, count=1, device_id=1).exception_code == 1
    assert client.write_register(0xF000, 0, device_id=1).exception_code == 3


def test_pymodbus_reads_the_identification(client: ModbusSerialClient) -> None:
    answer = client.read_device_information(read_code=1, device_id=1)
    assert answer.information == {0: b"loopcal virtual", 1: b"modbus-adc", 2: b"1.0"}


def test_pymodbus_polls_on(client: ModbusSerialClient) -> None:
    polls = [client.read_input_registers(0, count=7, device_id=1).registers for _ in range(200)]
    assert [registers[0] for registers in polls] == list(range(1, 201))


def test_minimalmodbus_reads_and_writes(instrument: minimalmodbus.Instrument) -> None:
    assert instrument.read_registers(1, 4, functioncode=4) == [2048, 0, 4095, 0xFFFF]
    assert instrument.read_register(4, functioncode=3, signed=True) == -1
    first = instrument.read_long(5, functioncode=4)
    assert instrument.read_long(5, functioncode=4) >= first
    instrument.write_register(0xF001, 77, functioncode=6)
    instrument.write_registers(0xF000, [2, 78])
    assert instrument.read_registers(0xF000, 2) == [2, 78]


def test_minimalmodbus_sees_exceptions(instrument: minimalmodbus.Instrument) -> None:
    # It waits its whole timeout for the bytes that an exception response does not have.
    instrument.serial.timeout = 0.5
    assert refused(lambda: instrument.read_register(300))
    assert refused(lambda: instrument.write_register(0xF000, 65, functioncode=6))


def refused(ask: Callable[[], object]) -> bool:
    """Whether a request is refused; asked again while the far end is late, and nothing comes."""
    for _ in range(int(PATIENCE_S / 0.5)):
        try:
            ask()
        except minimalmodbus.NoResponseError:
            continue
        except minimalmodbus.IllegalRequestError:
            return True
        return False
    return False


def test_another_unit_is_silent(address: str) -> None:
    with serial.Serial(address, 115_200, timeout=0.1) as line:
        foreign = minimalmodbus.Instrument(line, 2)
        foreign.serial.timeout = 0.1
        with pytest.raises(minimalmodbus.NoResponseError):
            foreign.read_register(0, functioncode=4)
        line.write(bytes.fromhex("01 04 00 00 00 01 00 00"))  # a wrong CRC
        assert line.read(1) == b""
        near = minimalmodbus.Instrument(line, 1)
        near.serial.timeout = PATIENCE_S
        assert near.read_register(0, functioncode=4) == 1


def test_minimalmodbus_reads_a_register_map_in_its_orders(tmp_path, plant, running) -> None:
    text = FAMILIES["modbus-rtu"].text.replace(
        "first_register = 1\nchannels = 2\n",
        'signals = { x = { address = 10, type = "int32", order = "CDAB" }, '
        'y = { address = 12, type = "float32", order = "DCBA" } }\nresolution = 0.5\n',
    )
    text = text.replace("signal = 0", 'signal = "x"').replace("signal = 1", 'signal = "y"')
    plant.counts = {"q1": -123_456, "q2": 7}
    with running(parse_rig(text.replace("/tmp/", f"{tmp_path}/")), plant) as addresses:
        made = minimalmodbus.Instrument(addresses["line"], 1)
        made.serial.baudrate = 115_200
        made.serial.timeout = PATIENCE_S
        swapped = minimalmodbus.BYTEORDER_LITTLE_SWAP
        long = made.read_long(10, functioncode=4, signed=True, byteorder=swapped)
        little = minimalmodbus.BYTEORDER_LITTLE
        real = made.read_float(12, functioncode=4, byteorder=little)
        made.serial.close()
    assert (long, real) == (-123_456, 3.5)


def test_pymodbus_reads_the_tcp_converter(plant, running) -> None:
    plant.counts = {"q1": -70_000, "q2": 6}
    with running(FAMILIES["modbus-tcp"].rig, plant) as addresses:
        host, _, port = addresses["line"].rpartition(":")
        client = ModbusTcpClient(host, port=int(port), timeout=PATIENCE_S, retries=0)
        assert client.connect()
        # -70,000 = 0xFFFEEE90, the bytes of each register swapped; 6 counts of 0.25.
        words = client.read_input_registers(10, count=6, device_id=255).registers
        assert words == [0xFEFF, 0x90EE, 0, 0, 0x3FC0, 0x0000]
        info = client.read_device_information(read_code=1, device_id=255).information
        assert info[0] == b"loopcal virtual"
        assert client.read_coils(0, count=1, device_id=255).exception_code == 1
        client.close()
