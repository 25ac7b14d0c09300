# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Selection among single effects and pairs: the search, the verdict, the time before a contact.

Where many things are wrong at once, `dlo_ros.diagnosis.explain` takes its place.
"""
