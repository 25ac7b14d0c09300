# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Work in threads, processes and on a cluster: the same results, and what a dead worker costs."""

import os
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured import swing
from rods import PAPER
from tasks import dies, dies_once, squared

from dlo_ros.errors import InputError, SimulationError
from dlo_ros.identification import identify
from dlo_ros.identification.estimate import searchable
from dlo_ros.identification.offline.posterior_sampling import bootstrap, sample
from dlo_ros.inference.parallel import Cluster, Processes, Threads, at_most, open_pool

pytestmark = pytest.mark.long

GUESS = PAPER.with_material(1e7, 2000.0)


@pytest.fixture(scope="module")
def recordings():
    return [swing(PAPER, seconds=0.8, seed=k) for k in range(3)]


@pytest.fixture(scope="module")
def found(recordings):
    return identify(recordings, GUESS)


def test_threads_and_processes_keep_the_order():
    told = []
    assert Threads().map(squared, range(5), lambda k, r: told.append((k, r))) == [0, 1, 4, 9, 16]
    assert sorted(told) == [(k, k * k) for k in range(5)]
    with open_pool(workers=2) as pool:
        assert pool.map(squared, range(5)) == [0, 1, 4, 9, 16]


def test_at_most_so_many_threads_work_at_the_same_time():
    def own(_):
        time.sleep(0.01)
        return threading.get_ident()

    with at_most(1):
        assert set(Threads().map(own, range(6))) == {threading.get_ident()}
    with at_most(2):
        assert 1 <= len(set(Threads().map(own, range(6)))) <= 2


@pytest.mark.parametrize(("threads", "items"), [(2, 3), (4, 2), (1, 3)])
def test_work_that_starts_more_work_has_its_share_of_the_threads(threads, items):
    lock, now, most = threading.Lock(), [0], [0]

    def leaf(_):
        with lock:
            now[0] += 1
            most[0] = max(most[0], now[0])
        time.sleep(0.02)
        with lock:
            now[0] -= 1

    with at_most(threads):
        Threads().map(lambda _: Threads().map(leaf, range(4)), range(items))
    assert most[0] == threads


def test_threads_may_wait_for_threads():
    """All of them at once, each for more of them."""
    with at_most(2):
        assert Threads().map(lambda k: sum(Threads().map(squared, range(k))), range(6)) == [
            0, 0, 1, 5, 14, 30
        ]  # fmt: skip


def test_where_one_of_the_threads_fails_none_goes_on():
    ended = []

    def work(k):
        if k == 0:
            raise SimulationError("does not converge")
        time.sleep(0.05)
        ended.append(k)

    with at_most(2):
        with pytest.raises(SimulationError):
            Threads().map(work, range(9))
        before = list(ended)
        time.sleep(0.1)
        assert ended == before and len(before) < 8
        assert Threads().map(squared, range(3)) == [0, 1, 4]


@pytest.mark.slow
def test_a_worker_that_dies_costs_no_result(tmp_path, caplog):
    pool = Processes(2)
    marker = str(tmp_path / "marker")
    assert pool.map(dies_once, [(k, marker) for k in range(4)]) == [0, 1, 2, 3]
    assert "died" in caplog.text
    with pytest.raises(SimulationError, match="keep dying"):
        pool.map(dies, [1])
    pool.close()


def test_unusable_pools_are_refused():
    with pytest.raises(InputError, match="exclude each other"), open_pool(2, "tcp://x:1"):
        pass
    with pytest.raises(InputError, match="at least 1"), open_pool(0):
        pass


@pytest.mark.slow
def test_processes_find_what_threads_find(recordings, found):
    with open_pool(workers=2) as pool:
        other = identify(recordings, GUESS, pool=pool)
    assert other.estimate.specific_modulus == pytest.approx(
        found.estimate.specific_modulus, rel=1e-9
    )


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("dask") is None and not shutil.which(
    "dask", path=str(Path(sys.executable).parent)), reason="Dask is not installed")  # fmt: skip
def test_a_cluster_finds_the_same_though_a_worker_is_lost(tmp_path, recordings, found):
    dask = shutil.which("dask", path=str(Path(sys.executable).parent)) or shutil.which("dask")
    address = f"tcp://127.0.0.1:{20000 + os.getpid() % 20000}"
    root = Path(__file__).resolve().parents[2]
    paths = os.pathsep.join(
        [str(root), str(root / "test" / "support"), os.environ.get("PYTHONPATH", "")]
    )
    quiet = {
        "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path,
        "env": {**os.environ, "PYTHONPATH": paths},
    }  # fmt: skip
    port = address.rsplit(":", 1)[1]
    command = [dask, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"]
    processes = [subprocess.Popen(command, **quiet)]
    try:
        for _ in range(2):
            words = [dask, "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
            processes.append(subprocess.Popen(words, **quiet))
        deadline = time.monotonic() + 60.0
        while True:
            try:
                pool = Cluster(address)
                break
            except InputError:
                assert time.monotonic() < deadline
                time.sleep(1.0)
        done = []

        def lose_one(number, theta):
            done.append(number)
            if len(done) == 2:
                processes[1].kill()

        here = bootstrap(found.fitted, count=6)
        there = bootstrap(found.fitted, count=6, pool=pool, done=lose_one)
        np.testing.assert_allclose(there, here, rtol=1e-6)
        assert sorted(done) == list(range(6))
        pool.close()
    finally:
        for process in processes:
            process.kill()
            process.wait()


def test_a_scheduler_that_is_not_there_is_told():
    with pytest.raises(InputError, match=r"'\.\[cluster\]'|no Dask scheduler"):
        Cluster("tcp://127.0.0.1:1")


@pytest.mark.slow
def test_the_sampled_posterior_is_that_of_the_curvature(recordings, found):
    """One informative shape is nearly linear in ln(E/mu), so both must agree."""
    drawn = sample(searchable(GUESS), found.fitted, count=200)
    low, middle, high = drawn.quantiles("specific_modulus")
    estimate = found.estimate
    assert drawn.effective > 40
    std = estimate.specific_modulus_std
    assert abs(middle - estimate.specific_modulus) < std
    assert high - low == pytest.approx(2 * 1.96 * std, rel=0.4)
    # What is not known stays as open as the guess.
    wide = drawn.quantiles("density")
    assert wide[2] / wide[0] > 2.0


@pytest.mark.slow
def test_a_bootstrap_scatters_as_the_estimate_says_and_goes_on(recordings, found):
    first = {}
    all_at_once = bootstrap(found.fitted, count=8, done=lambda k, t: first.update({k: t}))
    assert all_at_once.shape == (8, 4)
    ratio = all_at_once[:, 0] - all_at_once[:, 1]
    relative = found.estimate.specific_modulus_std / found.estimate.specific_modulus
    assert 0.1 * relative < np.std(ratio) < 5.0 * relative
    again = []
    kept = {k: first[k] for k in range(6)}
    resumed = bootstrap(found.fitted, count=8, before=kept, done=lambda k, t: again.append(k))
    assert again == [6, 7]
    np.testing.assert_allclose(resumed, all_at_once)
    with pytest.raises(InputError, match="at least two"):
        bootstrap(replace(found.fitted, recordings=found.fitted.recordings[:1]), count=2)
