# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Thresholds of inference, identification and diagnosis stand in one table, and nowhere else."""

import ast
from itertools import pairwise

import pytest
from conftest import ROOT
from parsed_sources import parsed

from dlo_ros.inference import thresholds

PARTS = ("inference", "identification", "diagnosis")
TABLE = "dlo_ros.inference.thresholds"
MOST = 39
MODULES = [p for part in PARTS for p in sorted((ROOT / "dlo_ros" / part).rglob("*.py"))]
ORDER = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
MULTIPLES = (0.0, 0.5, 1.0, 2.0)
ROUNDING = 1e-5

# Numbers with which something is compared, but which decide how exact a result is, how much work is
# done, or when, and not what it says.
SETTINGS = {
    # Where an iteration, a step or a sum ends, and rounding.
    "estimate.OPEN",
    "fisher_scoring.CONVERGED",
    "fisher_scoring.NEARLY_LINEAR",
    "force_scale.CLOSE",
    "initial_fit.FALLS",
    "joint_fit.DAMPED",
    "joint_fit.GOOD",
    "joint_fit.POOR",
    "linearised_model.NEGLECTED",
    "linearised_model.SHORTEST_STEP",
    "observation_operator.FACING",
    "observation_operator.NEGLECTED",
    "recorded_inputs.LEAST",
    "time_steps.SHORTEST",
    "linearised_model.FLAT",
    "wrench_identification.ROUNDING",
    # How much is tried, kept or shown.
    "cause_search.MOST_CAUSES",
    "confirmed_uncertainty.LONGEST",
    "joint_fit.SECANTS",
    "offered_effects.SHAPES_ALIKE",
    "peg_places.BENT",
    "relations.CLEAR",
    "relations.MOST_INPUTS",
    "rivals.RIVAL_FITS",
    "suspects.AT_MOST",
    # How many pictures, messages or seconds a method takes.
    "first_motion.PICTURES",
    "first_motion.STILL",
    "holdout.SPARE",
    "missing_force.WINDOW",
    "wrench_messages.LONGEST_WINDOW",
    "wrench_messages.QUADRATIC",
    # When a live estimate is made, passed on or looked at again.
    "accumulated_information.AUTOCORRELATION_EVERY",
    "set_up_errors.UNCHANGED",
    "online_estimator.ASSUMED_ERROR",
    "online_estimator.WINDOW",
    "online_force_scale.GROWTH",
    "residual_monitor.EVERY",
    "residual_monitor.FIRST",
    "residual_monitor.LOOKS",
    "residual_monitor.WINDOW",
    "set_up_errors.BEGINNING",
    "set_up_errors.SETTLED",
    "set_up_errors.SET_UP_GROWTH",
}


def numbers(tree):
    """Names that a module gives to numbers."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and any(
            isinstance(n, ast.Constant) and isinstance(n.value, (int, float))
            for n in ast.walk(node.value)
        ):
            yield from (n.id for t in node.targets for n in ast.walk(t) if isinstance(n, ast.Name))


def origins(stem, tree):
    """Names of numbers in a module that it or another one of the three parts assigns, with that."""
    found = dict.fromkeys(numbers(tree), stem)
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module != TABLE:
            path = ROOT / f"{node.module.replace('.', '/')}.py"
            if path in MODULES:
                own = set(numbers(parsed(path)))
                found |= {a.name: path.stem for a in node.names if a.name in own}
    return found


def compared(stem, tree):
    """Numbers outside of the table with which a module compares something: names, and bare ones."""
    known = origins(stem, tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare) and any(isinstance(op, ORDER) for op in node.ops):
            inside = list(ast.walk(node))
            names = {n.id for n in inside if isinstance(n, ast.Name) and n.id.isupper()}
            names |= {n.attr for n in inside if isinstance(n, ast.Attribute) and n.attr.isupper()}
            yield from (f"{known[n]}.{n}" for n in names if n in known)
            bare = [n.value for n in inside if isinstance(n, ast.Constant)]
            if not names:
                yield from (
                    f"{stem}: {x}" for x in bare
                    if isinstance(x, float) and x not in MULTIPLES and abs(x) > ROUNDING
                )  # fmt: skip


def table():
    """Names of the thresholds, with what is said of each."""
    body = parsed(ROOT / f"{TABLE.replace('.', '/')}.py").body
    for assigned, text in pairwise(body):
        if isinstance(assigned, ast.Assign):
            assert isinstance(text, ast.Expr), f"{ast.unparse(assigned)}: without a reason"
            yield assigned.targets[0].id, ast.literal_eval(text.value)


def test_there_are_few_and_each_has_its_reason():
    found = dict(table())
    assert len(found) <= MOST
    for name, words in found.items():
        assert isinstance(getattr(thresholds, name), (int, float)), name
        assert ":" in words or ", since " in words, f"{name}: why has it this value?"


def test_each_is_needed():
    used = {
        alias.name
        for path in ROOT.joinpath("dlo_ros").rglob("*.py")
        for node in parsed(path).body
        if isinstance(node, ast.ImportFrom) and node.module == TABLE
        for alias in node.names
    }
    assert used == {name for name, _ in table()}


@pytest.mark.parametrize("path", MODULES, ids=lambda p: p.stem)
def test_no_other_number_decides(path):
    if path.stem != "thresholds":
        found = set(compared(path.stem, parsed(path))) - SETTINGS
        assert not found, f"{path}: belongs into {TABLE}"
        assert not {n for n, _ in table()} & set(numbers(parsed(path))), path


def test_settings_are_still_compared_with():
    assert {n for p in MODULES for n in compared(p.stem, parsed(p))} >= SETTINGS


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("BETTER = 0.8\ndef f(a, b):\n    return a < BETTER * b\n", {"fit.BETTER"}),
        ("NEAR, FAR = 0.1, 0.3\ndef f(a):\n    return NEAR <= a\n", {"fit.NEAR"}),
        ("from dlo_ros.inference.losses import CONVERGED\nx = 1 > CONVERGED\n",
         {"losses.CONVERGED"}),
        ("def f(a, b):\n    return a > 0.15 * b\n", {"fit: 0.15"}),
        (f"from {TABLE} import WORTH\ndef f(a):\n    return a >= WORTH\n", set()),
        ("from dlo_ros.rod.resolution import RECHECK_RATIO\nx = 2 < RECHECK_RATIO\n", set()),
        ("END = 'end'\ndef f(a):\n    return a == END or a > 0.0 or abs(a) < 1e-9\n", set()),
    ],
)  # fmt: skip
def test_a_threshold_elsewhere_is_seen(text, found):
    assert set(compared("fit", ast.parse(text))) == found
