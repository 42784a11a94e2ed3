"""The real arms of the Panda benchmarks: their places, their poses, and the rig that describes them.

Franka Panda, joint encoders only, its ball held in one of two sockets 50 mm apart
(`data/panda_ball_joint`). Geometry is that of the URDF; link masses are those that Gaz, Cognetti,
Oliva, Robuffo Giordano and De Luca identified ("Dynamic identification of the Franka Emika Panda
robot", IEEE RA-L 2019, table of dynamic parameters), that of the hand the manufacturer's. While a
hand leads it from pose to pose, the arm carries its own weight.

Play of the ball in its socket is modelled with what a rig has: three short slides at the tip that
read 0, with the play for their noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from recordings.rig import Rig, parse_rig
from recordings.urdf import COUNT, Doubts, rig_from_urdf
from solver.estimate.nuisance import Observations
from solver.mechanism.circumstances import Circumstances

Array = NDArray[np.float64]

DATA = Path(__file__).parent / "data" / "panda_ball_joint"
TRAINED = "front_center"
ARMS = {
    arm: tuple(sorted(p.name for p in (DATA / arm).iterdir()))
    for arm in ("panda_2_clean", "panda_3")
}
PLACES = ARMS["panda_2_clean"]
FOLDER = {place: DATA / arm / place for arm, places in ARMS.items() for place in places}
JOINTS = 7
LOADED = {
    "joint-compliance": tuple(f"panda_joint{n}" for n in (2, 3, 4, 5, 6)),
    "bearing-compliance": tuple(f"panda_joint{n}" for n in (1, 2, 3, 4, 5)),
}
"""Joints that weight turns and tilts: the first is upright, and behind the last ones hardly any is left."""

WEIGHTS = {
    "panda_link1": (4.970684, (3.875e-3, 2.081e-3, -47.62e-3)),
    "panda_link2": (0.646926, (-3.141e-3, -28.72e-3, 3.495e-3)),
    "panda_link3": (3.228604, (27.518e-3, 39.252e-3, -66.502e-3)),
    "panda_link4": (3.587895, (-53.17e-3, 104.419e-3, 27.454e-3)),
    "panda_link5": (1.225946, (-11.953e-3, 41.065e-3, -38.437e-3)),
    "panda_link6": (1.666555, (60.149e-3, -14.117e-3, -10.517e-3)),
    "panda_link7": (0.735522, (10.517e-3, -4.252e-3, 61.597e-3)),
    "panda_hand": (0.73, (-10e-3, 0.0, 30e-3)),
}
"""Mass [kg] of each link and its centre in the link's frame [m]."""

DISTANCE = (
    '[[mechanism.distance]]\nbetween = ["hole_0", "hole_1"]\n'
    "distance_mm = { nominal = 50, uncertainty = 0.05 }\n"
)


@dataclass(frozen=True, slots=True)
class Choice:
    """Noise and uncertainties; compliances of joints and of their bearings [rad/Nm], 0 for rigid ones.

    A spring gives way and never the other way: it is as compliant as uncertain.
    """

    noise_rad: float
    play_m: float
    length_m: float
    angle_rad: float
    encoder_rad: float
    compliance: float = 0.0
    bearing: float = 0.0


def weighted_urdf() -> str:
    """The URDF of the arm with the masses of its links."""
    robot = etree.fromstring((DATA / "panda.urdf").read_bytes())
    for link in robot.findall("link"):
        if link.get("name") in WEIGHTS:
            mass, centre = WEIGHTS[link.get("name")]
            inertial = etree.SubElement(link, "inertial")
            etree.SubElement(inertial, "origin", xyz=" ".join(map(str, centre)))
            etree.SubElement(inertial, "mass", value=str(mass))
            axes = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            etree.SubElement(inertial, "inertia", dict.fromkeys(axes, "0"))
    return str(etree.tostring(robot, encoding="unicode"))


def rig_text_of(
    choice: Choice, *, distance: bool = True, fixtures: tuple[str, ...] = ("hole_0", "hole_1")
) -> str:
    """The rig from the URDF, with the play as three slides behind the tip, as a rig file."""
    doubts = Doubts(
        length_m=choice.length_m,
        angle_rad=choice.angle_rad,
        encoder_rad=choice.encoder_rad,
        noise_rad=choice.noise_rad,
    )
    text = rig_from_urdf(
        weighted_urdf(),
        "ball_link",
        "ball",
        fixtures=fixtures,
        doubts=doubts,
        gravity_compensated=True,
    )
    slides = [
        f'[[mechanism.joint]]\nname = "play_{axis}"\ntype = "prismatic"\nconvention = "urdf"\naxis = "{axis}"\n'
        for axis in "xyz"
    ]
    channels = [
        f'[[channel]]\nname = "p{axis}"\nsenses = "play_{axis}"\ngain_m_per_count = {COUNT}\n'
        f"noise_counts = {choice.play_m / COUNT}\n"
        for axis in "xyz"
    ]
    # The transform to the tip becomes the origin of the first slide.
    text = text.replace("[mechanism.tip]\n", slides[0]).replace(
        "[[mechanism.fixture]]", slides[1] + slides[2] + "[[mechanism.fixture]]", 1
    )
    elastic = [
        f'[[effect]]\nname = "{name}"\nwhere = "{joint}"\ncompliance_rad_per_Nm = '
        f"{{ nominal = {width}, uncertainty = {width}, identify = true }}\n"
        for (name, joints), width in zip(
            LOADED.items(), (choice.compliance, choice.bearing), strict=True
        )
        for joint in joints
        if width > 0
    ]
    return text + (DISTANCE if distance else "") + "".join(channels) + "".join(elastic)


def rig_of(choice: Choice, *, distance: bool = True) -> Rig:
    return parse_rig(rig_text_of(choice, distance=distance))


def poses(place: str) -> tuple[Array, NDArray[np.intp]]:
    """Joint angles (P, 7) [rad] at ``place``, and in which socket each was taken (P,)."""
    both = [np.loadtxt(FOLDER[place] / f"hole_{k}.csv", delimiter=",") for k in (0, 1)]
    return np.vstack(both), np.repeat([0, 1], [len(angles) for angles in both]).astype(np.intp)


def observed(places: tuple[str, ...], choice: Choice) -> Observations:
    """Readings of the poses at ``places``; the k-th of them has the fixtures 2 k and 2 k + 1."""
    found = [poses(place) for place in places]
    angles = np.vstack([each for each, _ in found])
    sockets = np.concatenate([2 * k + each for k, (_, each) in enumerate(found)])
    counts = np.hstack([angles / COUNT, np.zeros((len(angles), 3))])
    sigma = np.array([choice.noise_rad] * JOINTS + [choice.play_m] * 3) / COUNT
    return Observations(counts, np.tile(sigma, (len(counts), 1)), Circumstances(sockets))
