# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Watch, simulate and identify deformable linear objects (cables, ropes, hoses)."""

from dlo_ros.kernel_cache import discard_stale

__version__ = "0.1.0"

discard_stale()
