"""Photographs of Apollo beside pictures of ours at the same sun, height and field of view.

    python test/benchmarks/bench_photographs.py APOLLO_FOLDER OUTPUT_FOLDER

APOLLO_FOLDER holds scans by their numbers (NASA, public domain). Their borders are cut off, and
the light that the scanner added to black is taken away. Heights of the sun follow from the times
of the missions, but for Apollo 16; directions are estimates from shadows in the pictures. It
writes a pair NAME_apollo.jpg and NAME_ours.jpg of each, all of them as sheet.jpg, photographs.csv,
and prints the table. No parameter was chosen by these pictures.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.image.rendering.snapshot import settle
from lunar_rover_sim.judge.evaluation.image_statistics import GreyPair, image_statistics, MEASURES
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

FOV_DEG, HEIGHT_M = 47.7, 1.5       # 60 mm on a frame of 53 mm, at the chest
SIDE, WIDTH = 900, 450              # of our picture; of the crops that are compared [px]
GAP = 6                             # between the crops on the sheet [px]
SHOWN = ('log gradient', 'spectrum slope', 'shadow share', 'ORB keypoints')


class Photograph(NamedTuple):
    """A scan: file, height of the sun, heading from the sun, and shares of rows and columns.

    Attributes:
        horizon: Row of the horizon.
        rows: Of the crop of bare ground.
        columns: Of it.
    """

    file: str
    sun_deg: float
    heading_deg: float
    horizon: float
    rows: tuple[float, float]
    columns: tuple[float, float]


PHOTOGRAPHS = (
    Photograph('AS11-40-5961.jpg', 15.0, 170.0, 0.35, (0.42, 0.97), (0.30, 0.93)),
    Photograph('AS14-66-9301_900px.jpg', 14.5, 32.0, 0.53, (0.57, 0.90), (0.05, 0.92)),
    Photograph('AS16-113-18339_900px.jpg', 22.0, 75.0, 0.40, (0.60, 0.91), (0.06, 0.92)),
    Photograph('AS17-147-22470_900px.jpg', 15.5, 170.0, 0.43, (0.52, 0.92), (0.32, 0.92)))


def main() -> None:
    """Write pairs and table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('apollo', type=Path)
    parser.add_argument('output', type=Path)
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, str]] = []
    sheet: list[NDArray[np.uint8]] = []
    for photograph, ours in zip(PHOTOGRAPHS, _ours()):
        name = photograph.file.partition('.')[0].removesuffix('_900px')
        scan = cv2.imread(str(args.apollo / photograph.file))
        if scan is None:
            parser.error(f'{args.apollo / photograph.file}: is no picture')
        pictures = {'apollo': _crop(_without_veil(scan), photograph),
                    'ours': _crop(ours, photograph)}
        for whose, picture in pictures.items():
            if whose == 'apollo':       # film and scanner have colours of their own
                pictures[whose] = picture = cv2.cvtColor(
                    cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
            cv2.imwrite(str(args.output / f'{name}_{whose}.jpg'), picture,
                        [cv2.IMWRITE_JPEG_QUALITY, 88])
            levels = _levels(picture)       # ground alone: no pixel is without a disparity
            values = dict(zip(MEASURES, image_statistics(
                GreyPair(name, levels, None, np.ones_like(levels)), True).values))
            rows.append({'photograph': name, 'whose': whose,
                         **{key: f'{values[key]:.3g}' for key in SHOWN}})
        height = min(len(picture) for picture in pictures.values())
        sheet.append(np.hstack([np.pad(picture[:height], ((0, GAP), (0, GAP), (0, 0)))
                                for picture in pictures.values()]))
    cv2.imwrite(str(args.output / 'sheet.jpg'), np.vstack(sheet)[:-GAP, :-GAP],
                [cv2.IMWRITE_JPEG_QUALITY, 88])
    with (args.output / 'photographs.csv').open('w', newline='', encoding='ascii') as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    print('| ' + ' | '.join(rows[0]) + ' |\n' + '|---' * len(rows[0]) + '|')
    for row in rows:
        print('| ' + ' | '.join(row.values()) + ' |')


def _ours() -> list[NDArray[np.uint8]]:
    """Return our picture of each."""
    scenario = Scenario.load('mare_apollo', [
        f'render_node.camera.width={SIDE}', f'render_node.camera.height={SIDE}',
        f'render_node.camera.horizontal_fov_deg={FOV_DEG}', 'render_node.sensor.encoding=rgb8'])
    world = load_world(cached(scenario.world, scenario.shared.seed))
    azimuth, pictures = scenario.render_node.sun.azimuth_deg, []
    with scenario.renderer(world) as renderer:
        T_camera_base = np.linalg.inv(renderer.rig.T_base_left)
        for photograph in PHOTOGRAPHS:
            renderer.set_sun(azimuth, photograph.sun_deg)
            pitch = np.arctan((0.5 - photograph.horizon) * 2.0
                              * np.tan(np.radians(0.5 * FOV_DEG)))
            turn = matrix_from_wxyz(wxyz_from_rpy(
                0.0, float(pitch), np.radians(azimuth + photograph.heading_deg)))
            # The camera itself, not the base, is at the height and looks along the axis.
            ahead = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
            T_world_camera = se3(turn @ ahead, (2.0, 1.0, world.ground.height_at_point(2.0, 1.0)
                                                + HEIGHT_M))
            state = RoverPose(T_world_camera @ T_camera_base)
            settle(renderer, state)
            picture = renderer.render(state, 0, ('left',)).picture('left')
            pictures.append(np.ascontiguousarray(picture[..., ::-1]).astype(np.uint8))
    return pictures


def _without_veil(scan: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a scan without the colour of its black border."""
    border = np.concatenate([scan[:6].reshape(-1, 3), scan[-6:].reshape(-1, 3)])
    black = np.median(border, axis=0)
    return np.clip((scan - black) * (255.0 / (255.0 - black)), 0, 255).astype(np.uint8)


def _crop(picture: NDArray[np.uint8], photograph: Photograph) -> NDArray[np.uint8]:
    """Return the bare ground, at one scale, the bright tenth equally bright."""
    (top, bottom), (left, right) = ((np.array(share) * size).astype(int) for share, size in zip(
        (photograph.rows, photograph.columns), picture.shape))
    crop = picture[top:bottom, left:right]
    crop = cv2.resize(crop, (WIDTH, round(WIDTH * crop.shape[0] / crop.shape[1])),
                      interpolation=cv2.INTER_AREA)
    bright = np.percentile(crop.mean(axis=-1), 90)
    return np.clip(crop * (190.0 / bright), 0, 255).astype(np.uint8)


def _levels(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    return (picture.mean(axis=-1) / 255.0).astype(np.float32)


if __name__ == '__main__':
    main()
