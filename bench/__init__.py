# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Measurements of the rod against goals and other simulators; run with `python -m bench`.

One thread: the numerical libraries read these variables when they are first imported.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"
