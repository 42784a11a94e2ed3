"""Each way of getting a rig file wrong gives one clear error: where, what is there, what may be."""

from __future__ import annotations

from pathlib import Path

import pytest

from recordings.errors import RigError
from recordings.rig import bundled_rigs, load_rig, parse_rig, rig_text

CAN = '\n[[port]]\nkind = "can"\nname = "bus"\ninterface = "slcan"\nchannel = "/dev/x"\n'
DEVICE = '\n[[device]]\nname = "drive"\ndriver = "d"\nport = "bus"\n'
DRIVEN = """
[plan]
mode = "driven"
drives = ["base", "elbow"]
targets_deg = [[1, 2], [3, 4]]
"""
PLATFORM = """
schema = 1
name = "plate"
[mechanism]
family = "platform"
plate = "free"
base_point = [{ name = "A1", x_mm = 0, y_mm = 0, z_mm = 0 }]
plate_point = [{ name = "B1", x_mm = 0, y_mm = 0, z_mm = 0 }]
leg = [{ name = "leg1", base = "A1", plate = "B1" }]
[[channel]]
name = "d1"
senses = "leg1"
gain_mm_per_count = 1
"""

# (old text, new text, what the message says); "" as old text appends.
WRONG = {
    "interlock of nothing": (
        "",
        '\n[interlocks]\njoint = [{ name = "knee" }]\n',
        "the interlocks name 'knee', expected one of: base",
    ),
    "interlock of an unsensed joint": (
        "",
        '\n[interlocks]\njoint = [{ name = "slide", speed_m_per_s = 1 }]\n',
        "limit travel or speed of 'slide', which no channel senses",
    ),
    "interlock twice": (
        "",
        '\n[interlocks]\njoint = [{ name = "base" }, { name = "base" }]\n',
        "the interlocks name 'base' twice",
    ),
    "interlock in another unit": (
        "",
        '\n[interlocks]\njoint = [{ name = "base", travel_m = [0, 1] }]\n',
        "'travel' of 'base' in the interlocks is given as length",
    ),
    "unknown mode": (
        "",
        '\n[interlocks]\njoint = [{ name = "base", modes = ["on"] }]\n',
        "'modes' of 'base' has 'on', expected some of: off, free, position, torque",
    ),
    "torque without limit": (
        "",
        '\n[interlocks]\njoint = [{ name = "base", modes = ["torque"] }]\n',
        "'base' may be in mode \"torque\": say its 'torque_percent'",
    ),
    "together of one": (
        "",
        '\n[interlocks]\ntogether = [{ joints = ["base"], mode = "free", at_most = 1 }]\n',
        "'together' names base; expected two or more",
    ),
    "arming that never holds": ("", "\n[interlocks]\narming_s = 0\n", "'arming_s' is 0.0"),
    "toml": ("[mechanism]", "[mechanism", "not a TOML file: .*line 5"),
    "schema": ("schema = 1", "schema = 2", "schema: found 2, expected 1"),
    "missing key": ('name = "bench"', "", "missing key 'name'"),
    "wrong type": ('name = "bench"', "name = 3", "name: found 3, expected a text"),
    "unknown key": (
        "schema = 1",
        "schema = 1\nfoo = 1",
        "unknown key 'foo'; allowed here: channel",
    ),
    "misspelt key": ("a_m =", "a_cm =", "joint 'base': unknown key 'a_cm'; did you mean 'a_m'"),
    "no unit": ("a_m =", "a =", "joint 'base': 'a' needs its unit in the key: a_m or a_mm"),
    "two units": ("a_m = 0.3", "a_m = 0.3\na_mm = 300", "'a_mm' and 'a_m' say the same thing"),
    "wrong unit": ("a_m =", "a_deg =", "unknown key 'a_deg'"),
    "text for a number": ("0.3", '"0.3"', "'a_m' is '0.3', expected a finite number"),
    "nan": ("0.3", "nan", "'a_m' is nan, expected a finite number"),
    "infinite": ("0.3", "1e400", "'a_m' is inf, expected a finite number"),
    "beyond floats": ("0.3", "1" + "0" * 400, "'a_m' is 1000.*, expected a finite number"),
    "true": ("0.3", "true", "'a_m' is True, expected a finite number"),
    "list for a number": ("0.3", "[1, 2]", r"'a_m' is \[1, 2\], expected a finite number"),
    "no uncertainty": (
        "uncertainty = 1",
        "uncertainty = 0",
        "uncertainty' is 0, expected .* above 0",
    ),
    "no nominal": ("nominal = 250, ", "", "'a_mm' has no 'nominal'"),
    "identify": ("identify = true", "identify = 1", "'a_mm.identify' is 1, expected true or false"),
    "inner key": (
        "identify =",
        "identfy =",
        "'identfy'; allowed here: identify, nominal, tie, unc",
    ),
    "tie to nothing": (
        "0.3",
        '{ tie = "q9.x" }',
        "'base.a' is tied to 'q9.x', expected one of: base",
    ),
    "tie is no tie": (
        "0.3",
        '{ tie = "x * q1.gain" }',
        "'a_m.tie' is 'x .*expected a parameter name",
    ),
    "infinite tie": ("0.3", '{ tie = "inf * elbow.a" }', "'a_m.tie' is 'inf"),
    "tie to itself": ("0.3", '{ tie = "base.a" }', "which is itself tied"),
    "tie to a tie": ("0.3", '{ tie = "elbow.a" }\ns_m = { tie = "base.a" }', "itself tied"),
    "tie across dimensions": ("0.3", '{ tie = "elbow.alpha" }', "another dimension"),
    "tie and more": ("0.3", '{ tie = "elbow.a", nominal = 1 }', "no other key beside 'tie'"),
    "family": (
        '"serial"',
        '"seriel"',
        "'family' is 'seriel', expected one of 'serial', 'platform'",
    ),
    "no family": ('family = "serial"', "", "missing key 'family', expected one of 'serial'"),
    "joint type": (
        "prismatic",
        "helical",
        "'slide', type: found 'helical', expected 'revolute' or",
    ),
    "limits": (
        "a_m = 0.3",
        "limits_deg = [3, 1]",
        r"'limits_deg' is \[3, 1\], expected the lowest",
    ),
    "half limits": ("a_m = 0.3", "limits_deg = [3]", r"is \[3\], expected \[lowest, highest\]"),
    "limits in metres": ("a_m = 0.3", "limits_m = [0, 1]", "'limits' of the revolute joint 'base'"),
    "home in metres": ("a_m = 0.3", "home_m = 1", "is given as length, expected angle"),
    "constraint": (
        'family = "serial"',
        'family = "serial"\nclosure = { constraint = "glue" }',
        "closure, constraint: found 'glue', expected 'rigid', 'hinge', 'slider', 'ball', 'plane'",
    ),
    "free without custom": (
        'family = "serial"',
        'family = "serial"\nclosure = { constraint = "ball", free = ["x"] }',
        "'free' lists the freedoms of constraint",
    ),
    "freedom": (
        'family = "serial"',
        'family = "serial"\nclosure = { constraint = "custom", free = ["u"] }',
        "free number 1: found 'u', expected 'x', 'y', 'z', 'rx', 'ry' or 'rz'",
    ),
    "mechanism is no table": (
        "[mechanism]",
        "[[mechanism]]",
        r"mechanism: found \[.*expected a table",
    ),
    "senses": (
        'senses = "base"',
        'senses = "knee"',
        "'q1' senses 'knee', expected one of: base, elb",
    ),
    "sensed twice": ('senses = "base"', 'senses = "elbow"', "'elbow' is sensed by two channels"),
    "same name": ('name = "q2"', 'name = "q1"', "the name 'q1' is given twice among joints"),
    "joint and channel": ('name = "q2"', 'name = "base"', "the name 'base' is given twice"),
    "name with a space": ('"q2"', '"q 2"', "'q 2' may hold letters, digits, '-' and '_' only"),
    "name with a slash": ('"q2"', '"q/2"', "'q/2' may hold letters"),
    "no gain": ("gain_deg_per_count = 0.01", "", "'q1': missing key 'gain_deg_per_count or"),
    "gain of 0": ("= 0.01", "= 0", "channel 'q1' has a gain of 0"),
    "gain in metres": (
        "gain_deg_per_count = 0.01",
        "gain_m_per_count = 1",
        "given as length/count",
    ),
    "offset in metres": ("= 0.01", "= 1\noffset_m = 1", "its offset is given as length"),
    "count range": (
        "= 0.01",
        "= 1\ncount_range = [3, 1]",
        r"'count_range' is \[3, 1\], expected \[l",
    ),
    "long count range": ("= 0.01", "= 1\ncount_range = [1, 2, 3]", "expected fewer items"),
    "count of a half": (
        "= 0.01",
        "= 1\nzero_count = 0.5",
        "zero_count: found 0.5, expected an integer",
    ),
    "huge count": (
        "= 0.01",
        "= 1\nzero_count = 1" + "0" * 30,
        "expected less than or equal to 9007",
    ),
    "modulus": ("= 0.01", "= 1\nmodulus_counts = 1", "'modulus_counts' is 1, expected above 1"),
    "noise": ("= 0.01", "= 1\nnoise_counts = -1", "'noise_counts' is -1.0, expected 0 or above"),
    "device": (
        "= 0.01",
        '= 1\ndevice = "x"',
        r"the device 'x', expected one of: \(there are none\)",
    ),
    "port kind": (
        "",
        CAN.replace('"can"', '"usb"'),
        "'bus': 'kind' is 'usb', expected one of 'can'",
    ),
    "no port kind": ("", CAN.replace('kind = "can"', ""), "missing key 'kind', expected one of"),
    "port without": (
        "",
        CAN.replace('interface = "slcan"', ""),
        "port 'bus': missing key 'interface'",
    ),
    "device on no port": ("", DEVICE, "'drive' is on the port 'bus', expected one of"),
    "device at no joint": (
        "",
        CAN + DEVICE + 'joint = "knee"',
        "moves the joint 'knee', expected one",
    ),
    "same device": ("", CAN + DEVICE + DEVICE, "the name 'drive' is given twice among devices"),
    "plan mode": (
        "",
        DRIVEN.replace("driven", "auto"),
        "mode: found 'auto', expected 'driven' or 'by-",
    ),
    "no drives": (
        "",
        DRIVEN.replace('drives = ["base", "elbow"]', ""),
        "driven plan needs 'drives'",
    ),
    "unknown drive": ("", DRIVEN.replace("elbow", "knee"), "drives 'knee', expected one of: base"),
    "unsensed drive": ("", DRIVEN.replace("elbow", "slide"), "'slide', which no channel senses"),
    "drive twice": (
        "",
        DRIVEN.replace("elbow", "base"),
        "'drives' names a joint twice: base, base",
    ),
    "drive no device moves": ("", CAN + DEVICE + DRIVEN, "no device moves, 'base'"),
    "short row": (
        "",
        DRIVEN.replace("[1, 2]", "[1]"),
        "a row of the plan has 1 values, expected one",
    ),
    "no rows": ("", DRIVEN.replace("[[1, 2], [3, 4]]", "[]"), r"is \[\], expected rows of numbers"),
    "flat rows": ("", DRIVEN.replace("[[1, 2], [3, 4]]", "[1, 2]"), "expected rows of numbers"),
    "no targets": (
        "",
        DRIVEN.replace("targets_deg", "poses = 3 #"),
        "either 'targets' .* or 'corners'",
    ),
    "few corners": (
        "",
        DRIVEN.replace("targets", "corners"),
        "'corners' has 2 rows, expected at lea",
    ),
    "corners on a line": (
        "",
        DRIVEN.replace("targets_deg = [", "corners_deg = [[2, 3], "),
        "'corners' span no region",
    ),
    "both": ("", DRIVEN + "corners_deg = [[0, 0], [1, 0], [0, 1]]", "not both"),
    "drives by hand": ("", DRIVEN.replace("driven", "by-hand"), "a by-hand plan has no 'drives'"),
    "no dwell": ("", DRIVEN + "dwell_s = 0", "'dwell_s' is 0.0, expected above 0"),
    "dwell without unit": ("", DRIVEN + "dwell = 1", "'dwell' needs its unit in the key: dwell_s"),
    "settle": ("", DRIVEN + "settle_s = -1", "'settle_s' is -1.0, expected 0 or above"),
    "seed": ("", DRIVEN + "seed = -1", "'seed' is -1, expected 0 or above"),
    "no poses": ("", DRIVEN + "poses = 0", "'poses' is 0, expected at least 1"),
    "revisits": ("", DRIVEN + "revisit = { poses = -1 }", "poses = -1.*expected poses >= 0"),
    "gravity": ("schema = 1", "schema = 1\ngravity_m_per_s2 = [0, 0]", "expected three numbers"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_mistake_is_told_in_one_error(rig_toml: str, case: str) -> None:
    old, new, message = WRONG[case]
    assert old in rig_toml
    text = rig_toml.replace(old, new, 1) if old else rig_toml + new
    with pytest.raises(RigError, match=message) as caught:
        parse_rig(text, "bench.toml")
    assert str(caught.value).startswith("bench.toml is not a ")
    assert len(str(caught.value).splitlines()) <= 2


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'plate = "free"',
            'plate = "loose"',
            "found 'loose', expected 'pivoted', 'free' or 'point'",
        ),
        ('base = "A1"', 'base = "A2"', "leg 'leg1' ends at 'A2', expected one of A1"),
        ("y_mm = 0", "y_mm = 0, w_mm = 1", "base_point 'A1': unknown key 'w_mm'"),
        ("y_mm = 0, z_mm", "z_mm", "base_point 'A1': missing key 'y_m or y_mm'"),
        (
            "gain_mm_per_count",
            "gain_deg_per_count",
            "of dimension length, but its gain is given as",
        ),
        (
            'leg = [{ name = "leg1", base = "A1", plate = "B1" }]',
            "leg = []",
            "leg: found .*more items",
        ),
        ('name = "d1"', 'name = "A1"', "the name 'A1' is given twice"),
    ],
)
def test_a_mistake_in_a_platform_is_told(old: str, new: str, message: str) -> None:
    assert old in PLATFORM
    parse_rig(PLATFORM)
    with pytest.raises(RigError, match=message):
        parse_rig(PLATFORM.replace(old, new, 1))


def test_several_mistakes_are_told_at_once(rig_toml: str) -> None:
    text = rig_toml.replace("0.3", "nan").replace("0.01", "nan")
    with pytest.raises(RigError) as caught:
        parse_rig(text)
    assert str(caught.value).splitlines() == [
        "rig is not a valid rig description:",
        "  mechanism, joint 'base': 'a_m' is nan, expected a finite number",
        "  channel 'q1': 'gain_deg_per_count' is nan, expected a finite number",
    ]


def test_files_that_cannot_be_read_are_told(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"no rig file .*nowhere.*bundled rigs: arm, "):
        load_rig(str(tmp_path / "nowhere"))
    with pytest.raises(RigError, match="cannot read the rig file"):
        load_rig(str(tmp_path))
    (tmp_path / "a.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(RigError, match="cannot read the rig file"):
        load_rig(str(tmp_path / "a.toml"))


def test_the_text_of_a_rig_keeps_its_line_ends(tmp_path: Path, rig_toml: str) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(rig_toml.replace("\n", "\r\n").encode())
    assert rig_text(str(path)) == (rig_toml.replace("\n", "\r\n"), str(path))
    assert load_rig(str(path)) == parse_rig(rig_toml)


@pytest.mark.parametrize("name", bundled_rigs())
def test_bundled_rigs_are_valid(name: str) -> None:
    assert load_rig(name).name == name
