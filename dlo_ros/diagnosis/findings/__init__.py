# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Findings: fitted numbers, held-out errors, advice and remarks for the report."""
