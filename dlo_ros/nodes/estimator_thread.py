# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The thread of the live estimator, which keeps the node's callbacks short (no ROS here)."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from dlo_ros.command import Command
from dlo_ros.diagnosis.monitor.residual_monitor import ResidualMonitor, Suspicion
from dlo_ros.errors import DloError
from dlo_ros.identification.estimate import Estimate
from dlo_ros.identification.online.online_estimator import OnlineEstimator
from dlo_ros.observation import Observation, Wrenches
from dlo_ros.parameters import Settings

SWITCH = 2e-4
"""Seconds after which the estimator's thread lets the node's callbacks run; by default Python takes
25 times longer, which a clock and several topics add up to a stand-still."""

NICENESS = 5
"""Where processor time is scarce, the estimator gets a third of what observer and simulator get. Of
10, with which it is a tenth, an estimate came minutes late beside other programs."""

WAITING = 200
"""Observed splines that may wait for the estimator; seven seconds of a camera at 30 Hz."""

COMMANDS = 2000
"""Commands that may wait; poses that are sent one by one may be a thousand a second."""


class EstimateOutcome(NamedTuple):
    """The result of an observed spline: an estimate, or the reason why there is none.

    `stamp` is that of the newest spline behind it [ns]; `later` marks an estimate that further work
    has led to, without a new spline; `suspicion` says what the model seems to miss, if anything.
    """

    stamp: int
    estimate: Estimate | None
    problem: str
    later: bool = False
    suspicion: Suspicion | None = None


Task = Settings | Command | Observation | Wrenches


class EstimatorThread:
    """Feeds an `OnlineEstimator`, once it is started.

    Args:
        settings: the parameter file.
        ready: function that the thread calls whenever an outcome can be taken.
    """

    def __init__(self, settings: Settings, ready: Callable[[], None]) -> None:
        self._ready = ready
        self._changed = threading.Condition()
        self._tasks: deque[Task] = deque([settings])
        self._outcomes: deque[EstimateOutcome] = deque(maxlen=WAITING)
        self._generation = 0
        self.paused = self._stopping = False
        self.dropped = 0
        sys.setswitchinterval(SWITCH)
        self._thread = threading.Thread(target=self._run, name="estimator", daemon=True)

    @property
    def waiting(self) -> int:
        """Number of tasks that wait."""
        return len(self._tasks)

    def start(self) -> None:
        """Begin with the tasks that wait; the kernels should be compiled by now."""
        self._thread.start()

    def command(self, command: Command) -> None:
        """Take an imposed motion; where too many wait the oldest is dropped."""
        with self._changed:
            commands = [task for task in self._tasks if isinstance(task, Command)]
            if len(commands) >= COMMANDS:
                self._tasks.remove(commands[0])
        self._put(command)

    def observe(self, observation: Observation) -> None:
        """Take an observed spline; where too many wait every second one is dropped.

        The remaining ones still cover the whole time, and the estimate falls no further behind.
        """
        with self._changed:
            splines = [task for task in self._tasks if isinstance(task, Observation)]
            if len(splines) >= WAITING:
                left_out = {id(spline) for spline in splines[1::2]}
                self._tasks = deque(task for task in self._tasks if id(task) not in left_out)
                self.dropped += len(left_out)
        self._put(observation)

    def feel(self, measured: Wrenches) -> None:
        """Take measured forces."""
        self._put(measured)

    def restart(self, settings: Settings) -> None:
        """Start afresh with these settings; what waits is dropped."""
        with self._changed:
            self._tasks.clear()
            self._outcomes.clear()
            self._generation += 1
        self._put(settings)

    def pause(self, paused: bool) -> None:
        """Let the estimate hold, or go on with what waits."""
        with self._changed:
            self.paused = paused
            self._changed.notify()

    def take(self) -> list[EstimateOutcome]:
        """The outcomes since the last call; none while the estimate holds."""
        with self._changed:
            if self.paused:
                return []
            outcomes = list(self._outcomes)
            self._outcomes.clear()
        return outcomes

    def stop(self) -> None:
        """End the thread; a step in progress may take longer than this call."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)

    def _put(self, task: Task) -> None:
        with self._changed:
            self._tasks.append(task)
            self._changed.notify()

    def _backlog(self) -> bool:
        """Whether splines come faster than they are worked off: more than one waits."""
        return sum(isinstance(task, Observation) for task in self._tasks) > 1

    def _run(self) -> None:
        estimator: OnlineEstimator | None = None
        monitor = ResidualMonitor()
        newest = 0  # stamp of the last spline [ns]
        ahead = 0.0  # processor time that splines have had more than the work they leave over [s]
        # Where processors are scarce, observing and predicting come first: they cannot wait.
        with suppress(OSError, AttributeError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while True:
            with self._changed:
                idle = estimator is None or not _has_work(estimator, monitor)
                while not self._stopping and (self.paused or (idle and not self._tasks)):
                    self._changed.wait()
                if self._stopping:
                    return
                # Between splines there is work to go on with that they have left over. Where there
                # is no time between them it has as much time as they have: an estimate that is
                # never relinearised never becomes right, however many splines it has seen.
                owed = ahead > 0.0 and estimator is not None and estimator.busy and self._backlog()
                task = self._tasks.popleft() if self._tasks and not owed else None
                if not self._tasks:
                    ahead = 0.0
                generation = self._generation
            estimate, problem, began = None, "", time.thread_time()
            try:
                if task is None and estimator is not None:
                    if _proceed(estimator, monitor):
                        estimate = estimator.estimate
                elif isinstance(task, Settings):
                    estimator, monitor = OnlineEstimator(task), ResidualMonitor()
                elif estimator is not None and isinstance(task, Command):
                    estimator.set_command(task)
                elif estimator is not None and isinstance(task, Wrenches):
                    estimator.forces.add(task)
                elif estimator is not None and isinstance(task, Observation):
                    newest = task.stamp
                    estimator.observe(task)
                    estimate = estimator.estimate
            except DloError as err:
                problem = str(err)
            except Exception as err:  # a defect must not end the thread, the node reports it
                problem = f"{type(err).__name__}: {err}"
            took = time.thread_time() - began
            ahead = max(ahead + (took if isinstance(task, Observation) else -took), 0.0)
            if estimate is None and not problem:
                continue
            with self._changed:
                if generation == self._generation:
                    self._outcomes.append(
                        EstimateOutcome(newest, estimate, problem, task is None, monitor.suspicion)
                    )
            self._ready()


def _has_work(estimator: OnlineEstimator, monitor: ResidualMonitor) -> bool:
    """Whether there is work to do between splines."""
    used = estimator.run.used if estimator.run else 0
    return estimator.busy or monitor.busy or monitor.due(used)


def _proceed(estimator: OnlineEstimator, monitor: ResidualMonitor) -> bool:
    """Do one piece of the remaining work; whether it has a new outcome."""
    if estimator.busy:
        estimator.proceed()
        return estimator.estimate.significant or not estimator.busy
    run = estimator.run
    if run is not None and monitor.due(run.used):
        monitor.look(run.forecast(), estimator.settings, estimator.window())
        return False
    monitor.proceed()
    return not monitor.busy
