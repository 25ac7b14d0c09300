# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The fit of a spline of known length to a traced centreline, and whether it is credible."""
