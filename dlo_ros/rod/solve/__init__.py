# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Solution of the rod's equations: Newton's method, equilibria, steps of time, linear algebra."""
