# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Proposals: effects and causes that may explain residuals, by linear tests before a fit."""
