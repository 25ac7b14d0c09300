# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Selection among single effects: the search and the verdict.

Where more than one thing is wrong, `dlo_ros.diagnosis.explain` takes its place.
"""
