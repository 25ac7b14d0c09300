# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How large an error is in most pictures."""

import re
from dataclasses import replace

import numpy as np
import pytest
from diagnoses import answers, case


def test_a_few_pictures_have_no_nine_of_ten():
    made = case()
    (view,) = made.views
    errors = np.linspace(1e-3, 9e-3, 60)
    shown = {
        name: np.repeat(getattr(view, name)[:1], 60, axis=0) for name in ("observed", "before")
    }
    many = replace(view, times=np.arange(60.0), err_before=errors, **shown)
    spoilt = errors.copy()
    spoilt[[-1, 5, 20, 40]] = 0.04  # single pictures that are grossly wrong
    for err in (errors, spoilt):
        said = answers(replace(made, views=(replace(many, err_before=err),)))[0]
        low, high = re.search(r"between (\S+) mm and (\S+) mm off in nine of ten", said).groups()
        assert float(low) == pytest.approx(1.4, abs=0.15)
        assert float(high) == pytest.approx(8.6, abs=0.15)
    few = replace(view, err_before=np.linspace(1e-3, 9e-3, len(view.times)))
    assert len(few.times) < 20
    assert "nine of ten pictures" in answers(replace(made, views=(many,)))[0]
    assert "nine of ten pictures" not in answers(replace(made, views=(few,)))[0]
