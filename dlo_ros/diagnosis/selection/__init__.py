# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Selection among single effects and pairs: the search, the verdict, the time before a contact.

What takes its place where many things are wrong at once is `dlo_ros.diagnosis.explain`.
"""
