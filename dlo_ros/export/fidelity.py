# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Fidelity of an exported cable: MuJoCo's motion compared with the rod's, by number of elements."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dlo_ros.errors import SimulationError
from dlo_ros.export.chain import CableChain, build_chain
from dlo_ros.export.mjcf import mjcf
from dlo_ros.export.mujoco_run import MujocoCable
from dlo_ros.export.scenes import ComparedMotion
from dlo_ros.inference.err import shape_error, shape_errors
from dlo_ros.parameters import Settings

ELEMENTS = (8, 12, 16, 20, 24, 32, 40, 50, 64, 80, 100, 128)  # that are tried
STEPS = (2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)  # [s] that are tried
DEFAULT_ELEMENTS = 32  # where no simulator can be run
STEP_GAIN = 0.8  # of the error that a shorter step must leave to be worth its time
STABLE = 2.0  # step times highest frequency, below which a chain is stable without damping
BOUND = 3.0  # step times highest frequency: longer ones blow up with damping, too
PATIENCE = 240.0  # [s] of processor time after which no more is tried


@dataclass(frozen=True)
class Fidelity:
    """Deviation of MuJoCo's cable from the rod, errors over L.

    Args:
        scene: name of the motion.
        static: ERR at rest; NaN where the motion does not begin at rest.
        mean, largest: ERR in the mean over the motion and at most; NaN without a motion.
        recorded: mean ERR against what was observed [m]; NaN without a recording.
        rod_recorded: the same of the rod [m].
        seconds: processor time of MuJoCo for each simulated second [s]; NaN without a motion.
    """

    scene: str
    static: float
    mean: float
    largest: float
    recorded: float
    rod_recorded: float
    seconds: float

    @property
    def worst(self) -> float:
        """The larger of both errors, over L."""
        return float(np.nanmax([self.static, self.largest]))


@dataclass(frozen=True)
class Choice:
    """A resolution.

    Args:
        elements: joints.
        step: time step [s].
        achieved: accuracy reached in each scene; empty: nothing was run.
    """

    elements: int
    step: float
    achieved: tuple[Fidelity, ...] = ()

    @property
    def worst(self) -> float:
        """The largest error, over L; infinite where nothing was run."""
        return max((f.worst for f in self.achieved), default=math.inf)


def first_chain(scene: ComparedMotion, settings: Settings, elements: int) -> CableChain:
    """The chain of a cable in the shape with which a scene begins."""
    return build_chain(settings, scene.command, scene.stamps[0], scene.fine, scene.first, elements)


def another_chain(scene: ComparedMotion, settings: Settings, elements: int) -> CableChain:
    """The chain of another cable than the scene's, in its own shape when the scene begins.

    Raises:
        SimulationError, InputError: the grips cannot hold that cable.
    """
    basis, shape = scene.beginning(settings)
    return build_chain(settings, scene.command, scene.stamps[0], basis, shape, elements)


def highest_frequency(chain: CableChain) -> float:
    """The highest frequency of a chain's bending, 4 sqrt(k / (m h^2)) [rad/s]."""
    stiff = float(chain.bend.max()) / (chain.line_density * chain.cell**3)
    return 4.0 * math.sqrt(stiff)


def longest_step(chain: CableChain) -> float:
    """The longest step of `STEPS` with which an undamped chain is stable [s]."""
    stable = STABLE / highest_frequency(chain)
    return next((step for step in STEPS if step < stable), STEPS[-1])


def step_of_another(chain: CableChain, chosen: float, own: CableChain) -> float:
    """A step that is as stable with another chain as the chosen one is with its own [s].

    Args:
        chain: the other chain, which may be stiffer, lighter and less damped.
        chosen: step that was tried with `own` [s].
        own: chain with which it was tried.
    """
    reach = min(chosen * highest_frequency(own), STABLE)
    return min(chosen, reach / highest_frequency(chain))


def choose(
    mujoco: Any,
    scenes: Sequence[ComparedMotion],
    settings: Settings,
    *,
    plugin: bool,
    max_err: float,
) -> Choice | None:
    """The coarsest cable that follows the rod.

    Args:
        mujoco: the module.
        scenes: motions, at least one.
        settings: settings of the cable, which are also those of the scenes.
        plugin: whether the cable is that of MuJoCo's plugin.
        max_err: largest error over L that is allowed.

    Returns:
        That choice, else the most accurate one that was tried; None where all blew up.
    """
    best: Choice | None = None
    began = time.process_time()
    for elements in ELEMENTS:
        before = math.inf
        for step in _steps(scenes, settings, elements):
            if time.process_time() - began > PATIENCE:
                return best
            try:
                achieved = tuple(
                    measure(mujoco, scene, settings, elements, step, plugin=plugin)
                    for scene in scenes
                )
            except SimulationError:
                continue
            found = Choice(elements, step, achieved)
            if best is None or found.worst < best.worst:
                best = found
            if found.worst <= max_err:
                return found
            if found.worst > STEP_GAIN * before:
                break
            before = found.worst
    return best


def _steps(scenes: Sequence[ComparedMotion], settings: Settings, elements: int) -> Iterator[float]:
    """Steps that may be stable."""
    highest = highest_frequency(first_chain(scenes[0], settings, elements))
    yield from (step for step in STEPS if step * highest < BOUND)


def measure(
    mujoco: Any,
    scene: ComparedMotion,
    settings: Settings,
    elements: int,
    step: float,
    *,
    plugin: bool,
) -> Fidelity:
    """Run a scene in MuJoCo and compare.

    Raises:
        SimulationError: it blows up.
    """
    chain = first_chain(scene, settings, elements)
    cable = MujocoCable(mujoco, mjcf(chain, plugin=plugin, step=step, comment=""), chain)
    static = mean = largest = seconds = math.nan
    if scene.soon is not None:
        soon = build_chain(
            settings, scene.command, scene.stamps[0], scene.fine, scene.soon, elements
        )
        cable.throw(soon)
    if scene.settled:
        cable.settle()
    first = cable.shape(scene.basis)
    if scene.settled:
        static = shape_error(first, scene.shapes[0], scene.basis) / scene.basis.length
    shapes = first[None]
    if len(scene.stamps) > 1:
        followed = cable.follow(scene.pose, scene.stamps[0], scene.stamps[1:], scene.basis)
        shapes, seconds = np.concatenate([shapes, followed.shapes]), followed.seconds
        err = shape_errors(shapes, scene.shapes, scene.basis) / scene.basis.length
        mean, largest = float(err.mean()), float(err.max())
    recorded = rod_recorded = math.nan
    if scene.observed is not None and scene.camera is not None:
        recorded, rod_recorded = (
            float(shape_errors(_measured(scene, s), scene.observed, scene.basis).mean())
            for s in (shapes, scene.shapes)
        )
    return Fidelity(scene.name, static, mean, largest, recorded, rod_recorded, seconds)


def _measured(scene: ComparedMotion, shapes: np.ndarray) -> np.ndarray:
    """Shapes (F, n, 3) as the camera sees them."""
    assert scene.camera is not None
    zero = np.zeros((shapes.shape[1], 1))
    return np.array([scene.camera.measured(np.hstack([s, zero]))[:, :3] for s in shapes])
