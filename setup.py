# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""For colcon, which wants this file; everything stands in setup.cfg."""

from setuptools import setup

setup()
