"""Walk for two seconds without ROS, and draw the stereo pair with its true depth at the end."""

from pathlib import Path
import sys

import cv2
import numpy as np

from lunar_rover_sim import Scenario


def main(folder: Path) -> None:
    """Write left.png, right.png and depth_m.npy to a folder."""
    scenario = Scenario.load('baseline', seed=3)
    world = scenario.load_world()
    gait = scenario.gait_controller()
    gait.set_velocity(0.12, 0.1)        # m/s ahead, rad/s to the left
    with scenario.simulation(world) as simulation, scenario.renderer(world) as renderer:
        state = simulation.state
        while state.stamp_ns < 2_000_000_000:
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(5)       # 5 ms
        frame = renderer.render(state, 0)
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / 'left.png'), frame.left)
    cv2.imwrite(str(folder / 'right.png'), frame.right)
    np.save(folder / 'depth_m.npy', frame.depth_m)
    x_m, y_m, z_m = state.position_m
    print(f'at ({x_m:.2f}, {y_m:.2f}, {z_m:.2f}) m after {state.stamp_ns * 1e-9:g} s: {folder}')


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else 'step_and_draw'))
