# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The fit to all recordings that may be learned from: where it begins."""

from types import SimpleNamespace

import numpy as np
import pytest

from dlo_ros.diagnosis.findings import joint_learning
from dlo_ros.diagnosis.findings.joint_learning import refitted
from dlo_ros.errors import SimulationError


@pytest.mark.parametrize(
    ("of_search", "of_beginnings", "expected"),
    [(40.0, 90.0, 95.0), (40.0, 10.0, 45.0), (40.0, None, 45.0), (None, 90.0, 95.0)],
)
def test_the_last_fit_begins_where_more_is_explained(
    monkeypatch, of_search, of_beginnings, expected
):
    """A fit beside an impact ends where it is; one to the beginnings lay nearer to all."""

    def fit_of(evidence):
        return SimpleNamespace(
            err=(np.ones(4),), mean_err=1e-3, posterior=SimpleNamespace(evidence=evidence)
        )

    def over(at, _):
        if at.posterior.evidence is None:
            raise SimulationError("no static equilibrium")
        return at

    def longer(begun, *_, **__):
        return fit_of(begun.posterior.evidence + 5.0)

    monkeypatch.setattr(joint_learning, "_over", over)
    monkeypatch.setattr(joint_learning, "fit", longer)
    other = fit_of(of_beginnings) if of_beginnings is not None else None
    found = refitted(fit_of(of_search), (object(),), other)
    assert found.posterior.evidence == expected
    lost = fit_of(None)
    assert refitted(lost, (object(),), lost) is lost
