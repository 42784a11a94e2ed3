"""The grown model: its derivatives are true, and at zero coefficients it is the plain one."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import load_rig
from solver.effects.effect import Effect, Recorded, Site
from solver.effects.grown import Grown, grow
from solver.effects.registry import effect_kinds
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import Linearised, model_of
from solver.mechanism.space import ParameterSpace

Array = np.ndarray
POSES = 6


def circumstances(rng: np.random.Generator, channels: int, places: int) -> Circumstances:
    return Circumstances(
        time_s=np.sort(rng.uniform(0, 100, POSES)),
        approach=rng.choice([-1.0, 1.0], (POSES, channels)),
        rate=rng.normal(0, 0.3, (POSES, channels)),
        noise=np.full((POSES, channels), 2.0),
        torque=rng.normal(0, 5, (POSES, places)),
        force=rng.normal(0, 20, (POSES, 3)),
    )


def poses(rig_name: str, rng: np.random.Generator) -> tuple[Site, Array, Circumstances, Array]:
    rig = load_rig(rig_name)
    site, model = Site(rig), model_of(rig)
    homes = getattr(model, "homes", np.zeros(len(model.coordinate_names)))
    u = homes + rng.uniform(-0.3, 0.3, (POSES, len(homes)))
    at = circumstances(rng, len(rig.channels), len(rig.mechanism.places))
    nominal = ParameterSpace.of(site.table).nominal
    counts = model.linearise(u, nominal, np.zeros((len(nominal), 0))).readings
    gains = np.array([site.nominal(f"{c.name}.gain") for c in rig.channels])
    zeros = np.array([c.zero_count for c in rig.channels])
    offsets = np.array([site.nominal(f"{c.name}.offset") for c in rig.channels])
    return site, u, at, gains * (counts - zeros) + offsets


def every_effect(site: Site, values: Array, at: Circumstances) -> list[Effect]:
    stated = ((c.gain.nominal, c.offset.nominal, c.zero_count) for c in site.rig.channels)
    gain, offset, zero = np.array(list(stated)).T
    recorded = Recorded(values, at, np.round((values - offset) / gain + zero))
    return [
        variant
        for kind in effect_kinds().values()
        for place in kind.places(site)[:3]
        for variant in kind.variants(site, place, recorded)[:2]
    ]


def flat(at: Linearised) -> Array:
    return np.concatenate([at.readings, at.closure], axis=1)


@pytest.mark.parametrize("rig_name", ["arm", "shoulder"])
def test_derivatives_are_those_of_finite_differences(rig_name: str) -> None:
    rng = np.random.default_rng(5)
    site, u, at, values = poses(rig_name, rng)
    for effect in every_effect(site, values, at):
        model, table = grow(site, [effect])
        plausible = np.array([c.plausible for c in effect.coefficients])
        x = np.array([p.nominal for p in table])
        x[model.named :] += plausible * rng.uniform(0.5, 1.0, len(plausible))
        directions = np.eye(len(x))
        here = model.linearise(u, x, directions, at)
        by_x = np.concatenate([here.readings_by_parameters, here.closure_by_parameters], axis=1)
        by_u = np.concatenate([here.readings_by_coordinates, here.closure_by_coordinates], axis=1)
        steps = np.concatenate([1e-6 * (np.abs(x[: model.named]) + 1e-2), 1e-4 * plausible])
        steps[[i for i, p in enumerate(table) if p.dimension.endswith("count")]] = 1e-10
        if effect.coded(
            flat(here), np.array([c.start for c in effect.coefficients]), at
        ) is not None and not len(plausible):
            continue  # codes that jump have the slope between their jumps
        for n, step in enumerate(steps):
            up, down = (
                flat(model.linearise(u, x + s * step * directions[n], directions[:, :0], at))
                for s in (1, -1)
            )
            numeric = (up - down) / (2 * step)
            scale = 1e-6 * (1.0 + np.abs(numeric).max()) + 1e-9 / step
            assert np.abs(by_x[:, :, n] - numeric).max() < scale, (effect.label, table[n].name)
        for k in range(u.shape[1]):
            unit = np.eye(u.shape[1])[k] * 1e-6
            up, down = (
                flat(model.linearise(u + s * unit, x, directions[:, :0], at)) for s in (1, -1)
            )
            numeric = (up - down) / 2e-6
            assert np.abs(by_u[:, :, k] - numeric).max() < 1e-5 * (1.0 + np.abs(numeric).max()), (
                effect.label
            )


@pytest.mark.parametrize("rig_name", ["arm", "shoulder"])
def test_without_coefficients_it_is_the_plain_model(rig_name: str) -> None:
    rng = np.random.default_rng(6)
    site, u, at, values = poses(rig_name, rng)
    plain = model_of(site.rig)
    nominal = ParameterSpace.of(site.table).nominal
    expected = plain.linearise(u, nominal, np.zeros((len(nominal), 0)), at)
    for effect in every_effect(site, values, at):
        if effect.coded(expected.readings, np.zeros(len(effect.coefficients)), at) is not None:
            continue
        model, table = grow(site, [effect])
        assert isinstance(model, Grown)
        x = np.concatenate([nominal, np.zeros(len(effect.coefficients))])
        got = model.linearise(u, x, np.zeros((len(table), 0)), at)
        np.testing.assert_allclose(flat(got), flat(expected), rtol=1e-12, atol=1e-12)
