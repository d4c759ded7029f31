"""`lunar_rover_sim slam`: what SLAM programs need."""

from __future__ import annotations

import argparse
from pathlib import Path

# As in bag.orbslam3_settings, which is too heavy to import for a parser.
SENSORS = ('mono', 'stereo', 'stereo-inertial', 'rgbd')


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the commands."""
    text = 'what SLAM programs need: settings files'
    group = subparsers.add_parser('slam', help=text, description=text).add_subparsers(
        metavar='WHAT', required=True)
    text = 'write the settings file of ORB-SLAM3 for a bag or a scenario'
    parser = group.add_parser('settings', help=text, description=text)
    parser.add_argument('source', metavar='BAG|SCENARIO', help='a bag, or a scenario by name or '
                                                               'file')
    parser.add_argument('-o', '--output', type=Path, required=True, metavar='FILE',
                        help='YAML file to write; must not exist')
    parser.add_argument('--sensor', choices=SENSORS, default='stereo')
    parser.add_argument('--features', type=int, default=2000, metavar='N',
                        help='keypoints per image (default: %(default)s)')
    parser.add_argument('--legacy', action='store_true',
                        help='the layout before File.version 1.0')
    parser.set_defaults(run=_settings)


def _settings(args: argparse.Namespace) -> int:
    from lunar_rover_sim.bag.orbslam3_settings import settings
    from lunar_rover_sim.bag.reader import open_bag
    from lunar_rover_sim.bag.sensors import described_sensors, recorded_sensors
    from lunar_rover_sim.config import load_scenario
    from lunar_rover_sim.errors import ConfigError

    source = Path(args.source)
    if source.is_dir() or source.suffix in ('.mcap', '.db3'):
        with open_bag(source) as bag:
            suite = recorded_sensors(bag)
    else:
        scenario = load_scenario(args.source)
        suite = described_sensors(scenario.rover, scenario.render_node.camera,
                                  scenario.physics_node.imu, scenario.render_node.frame_rate_hz,
                                  scenario.physics_node.state_rate_hz)
    text = settings(suite, args.sensor, args.legacy, args.features)
    try:
        with args.output.open('x', encoding='ascii') as file:
            file.write(text)
    except FileExistsError:
        raise ConfigError(f'{args.output}: exists already and is not overwritten') from None
    except OSError as error:
        raise ConfigError(f'{args.output}: cannot be written: {error.strerror}') from None
    print(args.output)
    return 0
