# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Named tuples are handed over by a pointer, and what comes out of them lives as long as needed."""

import os
import subprocess
import sys

import kernel_modules
import pytest

MODULE = """
from typing import NamedTuple

import numpy as np

from dlo_ros.kernel_arguments import whole
from dlo_ros.kernel_linking import linked


class Law(NamedTuple):
    slope: object
    kind: float
    bent: bool


class Rod(NamedTuple):
    law: Law
    mass: object
    length: float


@linked()
def grown(rod, law):
    return Rod(whole(law), rod.mass + rod.length, 2.0 * rod.length)


@linked()
def same_or_new(law, other):
    if other:
        law = Law(law.slope.copy(), 2.0 * law.kind, not law.bent)
    return law


@linked()
def weighed(rod, factor):
    return factor * rod.mass.sum() * rod.law.slope[0, 1] * rod.law.kind


@linked()
def handed_on(rod, factor):
    return weighed(rod, factor) + weighed(rod, 1.0) if rod.law.bent else 0.0


@linked()
def doubled(rod):
    before = rod.mass[0]
    for i in range(rod.mass.size):
        rod.mass[i] *= 2.0
    return before + rod.mass[0]


@linked()
def around(rod, law):
    return Rod(law, rod.mass, rod.length)


@linked(from_python=True)
def refused(rod):
    return around(rod, rod.law).length


@linked(from_python=True)
def made(rod, n):
    for i in range(n):
        rod = grown(rod, same_or_new(rod.law, i % 2 == 0))
    return rod


@linked(from_python=True)
def changed(rod):
    own = Rod(rod.law, rod.mass.copy(), rod.length)
    first = handed_on(own, 3.0)
    return first, doubled(own), handed_on(own, 3.0), own.mass


@linked(from_python=True)
def of_many(rods, n):
    total = 0.0
    for _ in range(n):
        for rod in rods:
            total += handed_on(rod, 1.0)
    return total
"""
CALL = """
import numpy as np
from dlo_ros.rods import Law, Rod, changed, made, of_many, refused

law = Law(np.arange(6.0).reshape(2, 3), 3.0, True)
rod = Rod(law, np.ones(4), 0.5)
for _ in range(100):
    new = made(rod, 4)
    np.full(1000, np.nan)  # takes the place of what was given up too early
    assert new.law.slope.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    assert new.law[1:] == (12.0, True)
    assert new.mass.tolist() == [1.0 + 0.5 + 1.0 + 2.0 + 4.0] * 4
first, doubled, second, mass = changed(rod)
assert (first, doubled, second) == (4.0 * 3.0 * 4.0, 3.0, 8.0 * 3.0 * 4.0)
assert mass.tolist() == [2.0] * 4
assert rod.mass.tolist() == [1.0] * 4
assert of_many((rod, rod._replace(mass=np.ones(2))), 3) == 3 * 2 * (4 * 3.0 + 2 * 3.0)
print("done")
"""
REFUSED = """
try:
    refused(rod)
except Exception as err:
    print(err)
"""


@pytest.fixture
def package(tmp_path):
    folder = kernel_modules.copied(tmp_path)
    (folder / "rods.py").write_text(MODULE)
    return folder


def run(package, code=CALL, **variables):
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")} | variables
    return subprocess.run(
        [sys.executable, "-c", code],
        env=environment | {"PYTHONPATH": str(package.parent)},
        cwd=package.parent, capture_output=True, text=True, timeout=180,
    )  # fmt: skip


@pytest.mark.slow
def test_what_is_handed_over_is_the_callers_and_what_comes_back_lives_on(package):
    for _ in range(2):  # compiled, and from the cache
        done = run(package)
        assert done.stdout == "done\n", done.stderr


@pytest.mark.slow
def test_a_part_that_could_outlive_its_caller_is_refused(package):
    done = run(package, CALL + REFUSED)
    assert "around returns what it was lent without `whole`" in done.stdout, done.stderr


@pytest.mark.slow
def test_without_compiling_a_tuple_is_a_tuple(package):
    done = run(package, NUMBA_DISABLE_JIT="1")
    assert done.stdout == "done\n", done.stderr
