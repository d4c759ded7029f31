"""A sweep over speeds on all cores with Dask: physics alone, one walk a task.

For whole recordings there are campaigns, on a cluster too: docs/tutorials/dataset.md.
Needs `pip install '.[cluster]'`.
"""

from distributed import Client, LocalCluster
import numpy as np

from lunar_rover_sim import Scenario

SPEEDS_MPS = (0.04, 0.08, 0.12, 0.16)


def walk(speed_mps: float, duration_s: float, overrides: tuple[str, ...]) -> float:
    """Walk straight on; return the speed that is reached [m/s]."""
    scenario = Scenario.load('baseline', overrides)
    gait = scenario.gait_controller()
    gait.set_velocity(speed_mps, 0.0)
    with scenario.simulation(scenario.load_world()) as simulation:
        start = state = simulation.state
        while state.stamp_ns < duration_s * 1e9:
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(5)
    return float(np.linalg.norm(state.position_m - start.position_m)) / duration_s


def main(duration_s: float = 10.0, overrides: tuple[str, ...] = ()) -> dict[float, float]:
    """Return the reached speed by the commanded one."""
    Scenario.load('baseline', overrides).load_world()       # once, before all ask for it
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, \
            Client(cluster) as client:
        futures = [client.submit(walk, speed, duration_s, overrides) for speed in SPEEDS_MPS]
        reached = dict(zip(SPEEDS_MPS, client.gather(futures)))
    for speed, found in reached.items():
        print(f'{speed:.2f} m/s commanded, {found:.3f} m/s reached')
    return reached


if __name__ == '__main__':
    main()
