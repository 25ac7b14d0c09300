# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The registry of rod models, and the one place where a simulation is made from the settings.

The model is the one that `simulation.model` names: `spline`, the package's own, or one that another
package registers through the entry point group "dlo_ros.rod_simulations".
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from functools import lru_cache

from dlo_ros.command import Command, Motion
from dlo_ros.errors import ParameterError
from dlo_ros.plugins import loaded
from dlo_ros.rod.difference_quotients import DifferenceQuotients
from dlo_ros.rod.protocol import RodSimulation, RodSimulationClass
from dlo_ros.rod.simulation import Simulation
from dlo_ros.rod_settings import DEFAULT_MODEL, RodSettings

LOG = logging.getLogger(__name__)

GROUP = "dlo_ros.rod_simulations"  # of entry points


@lru_cache(maxsize=1)
def rod_simulations() -> Mapping[str, RodSimulationClass]:
    """All classes of simulations by the name of their rod model: this package's, then others'."""
    found: dict[str, RodSimulationClass] = {DEFAULT_MODEL: Simulation}
    for point, kind in loaded(GROUP, "rod model"):
        missing = [name for name in REQUIRED if not hasattr(kind, name)]
        if missing or not callable(kind):
            LOG.warning(
                "rod model %s: %s is no class with %s", point.name, point.value,
                ", ".join(missing or ["a constructor"]),
            )  # fmt: skip
        elif point.name in found:
            LOG.warning("rod model %s of %s: there is one already", point.name, point.value)
        else:
            found[point.name] = kind
    return found


REQUIRED = (
    "differentiable", "starting", "stamp", "prediction", "advance_through", "fork", "update",
    "hold", "resettle", "start", "judging", "advance", "basis", "true_shape", "batching",
)  # fmt: skip
"""Members of `RodSimulation` that its users call."""


def rod_simulation(name: str) -> RodSimulationClass:
    """The class of simulations of a rod model.

    Raises:
        ParameterError: there is no such model; the message lists those that there are.
    """
    known = rod_simulations()
    if name not in known:
        raise ParameterError(
            f"simulation.model is '{name}'; there is no such rod model, known are "
            f"{', '.join(sorted(known))}"
        )
    return known[name]


def simulation_of(
    settings: RodSettings,
    motion: Motion,
    *,
    parameters: Sequence[str] = (),
    spans: int | None = None,
    loads: bool = False,
) -> RodSimulation:
    """A simulation that has not started, of the rod model that the settings name.

    Args:
        settings: material, damping, gravity, effects and how they are simulated.
        motion: the imposed motion; commands may be added while the simulation runs.
        parameters: parameters by which derivatives are wanted, named as in
            `sensitivity_parameters`. A model without derivatives gives difference quotients.
        spans: knot spans of the simulation; default: as many as simulation.tolerance needs.
        loads: whether predictions contain the loads on the DLO and its grips.

    Raises:
        ParameterError: there is no such rod model.
        InputError: an unknown parameter is asked for.
        SimulationError: the model knows no such effect.
    """
    kind = rod_simulation(settings.simulation.model)
    if not parameters or kind.differentiable:
        return kind(settings, motion, parameters=parameters, spans=spans, loads=loads)
    middle = kind(settings, motion, spans=spans, loads=loads)
    return DifferenceQuotients(middle, parameters, kind=kind)


def with_sensitivities(
    simulation: RodSimulation, parameters: Sequence[str], present: Command
) -> RodSimulation:
    """An independent simulation from here on; see `RodSimulation.with_sensitivities`."""
    if simulation.differentiable:
        return simulation.with_sensitivities(parameters, present)
    return DifferenceQuotients.of_present(simulation.fork(simulation.settings), parameters)
