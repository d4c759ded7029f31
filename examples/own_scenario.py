"""Make a scenario in code, and keep it as a file that `lunar_rover_sim run` takes."""

from pathlib import Path
import sys

from lunar_rover_sim import LunarRoverSimError, Scenario


def main(file: Path) -> None:
    """Write a scenario: many rocks, a low sun from behind, a camera that looks further down."""
    scenario = Scenario.load('baseline', {
        'world.rocks.abundance': 0.05,
        'render_node.sun.elevation_deg': 3.0,
        'render_node.sun.azimuth_deg': 180.0,
        'rover.stereo.pitch_deg': 30.0,
        'drive_node.speed_mps': 0.1,
    }, seed=7, duration_s=30.0)
    file.write_text(scenario.to_yaml(), encoding='utf-8')
    assert Scenario.load(file) == scenario
    print(f'{file}: lunar_rover_sim run {file} -o runs/own')
    try:
        Scenario.load('baseline', {'render_node.sun.elevation_deg': 120.0})
    except LunarRoverSimError as error:
        print(f'refused: {error}')


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else 'own.yaml'))
