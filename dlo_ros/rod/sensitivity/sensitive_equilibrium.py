# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Static equilibrium and its derivatives in one call of compiled code.

To look at all arrays of a rod costs Python as much as an iteration of Newton's method.
"""

from __future__ import annotations

from dlo_ros.kernel_linking import linked
from dlo_ros.rod.sensitivity.propagation import propagate_equilibrium
from dlo_ros.rod.solve import equilibrium_continuation
from dlo_ros.rod.solve.generalised_alpha import DONE


@linked(from_python=True)
def settle(system, imposed, state, time, rate2, tolerance, fresh, rest, varying):
    """`equilibrium_continuation.settle`, then `propagate_equilibrium` from where it began.

    Args:
        varying: derivatives before; become those at rest where there is an equilibrium.

    Returns:
        What `equilibrium_continuation.settle` returns.
    """
    found = equilibrium_continuation.settle(
        system, imposed, state, time, rate2, tolerance, fresh, rest
    )
    if found[0] == DONE:
        propagate_equilibrium(system, imposed, state.q, rest, state.internal, fresh, varying)
    return found
