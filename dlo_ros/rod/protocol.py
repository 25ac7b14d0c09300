# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The protocol of a simulated DLO: all that the rest of the package asks of a rod model.

`Simulation` is the package's own, a dynamic spline. Another one is a class that follows this
protocol, registered as docs/another_rod_model.md describes.
"""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Generator, Sequence
from typing import ClassVar, Protocol

from dlo_ros.command import Command, Motion
from dlo_ros.observation import Observation
from dlo_ros.rod.prediction import Prediction
from dlo_ros.rod.resolution import Resolution
from dlo_ros.rod_settings import RodSettings
from dlo_ros.spline import FloatArray, SplineBasis

LOG = logging.getLogger(__name__)


def instability(*, flat: bool = False) -> str:
    """The sentence about a first equilibrium that a real DLO would leave.

    Args:
        flat: whether it is simulated in the plane y = 0.
    """
    leaves = " out of the plane y = 0, in which it is simulated all the same" if flat else ""
    return f"a real DLO would not stay in the first shape at rest: it is unstable{leaves}"


class RodSimulation(Protocol):
    """One simulated DLO: it is started from observed shapes and advanced from stamp to stamp.

    A class of another package names this one as its base; what has a body here need not be
    written anew.

    Attributes:
        differentiable: whether predictions have sensitivities; where not, they are made from
            difference quotients (`dlo_ros.rod.difference_quotients`).
        settings: material, damping, gravity and effects.
        motion: the imposed motion; commands may be added while the simulation runs.
        parameters: names of those by which derivatives are wanted.
        published: spline basis of predictions, with rod.control_points control points.
        stable: whether the equilibrium that it started from is stable.
        resolution: the discretisation that was chosen, with its error; None: none was judged.
    """

    differentiable: ClassVar[bool] = False

    settings: RodSettings
    motion: Motion
    parameters: tuple[str, ...]
    published: SplineBasis
    stable: bool = True
    resolution: Resolution | None = None

    @abstractmethod
    def starting(
        self, observations: Sequence[Observation], last_stamp: int | None = None
    ) -> Generator[None, None, None]:
        """Set the initial state as simulation.start says, in short pieces.

        Args:
            observations: the first observed shapes, at least one, or two for `moving`. It begins
                at the first, or for `moving` at the second; further ones have no meaning.
            last_stamp: stamp until which the motion matters for the resolution [ns]; default: the
                command's end.

        Raises:
            InputError: too few observations, a wrong number of control points, no command.
            SimulationError: no equilibrium, or imposed ends out of reach.
        """

    @property
    @abstractmethod
    def stamp(self) -> int:
        """The simulated instant, at the time of its measurement [ns]."""

    @abstractmethod
    def prediction(self) -> Prediction:
        """The present shape as the camera measures it."""

    @abstractmethod
    def advance_through(self, stamps: Sequence[int]) -> list[Prediction]:
        """Simulate to a series of stamps [ns], growing, and return the shape at each.

        Raises:
            InputError: not started, or stamps that do not grow from the present instant on.
            SimulationError: the motion cannot be followed; the state stays as it was.
        """

    @abstractmethod
    def fork(
        self, settings: RodSettings, motion: Motion | None = None, *, loads: bool | None = None
    ) -> RodSimulation:
        """An independent simulation that goes on from the present state with other parameters.

        Args:
            settings: see the class.
            motion: imposed from here on; default: the same.
            loads: whether predictions say what the DLO and its grips bear; default: as here.
        """

    @abstractmethod
    def update(self, settings: RodSettings) -> None:
        """Change material, damping, gravity, effects or tolerance while the simulation runs.

        Raises:
            ParameterError, SimulationError: effects leave no DLO, or the model knows no such
                effect; nothing is changed then.
        """

    @abstractmethod
    def hold(self, stamp: int) -> None:
        """Keep the shape until a stamp [ns], where a motion cannot be followed."""

    @abstractmethod
    def resettle(self, stamp: int) -> Prediction:
        """Settle to equilibrium under the command at a stamp [ns], from the present shape.

        Raises:
            SimulationError: there is no equilibrium; the state stays as it was.
        """

    def start(self, observations: Sequence[Observation], last_stamp: int | None = None) -> None:
        """Set the initial state at once; see `starting`."""
        for _ in self.starting(observations, last_stamp):
            pass
        self.warn_of_instability()

    def warn_of_instability(self) -> None:
        """Log a warning where a real DLO would leave the equilibrium that was started from.

        It is no news where the parameters are a hypothesis, such as an effect that is tried.
        """
        if not self.stable:
            LOG.warning("%s", instability())

    def judging(
        self, observations: Sequence[Observation], last_stamp: int | None = None
    ) -> Generator[None, None, None]:
        """Find the `resolution` that `starting` needs, in short pieces; arguments as there.

        Raises:
            InputError, SimulationError: as `starting`.
        """
        yield from ()

    def advance(self, stamp: int) -> Prediction:
        """Simulate to a stamp [ns]; see `advance_through`."""
        if stamp == self.stamp:
            return self.prediction()
        return self.advance_through([stamp])[0]

    @property
    def basis(self) -> SplineBasis:
        """The simulation's own spline basis, once it has started."""
        return self.published

    def true_shape(self) -> FloatArray:
        """Control points of the present true shape in `basis`, shape (m, 4)."""
        return self.prediction().control_points

    def with_sensitivities(self, parameters: Sequence[str], present: Command) -> RodSimulation:
        """An independent simulation from here on, with sensitivities of its present state.

        A DLO at rest would rest elsewhere with other parameters; one that moves is taken to be
        where it is, whatever they are. It is asked of a `differentiable` simulation only.

        Args:
            parameters: names of those by which derivatives are wanted.
            present: the command that holds now.
        """
        raise TypeError(f"{type(self).__name__} says that it is not differentiable")

    def batching(
        self, sets: Sequence[RodSettings], last_stamp: int
    ) -> Generator[None, None, RodBatch | None]:
        """Many parameter sets at once, from this simulation's start, piece by piece.

        Args:
            sets: settings of the same DLO; the first are the simulation's own settings.
            last_stamp: stamp until which the sets will be simulated [ns].

        Returns:
            None where they cannot share their simulation, or the model has no batch: they are
            simulated one by one then.
        """
        yield from ()
        return None


class RodBatch(Protocol):
    """S parameter sets of one DLO that are simulated at once.

    Attributes:
        failures: the reason why a set cannot be simulated, by its number.
        stable: whether the equilibrium that a set starts from is stable, S of them.
    """

    failures: dict[int, str]
    stable: Sequence[bool]

    @property
    def shapes(self) -> FloatArray:
        """The present control points in the published basis, shape (S, n, 4); NaN: failed."""

    def advance_through(self, stamps: Sequence[int]) -> FloatArray:
        """Simulate to a series of stamps [ns], growing.

        Returns:
            Control points in the published basis, shape (S, T, n, 4); those of sets in `failures`
            mean nothing.

        Raises:
            InputError: the sets cannot share their simulation.
        """


class RodSimulationClass(Protocol):
    """A class of simulations, as it is registered; it is called as `Simulation` is."""

    differentiable: bool

    def __call__(
        self,
        settings: RodSettings,
        motion: Motion,
        *,
        parameters: Sequence[str] = (),
        spans: int | None = None,
        loads: bool = False,
    ) -> RodSimulation:
        """A simulation that has not started; arguments as of `simulation_of`."""
