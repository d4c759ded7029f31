"""Several rovers side by side on all cores: for learning and for sweeps.

Each simulation has a model of its own, since the soil writes friction and damping of each tip into
it. Worlds may be shared. On soft ground a call steps soil and MuJoCo in compiled code without
Python's lock; on rigid ground MuJoCo releases it in each step.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
import os

from numpy.typing import ArrayLike

from lunar_rover_sim.base.arguments import brief
from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import PhysicsError
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.physics.state import RoverState


class SimulationBatch(Closing):
    """Simulations that are commanded and advanced together.

    Attributes:
        simulations: the simulations, in the order of commands and states.
    """

    def __init__(self, simulations: Sequence[Simulation], threads: int | None = None) -> None:
        """Take over simulations, which `close` closes.

        Args:
            simulations: at least one.
            threads: how many advance at a time; None: as many as there are processors.

        Raises:
            PhysicsError: there is no simulation, or no thread.
        """
        if not simulations:
            raise PhysicsError('simulations: none is not valid; valid is at least one')
        if threads is not None and threads < 1:
            raise PhysicsError(f'threads: {threads} is not valid; valid is >= 1')
        self.simulations = tuple(simulations)
        self._pool = ThreadPoolExecutor(threads or len(os.sched_getaffinity(0)))

    def close(self) -> None:
        """End the threads and close all simulations."""
        self._pool.shutdown()
        for simulation in self.simulations:
            simulation.close()

    def advance(self, velocities_radps: Sequence[ArrayLike],
                n_steps: int) -> list[RoverState | PhysicsError]:
        """Command all rovers and advance them.

        Args:
            velocities_radps: (legs,) setpoints of the motors of each simulation [rad/s].
            n_steps: steps of each.

        Returns:
            The state of each at the end, or the error with which its motion ended.

        Raises:
            PhysicsError: there are not as many commands as simulations.
        """
        if len(velocities_radps) != len(self.simulations):
            raise PhysicsError(f'velocities_radps: {brief(velocities_radps)} is not valid; valid'
                               f' are {len(self.simulations)} commands')

        def one(simulation: Simulation, velocity: ArrayLike) -> RoverState | PhysicsError:
            simulation.command(velocity)
            try:
                return simulation.advance(n_steps)
            except PhysicsError as error:
                return error

        return list(self._pool.map(one, self.simulations, velocities_radps))
