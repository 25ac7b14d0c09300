# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Derivatives of a moving rod by its parameters, carried from step to step."""
