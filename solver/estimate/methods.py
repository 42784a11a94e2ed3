"""The methods that can be asked for by name, and which of them fit a mechanism."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from solver.errors import MethodError
from solver.estimate import hinge, likelihood, multi_loop
from solver.estimate.estimate import Estimate
from solver.estimate.nuisance import Observations
from solver.mechanism.model import Model
from solver.mechanism.space import ParameterSpace


@dataclass(frozen=True, slots=True)
class Method:
    """A way to identify parameters.

    Attributes:
        name: what a user asks for.
        title: one line for reports.
        fits: whether it applies to a model.
        identify: runs it.
    """

    name: str
    title: str
    fits: Callable[[Model], bool]
    identify: Callable[[Model, ParameterSpace, Observations], Estimate]


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method(
            likelihood.NAME,
            "maximum likelihood with errors in every reading",
            lambda model: True,
            likelihood.identify,
        ),
        Method(
            hinge.NAME,
            "closure least squares with the hinge eliminated (Giugovaz & Hollerbach)",
            hinge.fits,
            hinge.identify,
        ),
        Method(
            multi_loop.NAME,
            "multiple-loop least squares (Nahvi, Hollerbach & Hayward)",
            multi_loop.fits,
            multi_loop.identify,
        ),
    )
}
"""All methods by name; the first that fits is the default."""


def fitting(model: Model) -> tuple[Method, ...]:
    """Methods that apply to ``model``, the default first."""
    return tuple(method for method in METHODS.values() if method.fits(model))


def method_named(name: str | None, model: Model) -> Method:
    """The method called ``name``, or the default.

    Raises:
        MethodError: there is no such method, or it does not fit the mechanism.
    """
    usable = fitting(model)
    if name is None:
        return usable[0]
    if name not in METHODS:
        raise MethodError(f"there is no method '{name}'; methods: {', '.join(METHODS)}")
    if METHODS[name] not in usable:
        raise MethodError(
            f"the method '{name}' does not fit this mechanism; methods that do: {', '.join(m.name for m in usable)}"
        )
    return METHODS[name]
