# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The rod of this package, as a user runs it: `dynamics.follow` with a tolerance."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from bench.contender import Contender, Failure, Prepared, Setting
from bench.tasks import Task
from dlo_ros.command import NANOSECONDS, Command
from dlo_ros.errors import SimulationError
from dlo_ros.parameters import DampingParameters, Settings, SimulationParameters
from dlo_ros.rod import dynamics, statics
from dlo_ros.rod.batch import parameter_sets
from dlo_ros.rod.boundary.imposed_motion import Boundary
from dlo_ros.rod.dynamics import Track
from dlo_ros.rod.model import RodModel
from dlo_ros.rod.resolution import build
from dlo_ros.rod.state import State, rest_state
from dlo_ros.spline import DEGREE, FloatArray


def command(task: Task, control_points: int) -> Command:
    """The manipulation of a task: horizontal clamps that approach each other within 1 s."""
    length = task.rod.length
    names = ("start", "end") if task.both_ends else ("start",)
    times = np.array([0.0, 1.0]) if task.approach else np.zeros(1)
    positions = np.zeros((len(times), len(names), 3))
    if task.both_ends:
        positions[:, 1, 0] = length
        positions[1:, 0, 0] += task.approach
        positions[1:, 1, 0] -= task.approach
    shape = positions.shape[:2]
    return Command(
        0, names, times, positions, np.tile([0.0, 0.0, 0.0, 1.0], (*shape, 1)),
        np.full((*shape, 3), np.nan), control_points,
    )  # fmt: skip


def rod_settings(task: Task, setting: Setting) -> Settings:
    """The parameter file of a setting."""
    damping = DampingParameters(air_drag=setting["drag"], relaxation_time=setting["relaxation"])
    return Settings(
        rod=replace(task.rod, control_points=setting["control_points"]),
        damping=damping,
        simulation=SimulationParameters(tolerance=setting["tolerance"]),
    )


def straight(task: Task, setting: Setting) -> tuple[RodModel, Boundary, State, Command]:
    """The straight rod at rest, with its command."""
    n = setting["control_points"]
    imposed = command(task, n)
    model, boundary = build(rod_settings(task, setting), imposed, n - DEGREE)
    q = np.zeros((n, 4))
    q[:, 0] = model.basis.greville
    return model, boundary, rest_state(0, q, model), imposed


@contextmanager
def in_space(spatial: bool) -> Iterator[None]:
    """Within, no rod takes its planar form (where spatial)."""
    modules = (dynamics, statics, parameter_sets)
    own = [module.in_plane for module in modules]
    try:
        for module in modules if spatial else ():
            module.in_plane = lambda *_: False
        yield
    finally:
        for module, function in zip(modules, own, strict=True):
            module.in_plane = function


class Ours(Contender):
    """The rod of this package.

    Args:
        spatial: whether the form in space, with twist, is forced; else the package chooses.
    """

    size = "control_points"

    def __init__(self, *, spatial: bool) -> None:
        self.spatial = spatial
        self.name = "dlo_ros in space" if spatial else "dlo_ros"

    def settings(self, task: Task) -> Iterable[list[Setting]]:
        """See the base class."""
        counts = (6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 24, 30)
        tolerances = (0.1, 0.05, 0.02, 0.01, 0.005)
        if task.moving:
            damping = [(0.0, task.relaxation_time)]
        else:
            # About critical damping of the slowest motion; and of the fast ones.
            rod = task.rod
            rate = np.sqrt(9.81 / rod.length)
            drags = [f * rod.linear_density * rate for f in (1.0, 2.0, 4.0)]
            damping = list(itertools.product(drags, (0.1, 0.3)))
        if self.spatial:  # dearer, and known from the plane where to look
            tolerances = tolerances[:3]
        for (drag, relaxation), tolerance in itertools.product(damping, tolerances):
            yield [
                {"control_points": n, "tolerance": float(tolerance), "drag": float(drag),
                 "relaxation": relaxation}
                for n in counts
            ]  # fmt: skip

    def prepare(self, task: Task, setting: Setting) -> Prepared:
        """See the base class."""
        model, boundary, state, imposed = straight(task, setting)
        stamps = [round(t * NANOSECONDS) for t in task.instants]

        def run() -> Track:
            with in_space(self.spatial):
                try:
                    return dynamics.follow(model, boundary, state, imposed, stamps)
                except SimulationError as err:
                    raise Failure(str(err)) from err

        basis = model.basis.matrix(task.quadrature[0])

        def curves(track: Track) -> FloatArray:
            shapes: FloatArray = basis @ track.shapes[:, :, [0, 2]]
            return shapes

        return Prepared(run, curves)
