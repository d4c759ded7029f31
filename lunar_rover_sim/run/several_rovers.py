"""Several rovers in one graph: each in a namespace, with its own physics, on one time.

Every rover has a world of its own, equal to that of the others: rovers neither touch nor see each
other. Each physics_node waits for the joint states of all others as for any participant. So in
lockstep all have the same simulated time after every state; in real time they start together and
follow the wall clock. The first publishes /clock for all.
"""

from __future__ import annotations

from collections.abc import Sequence

from lunar_rover_sim import topics


def overrides(rovers: Sequence[str], rover: str) -> list[str]:
    """Return the overrides of a scenario, `section.parameter=value`, for one of the rovers.

    rovers: the namespaces of all rovers, without slashes
    rover: one of them
    """
    others = [f'/{other}/{topics.JOINT_STATES.name}' for other in rovers if other != rover]
    return [f'physics_node.wait.topics=[{", ".join(others)}]',
            f'physics_node.wait.lags_s=[{", ".join(["0.0"] * len(others))}]',
            f'physics_node.publish_clock={str(rover == rovers[0]).lower()}']
