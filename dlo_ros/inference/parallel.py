# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Where simulations run: in threads, in processes of this machine, or on a Dask cluster.

Work is a function of a module and items that can be sent (pickled), so all three do the same. A
worker that dies costs time only: what it was doing is done again.
"""

from __future__ import annotations

import importlib
import logging
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from contextvars import ContextVar, copy_context
from functools import cache
from multiprocessing import get_context
from threading import current_thread
from typing import Any, TypeVar

from dlo_ros.dependencies import extra
from dlo_ros.errors import InputError, SimulationError

LOG = logging.getLogger(__name__)

ATTEMPTS = 4  # of work whose worker died
KEPT = "dlo_ros_simulations"  # name of the threads that are kept
CONNECT = 10.0  # [s] until a scheduler must answer

Item = TypeVar("Item")
Result = TypeVar("Result")


class Pool(ABC):
    """Something that does the same work on many items."""

    @abstractmethod
    def results(
        self, work: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[tuple[int, Result]]:
        """Each result with the number of its item, as it comes."""

    def map(
        self,
        work: Callable[[Item], Result],
        items: Sequence[Item],
        done: Callable[[int, Result], None] = lambda index, result: None,
    ) -> list[Result]:
        """Results in the order of the items; `done` is told each as it comes."""
        found: dict[int, Result] = {}
        for k, result in self.results(work, items):
            found[k] = result
            done(k, result)
        return [found[k] for k in range(len(items))]


_most: ContextVar[int | None] = ContextVar("most", default=None)
"""Number of threads that work at the same time, see `at_most`."""


@contextmanager
def at_most(threads: int) -> Iterator[None]:
    """At most so many `Threads` work at the same time."""
    before = _most.set(threads)
    try:
        yield
    finally:
        _most.reset(before)


@cache
def _kept(threads: int) -> ThreadPoolExecutor:
    """Threads that are kept with their memory: new ones cost a twentieth of a diagnosis."""
    return ThreadPoolExecutor(threads, thread_name_prefix=KEPT)


class Threads(Pool):
    """Threads of this process: compiled code runs side by side in them."""

    def results(
        self, work: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[tuple[int, Result]]:
        """See `Pool`."""
        threads = _most.get() or os.cpu_count() or 1
        share = max(1, threads // max(1, len(items)))

        def begun(pool: ThreadPoolExecutor, item: Item) -> Future[Result]:
            """Work on an item, with its share of the threads for what it starts itself."""
            context = copy_context()
            context.run(_most.set, share)
            return pool.submit(context.run, work, item)

        if min(threads, len(items)) < 2:  # here, where `at_most` holds for what `work` starts
            yield from enumerate(map(work, items))
        elif current_thread().name.startswith(KEPT):  # the others may wait for this one
            with ThreadPoolExecutor(threads) as pool:
                yield from enumerate(f.result() for f in [begun(pool, item) for item in items])
        else:
            futures = [begun(_kept(threads), item) for item in items]
            try:
                yield from enumerate(future.result() for future in futures)
            finally:
                for future in futures:
                    future.cancel()
                wait(futures)


class Processes(Pool):
    """Worker processes of this machine.

    Args:
        count: number of processes.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool = self._new()

    def _new(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self._count, mp_context=get_context("spawn"))

    def results(
        self, work: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[tuple[int, Result]]:
        """See `Pool`.

        Raises:
            SimulationError: workers keep dying.
        """
        missing = list(range(len(items)))
        for _ in range(ATTEMPTS):
            futures: dict[int, Future[Result]] = {}
            with suppress(BrokenProcessPool):
                for k in missing:
                    futures[k] = self._pool.submit(work, items[k])
            for k, future in futures.items():
                try:
                    result = future.result()
                except BrokenProcessPool:
                    continue
                missing.remove(k)
                yield k, result
            if not missing:
                return
            LOG.warning("a worker process has died; its work is done again")
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = self._new()
        raise SimulationError("worker processes keep dying; is there enough memory?")

    def close(self) -> None:
        """End the workers."""
        self._pool.shutdown(cancel_futures=True)


class Cluster(Pool):
    """Workers of a Dask cluster.

    Args:
        address: address of the scheduler, such as tcp://host:8786.

    Raises:
        InputError: Dask is not installed, or no scheduler answers.
    """

    def __init__(self, address: str) -> None:
        try:
            distributed: Any = importlib.import_module("distributed")
        except ModuleNotFoundError as err:
            raise InputError(
                f"--scheduler needs Dask; {extra('cluster')}, on the workers as well"
            ) from err
        try:
            self._client = distributed.Client(address, timeout=CONNECT, set_as_default=False)
        except (OSError, ValueError, TypeError) as err:
            raise InputError(f"{address}: no Dask scheduler answers there ({err})") from err
        self._completed = distributed.as_completed

    def results(
        self, work: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[tuple[int, Result]]:
        """See `Pool`; the scheduler gives the work of a lost worker to another one."""
        futures = [self._client.submit(work, item, pure=False, retries=ATTEMPTS) for item in items]
        place = {future.key: k for k, future in enumerate(futures)}
        failed = []
        for future in self._completed(futures, loop=self._client.loop):
            if future.status == "finished":
                yield place[future.key], future.result()
            else:
                failed.append(future)
        for future in failed:
            future.result()  # which raises what went wrong

    def close(self) -> None:
        """Leave the cluster, which goes on."""
        self._client.close()


@contextmanager
def open_pool(workers: int | None = None, scheduler: str | None = None) -> Iterator[Pool]:
    """Where the work shall run: on a cluster, in processes, or (neither given) in threads.

    Raises:
        InputError: both are given, the number is none, or the scheduler does not answer.
    """
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler exclude each other; give one of them")
    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}; it must be at least 1")
    if workers is None and scheduler is None:
        yield Threads()
        return
    pool = Cluster(scheduler) if scheduler is not None else Processes(workers or 1)
    try:
        yield pool
    finally:
        pool.close()
