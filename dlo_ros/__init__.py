# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Watch, simulate and identify deformable linear objects (cables, ropes, hoses)."""

import os

__version__ = "0.2.0"

# Linear algebra here is on small matrices, to which threads of BLAS bring nothing but waiting for
# one another: statistics of a diagnosis take six times the processor time with two of them. What
# runs side by side is whole simulations. BLAS looks at these names when NumPy is first imported.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
