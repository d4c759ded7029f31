"""Watch the left camera and the path while the rover walks: Matplotlib, no ROS.

In a browser, with all topics: `lunar_rover_sim run baseline --view -o runs/view`.
"""

import matplotlib.pyplot as plt
import numpy as np

from lunar_rover_sim import Scenario


def main(duration_s: float = 20.0) -> int:
    """Walk an arc and show five pictures a second; return how many were shown."""
    scenario = Scenario.load('baseline')
    world = scenario.load_world()
    gait = scenario.gait_controller()
    gait.set_velocity(0.12, 0.05)
    figure, (left, above) = plt.subplots(1, 2, figsize=(10, 4), layout='constrained')
    above.set(xlabel='x [m]', ylabel='y [m]', aspect='equal', adjustable='datalim')
    path = [np.zeros(2)]
    line, = above.plot([], [])
    image, shown = None, 0
    with scenario.simulation(world) as simulation, scenario.renderer(world) as renderer:
        state = simulation.state
        while state.stamp_ns < duration_s * 1e9 and plt.fignum_exists(figure.number):
            for _ in range(40):     # 0.2 s
                legs = gait.update(state.stamp_ns, state.joint_angle_rad,
                                   state.joint_velocity_radps)
                simulation.command(legs.velocity_radps)
                state = simulation.advance(5)
            frame = renderer.render(state, shown, ('left',))
            image = image or left.imshow(frame.left, cmap='gray', vmin=0, vmax=255)
            image.set_data(frame.left)
            path.append(state.position_m[:2].copy())
            line.set_data(*np.array(path).T)
            above.relim()
            above.autoscale_view()
            left.set_title(f'{state.stamp_ns * 1e-9:.1f} s')
            plt.pause(0.001)
            shown += 1
    return shown


if __name__ == '__main__':
    main()
