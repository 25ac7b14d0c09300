# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""How wrong a simulation is, in words: by how much, where and when."""

import re
from dataclasses import replace

import numpy as np
from diagnoses import KNOWN, answers, case

from dlo_ros.cli.diagnosis_output import report
from dlo_ros.report.diagnosis import diagnosis_page


def test_the_parameter_file_as_it_stands_is_judged_first():
    (wrong, *_) = answers(replace(case(), given_err=0.041))
    assert wrong.startswith(
        "As the parameter file stands, it is 41 mm off on average. With the best Young's modulus"
    )
    for given in (None, 2.45e-3):  # it cannot be simulated, or is right
        (wrong, *_) = answers(replace(case(), given_err=given))
        assert wrong.startswith("With the best Young's modulus and density it is 2.4 mm off")


def test_where_and_when():
    made = case()
    (view,) = made.views
    before = view.observed.copy()
    before[:, -2:, 2] += 0.01  # at the free end
    err = np.full(len(view.times), 1e-3)
    err[6:9] = 9e-3
    err[-1] = 0.04  # a grossly wrong picture, near the start
    observed = view.observed.copy()
    observed[-1, :2, 2] += 0.4
    first = replace(view, name="swing", observed=observed, before=before, err_before=err)
    second = replace(view, name="rest", err_before=np.full(len(err), 1e-3))
    wrong = answers(replace(made, views=(second, first)))[0]
    assert "most wrong at the end (at 400 of 400 mm from the start)" in wrong
    assert f"worst in swing, {view.times[6]:.1f} s after the beginning: by 9.0 mm" in wrong
    # The page opens with the recording that is worst, not with that of the largest mean.
    second = replace(second, err_before=np.full(len(err), 6e-3))
    page = diagnosis_page(report(replace(made, views=(second, first)), KNOWN))
    told = re.findall("<summary>(.*?)</summary>", page)
    assert told[0] == "rest: 6.0 mm off, 0.10 mm with the extended model"
    assert not any(words.startswith("swing") for words in told)
    even = replace(view, before=view.observed + 0.001)
    wrong = answers(replace(made, views=(even,)))[0]
    assert "about as wrong all along" in wrong and "It is worst" not in wrong
