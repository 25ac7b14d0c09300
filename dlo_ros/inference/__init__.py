# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Statistical inference on recordings: parameters with priors, correlated errors, evidence."""
