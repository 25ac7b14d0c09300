# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A thread that simulates motions on a copy of the running simulation's state (no ROS here)."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from dlo_ros.errors import DloError
from dlo_ros.nodes.estimator_thread import NICENESS, SWITCH
from dlo_ros.rod.motion_rehearsal import Rehearsal
from dlo_ros.rod.protocol import RodSimulation

WAITING = 4
"""Motions that may wait; one that comes beyond is refused."""


@dataclass(frozen=True)
class Request:
    """A motion to simulate.

    Args:
        prepare: function that returns the started simulation; the thread calls it.
        simulate: function that is called with that simulation; it returns the rehearsal.
    """

    prepare: Callable[[], RodSimulation]
    simulate: Callable[[RodSimulation], Rehearsal]


@dataclass(frozen=True)
class Answer:
    """The result: a rehearsal, or the reason why there is none, and the processor time [s]."""

    found: Rehearsal | None
    problem: str
    took: float


class RehearsalThread:
    """Simulates motions one after the other; started with the first."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._requests: deque[Request] = deque()
        self._answers: deque[Answer] = deque()
        self._generation = 0
        self._stopping = False
        self._thread: threading.Thread | None = None

    def ask(self, request: Request) -> bool:
        """Take a request; False where too many wait."""
        with self._changed:
            if len(self._requests) >= WAITING:
                return False
            if self._thread is None:
                sys.setswitchinterval(SWITCH)
                self._thread = threading.Thread(target=self._run, name="rehearsal", daemon=True)
                self._thread.start()
            self._requests.append(request)
            self._changed.notify()
        return True

    def take(self) -> Answer | None:
        """The next answer, if there is one."""
        with self._changed:
            return self._answers.popleft() if self._answers else None

    def forget(self) -> None:
        """Drop what waits, and the answer to what is under way."""
        with self._changed:
            self._generation += 1
            self._requests.clear()
            self._answers.clear()

    def stop(self) -> None:
        """End the thread; a simulation that is under way may take longer than this call."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(timeout=2.0)

    def _run(self) -> None:
        with suppress(OSError, AttributeError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while True:
            with self._changed:
                while not self._requests and not self._stopping:
                    self._changed.wait()
                if self._stopping:
                    return
                request, generation = self._requests.popleft(), self._generation
            began, found, problem = time.thread_time(), None, ""
            try:
                found = request.simulate(request.prepare())
            except DloError as err:
                problem = str(err)
            except Exception as err:  # a defect must not end the thread, the node reports it
                problem = f"{type(err).__name__}: {err}"
            with self._changed:
                if generation == self._generation:
                    self._answers.append(Answer(found, problem, time.thread_time() - began))
