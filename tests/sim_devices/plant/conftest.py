"""Rigs with described effects."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from recordings.rig import Rig, parse_rig, rig_text


@pytest.fixture(scope="session")
def describing() -> Callable[..., Rig]:
    """Makes a bundled rig that describes an effect: ``describing("arm", "lag", "q3", delay_s=0.1)``."""

    def made(name: str, effect: str, where: str, **values: float | str) -> Rig:
        text, source = rig_text(name)
        lines = [f"{key} = {value}" for key, value in values.items()]
        table = "\n".join(["", "[[effect]]", f'name = "{effect}"', f'where = "{where}"', *lines])
        return parse_rig(text + table + "\n", source)

    return made
