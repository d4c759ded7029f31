"""Sheets of pictures: scenarios x heights of the sun x directions x near and far.

    python test/contact_sheet.py FOLDER [--scenarios baseline rough] [--width 320]

Writes FOLDER/SCENARIO.webp. Each row is an elevation of the sun. Its six pictures look towards the
sun, across and away from it, first from the rover's own cameras (near), then from 3 m above the
ground (far). Exposure follows each picture. They are what to look at after a change of the world
or of the light; those of the documentation are made by

    python test/contact_sheet.py resource/pictures/sheets
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.image.rendering.snapshot import HEIGHT_M, settle, standing
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

ELEVATIONS_DEG = (2.0, 6.0, 15.0)
DIRECTIONS = (('towards', 0.0), ('across', 90.0), ('away', 180.0))
PLACES = (('near', HEIGHT_M), ('far', 3.0))


def pictures(name: str, width: int) -> list[tuple[str, NDArray[np.generic]]]:
    """Return titles and pictures of one scenario, row by row of the sheet."""
    scenario = Scenario.load(name, [f'render_node.camera.width={width}',
                                    f'render_node.camera.height={width * 3 // 4}',
                                    'render_node.sensor.exposure_mode=auto'])
    world = load_world(cached(scenario.world, scenario.shared.seed))
    azimuth = scenario.render_node.sun.azimuth_deg
    shown = []
    with scenario.renderer(world) as renderer:
        for elevation in ELEVATIONS_DEG:
            renderer.set_sun(azimuth, elevation)
            for place, height in PLACES:
                for direction, turn in DIRECTIONS:
                    state = RoverPose(standing(world, 0.0, 0.0, azimuth + turn, height),
                                      np.zeros(4))
                    settle(renderer, state)
                    left = renderer.render(state, 0, ('left',)).left
                    assert left is not None
                    shown.append((f'{elevation:g} deg, {direction}, {place}', left))
    return shown


def sheet(shown: list[tuple[str, NDArray[np.generic]]]) -> NDArray[np.uint8]:
    """Return all pictures in rows of six, each with its title."""
    tiles = []
    for title, picture in shown:
        tile = np.array(picture, np.uint8)
        cv2.putText(tile, title, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.32, 255, 1, cv2.LINE_AA)
        tiles.append(np.pad(tile, 1, constant_values=128))
    across = len(PLACES) * len(DIRECTIONS)
    return np.concatenate([np.concatenate(tiles[k:k + across], axis=1)
                           for k in range(0, len(tiles), across)])


def main() -> None:
    """Draw the sheets."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('output', type=Path)
    parser.add_argument('--scenarios', nargs='+', default=['baseline'], metavar='NAME')
    parser.add_argument('--width', type=int, default=320, help='of each picture [px]')
    parser.add_argument('--quality', type=int, default=60, help='of the compression, to 100')
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    for name in args.scenarios:
        cv2.imwrite(str(args.output / f'{name}.webp'), sheet(pictures(name, args.width)),
                    [cv2.IMWRITE_WEBP_QUALITY, args.quality])


if __name__ == '__main__':
    main()
