"""Table I in short: stereo odometry on three scenarios, judged. No ROS, no bag.

`lunar_rover_sim benchmark` makes the whole table: recordings, other SLAM programs, seeds.
"""

from lunar_rover_sim import evaluate, Scenario, Trajectory, VisualOdometry

SCENARIOS = 'baseline', 'feature_sparse', 'low_albedo'


def drive(scenario: Scenario, duration_s: float):
    """Walk an arc, track every image at 20 Hz, and return the result of the evaluation."""
    gait, world = scenario.gait_controller(), scenario.load_world()
    gait.set_velocity(0.12, 0.05)
    states = []
    with scenario.simulation(world) as simulation, scenario.renderer(world) as renderer:
        odometry, state = VisualOdometry.of_rig(renderer.rig), simulation.state
        for k in range(round(duration_s * 200)):
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(5)       # 5 ms
            states.append(state)
            if k % 10 == 9:
                frame = renderer.render(state, k, ('left', 'right'))
                odometry.add(state.stamp_ns, frame.left, frame.right)
    return evaluate(Trajectory.of_states(states), odometry.trajectory(), estimate_frame='left')


def main(duration_s: float = 3.0) -> dict[str, float]:
    """Print the table; return scenario → absolute trajectory error [mm]."""
    errors_mm = {}
    print('| scenario | driven [m] | ATE [mm] |\n|---|---|---|')
    for name in SCENARIOS:
        result = drive(Scenario.load(name), duration_s)
        errors_mm[name] = 1e3 * result.ate_m.rmse
        print(f'| {name} | {result.length_m:.2f} | {errors_mm[name]:.1f} |', flush=True)
    return errors_mm


if __name__ == '__main__':
    main()
