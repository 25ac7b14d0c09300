# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""No list of effects stands outside `dlo_ros/effects`: what must be known of one is on its class.

A name in the source is a string that equals it, or `effects.NAME.KEY`. Two things are allowed. A
name that is a parameter of the file, too, such as `air_drag` of `damping.air_drag`, may mean that.
The package `synthesis` is the independent simulator, which must not share what the effects say.
"""

import ast

import pytest
from conftest import ROOT

from dlo_ros.effects import effects
from dlo_ros.parameter_table import TABLE

PACKAGE = ROOT / "dlo_ros"
OWN = ("effects", "synthesis")
PARAMETERS = {name.rpartition(".")[2] for name in TABLE}
NAMES = set(effects()) - PARAMETERS
MODULES = sorted(
    path for path in PACKAGE.rglob("*.py") if path.relative_to(PACKAGE).parts[0] not in OWN
)


def named(source):
    """Effects that a source names, with their lines; a sentence may speak of one."""
    for node in ast.walk(ast.parse(source)):
        text = node.value if isinstance(node, ast.Constant) else None
        if not isinstance(text, str) or " " in text:
            continue
        if text in NAMES or any(f"effects.{name}." in text for name in effects()):
            yield node.lineno, text


def test_only_one_effect_shares_its_name_with_a_parameter():
    assert set(effects()) & PARAMETERS == {"air_drag"}


def test_a_name_would_be_seen():
    source = 'A = ("clamp_angle",)\nB = "effects.air_drag.coefficient"\nC = "air_drag"\n'
    assert sorted(line for line, _ in named(source)) == [1, 2]


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_no_effect_is_named_outside(path):
    assert not list(named(path.read_text()))
