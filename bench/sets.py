"""Many parameter sets at once: 64 runs of ours against `mujoco.batch` on one thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from mujoco import batch

from bench.contender import Contender, Failure, Setting
from bench.mujoco_chain import chain_curves, chain_xml, clamp_path
from bench.reference import reference
from bench.tasks import Task

SETS = 64
SPREAD = 0.1  # E and density lie within this share of the task's
CHECKED = (0, SETS // 2, SETS - 1)


def variants(task: Task) -> list[Task]:
    """The task with 64 different E and densities."""
    stiffer = np.linspace(1.0 - SPREAD, 1.0 + SPREAD, SETS)
    denser = 1.0 + SPREAD * np.cos(np.arange(SETS))
    return [task.with_material(float(a), float(b)) for a, b in zip(stiffer, denser, strict=True)]


def one_by_one(contender: Contender, task: Task, setting: Setting) -> Callable[[], Any]:
    """A run of all sets after each other."""
    runs = [contender.prepare(v, setting).run for v in variants(task)]
    return lambda: [run() for run in runs]


def worst_error(contender: Contender, task: Task, setting: Setting) -> float:
    """Largest error over L of the sets that are checked, ours."""
    chosen = variants(task)
    return max(contender.error(chosen[k], setting) for k in CHECKED)


class MujocoBatch:
    """`mujoco.batch` with one model for each set.

    Args:
        task: what is simulated.
        setting: of the chain, as found for the single run.
    """

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
        """Simulate all sets; the coordinates at the end, (64, nq)."""
        self.batch.state[:] = self.start
        if self.task.both_ends:
            self.batch.rollout(
                self.steps, self.path, mujoco.mjtState.mjSTATE_MOCAP_POS.value, record=()
            )
        else:
            self.batch.step(nstep=self.steps)
        return self.qpos

    def worst_error(self) -> float:
        """Largest error over L of the sets that are checked."""
        qpos = self.run().copy()
        errors = []
        for k in CHECKED:
            try:
                curves = chain_curves(self.tasks[k], self.setting, self.models[k], qpos[[k]])
            except Failure:
                return np.inf
            errors.append(self.tasks[k].error(curves, reference(self.tasks[k], stretch=False)))
        return max(errors)
