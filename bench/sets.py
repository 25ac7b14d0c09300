# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Many parameter sets at once: 64 of ours against `mujoco.batch`, on one thread.

A setting that is just good enough for one set is too coarse for its neighbours, so that both sides
look for settings of their own, good enough for the sets that are checked.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from mujoco import batch

from bench.contender import Contender, Failure, Prepared, Setting
from bench.mujoco_chain import MujocoChain, chain_curves, chain_xml, clamp_path
from bench.ours import Ours, in_space, rod_settings, straight
from bench.reference import reference
from bench.tasks import Task
from dlo_ros.command import NANOSECONDS
from dlo_ros.rod.batch.parameter_sets import ParameterSets
from dlo_ros.rod.batch.tracks import Tracks
from dlo_ros.spline import FloatArray

SETS = 64
SPREAD = 0.1  # E and density lie within this share of the task's
CHECKED = (0, SETS // 2, SETS - 1)
GROUP = (0, 9, 18, 27, 32, 45, 54, 63)  # the checked ones with others, as many as share steps


def variants(task: Task) -> list[Task]:
    """The task with 64 different E and densities."""
    stiffer = np.linspace(1.0 - SPREAD, 1.0 + SPREAD, SETS)
    denser = 1.0 + SPREAD * np.cos(np.arange(SETS))
    return [task.with_material(float(a), float(b)) for a, b in zip(stiffer, denser, strict=True)]


class Together(ABC):
    """All sets of a task in one setting, ready to run; `run` is timed."""

    tasks: list[Task]

    @abstractmethod
    def run(self) -> Any:
        """Simulate all sets."""

    @abstractmethod
    def curves(self, result: Any, k: int) -> FloatArray:
        """Shape of set k (1, points, 2) [m] out of what `run` returned."""

    stretch = True

    def worst_error(self) -> float:
        """Largest error over L of the sets that are checked; infinite where one fails."""
        try:
            result = self.run()
            return max(
                self.tasks[k].error(
                    self.curves(result, k), reference(self.tasks[k], stretch=self.stretch)
                )
                for k in CHECKED
            )
        except Failure:
            return np.inf


class Lanes(Together):
    """The rod of this package: one call for all sets.

    Args:
        numbers: indices of the parameter sets to simulate.
        spatial: whether the form in space is forced.
    """

    def __init__(
        self, task: Task, setting: Setting, numbers: Sequence[int] = range(SETS), *, spatial: bool
    ) -> None:
        self.tasks, self.numbers, self.spatial = variants(task), list(numbers), spatial
        self.duration = round(task.duration * NANOSECONDS)
        model, boundary, state, self.command = straight(task, setting)
        models = [model.with_settings(rod_settings(self.tasks[k], setting)) for k in self.numbers]
        self.states = [state] * len(models)  # straight and at rest, whatever the material
        self.sets = ParameterSets(models, boundary)
        self.basis = model.basis.matrix(task.quadrature[0])

    def run(self) -> Tracks:
        """See the base class."""
        with in_space(self.spatial):
            tracks = self.sets.follow(self.states, self.command, [self.duration])
        if tracks.failures:
            raise Failure(next(iter(tracks.failures.values())))
        return tracks

    def curves(self, result: Tracks, k: int) -> FloatArray:
        """See the base class."""
        shapes = result.shapes[self.numbers.index(k)]
        curve: FloatArray = self.basis @ shapes[:, :, [0, 2]]
        return curve


class MujocoBatch(Together):
    """`mujoco.batch` with one model for each set.

    Args:
        task: the simulation that is asked for.
        setting: the setting of the chain, such as its number of links.
    """

    stretch = False

    def __init__(self, task: Task, setting: Setting) -> None:
        self.task, self.setting = task, setting
        self.tasks = variants(task)
        self.models = [mujoco.MjModel.from_xml_string(chain_xml(v, setting)) for v in self.tasks]
        self.batch = batch.Batch(self.models[0], SETS, 1)
        self.batch.set_models(self.models)
        self.qpos = self.batch.bind("qpos")
        self.start = self.batch.state.copy()
        path = clamp_path(task, setting["step"])
        self.steps = len(path)
        self.path = np.ascontiguousarray(
            np.broadcast_to(path.reshape(1, self.steps, 6), (SETS, self.steps, 6))
        )

    def run(self) -> Any:
        """See the base class; the coordinates at the end, (64, nq)."""
        self.batch.state[:] = self.start
        if self.task.both_ends:
            self.batch.rollout(
                self.steps, self.path, mujoco.mjtState.mjSTATE_MOCAP_POS.value, record=()
            )
        else:
            self.batch.step(nstep=self.steps)
        return self.qpos

    def curves(self, result: Any, k: int) -> FloatArray:
        """See the base class."""
        return chain_curves(self.tasks[k], self.setting, self.models[k], result[[k]].copy())


class ForSets(Contender):
    """Looks for settings of MuJoCo's chain that are good enough for all sets that are checked."""

    def __init__(self, one: MujocoChain) -> None:
        self.one: Contender = one
        self.name, self.size, self.stretch = one.name, one.size, one.stretch

    def settings(self, task: Task) -> Iterable[list[Setting]]:
        """See the base class."""
        return self.one.settings(task)

    def prepare(self, task: Task, setting: Setting) -> Prepared:
        """One set: each costs as much, and the search takes long enough."""
        return self.one.prepare(task, setting)

    def error(self, task: Task, setting: Setting) -> float:
        """See the base class; of the worst set that is checked."""
        chosen, worst = variants(task), 0.0
        for k in CHECKED:
            worst = max(worst, self.one.error(chosen[k], setting))
            if worst > max(task.levels):
                break
        return worst

    def together(self, task: Task, setting: Setting) -> Together:
        """All sets of a task."""
        return MujocoBatch(task, setting)


class OursForSets(ForSets):
    """Ours: sets share their steps, so that the search is for a group of them."""

    def __init__(self, one: Ours) -> None:
        self.one, self.spatial = one, one.spatial
        self.name, self.size, self.stretch = one.name, one.size, one.stretch

    def settings(self, task: Task) -> Iterable[list[Setting]]:
        """See the base class; every number of control points up to 18."""
        for chain in super().settings(task):
            counts = {s["control_points"] for s in chain}
            counts |= set(range(min(counts), min(max(counts), 18) + 1))
            yield [{**chain[0], "control_points": n} for n in sorted(counts)]

    def prepare(self, task: Task, setting: Setting) -> Prepared:
        """A group of them."""
        lanes = Lanes(task, setting, GROUP, spatial=self.spatial)
        return Prepared(lanes.run, lambda tracks: lanes.curves(tracks, GROUP[0]))

    def error(self, task: Task, setting: Setting) -> float:
        """See the base class; with its conditions, that no setting counts that is right by luck."""
        finer = {**setting, self.size: int(np.ceil(1.25 * setting[self.size]))}
        longer = replace(task, duration=2.0 * task.duration)
        worst = 0.0
        for part, chosen in ((task, setting), (longer, setting), (task, finer)):
            lanes = Lanes(part, chosen, GROUP, spatial=self.spatial)
            worst = max(worst, lanes.worst_error())
            if worst > max(task.levels):
                break
        return worst

    def together(self, task: Task, setting: Setting) -> Together:
        """See the base class."""
        return Lanes(task, setting, spatial=self.spatial)
