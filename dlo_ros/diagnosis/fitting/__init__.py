# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Candidate models and their fit to recordings."""
