"""SVO from the wheel svo_cpp, as a command of `slam run` and `benchmark`; mono.

    python slam_svo.py SEQUENCE OUT

It reads the left images of a sequence in the format of EuRoC and writes a TUM file. svo_cpp 1.5.0
gives positions alone: the orientations in the file mean nothing. svo_cpp is GPL-3.0.
"""

from pathlib import Path
import re
import sys

import cv2
import svo_cpp

# More features in images of little contrast, and no surrender when some of them are lost. With
# its defaults SVO loses these images within seconds.
SETTINGS = {
    'max_fts': 400, 'grid_size': 20, 'triang_min_corner_score': 5.0, 'quality_min_fts': 15,
    'quality_max_drop_fts': 400, 'reproj_thresh': 10.0, 'poseoptim_thresh': 5.0, 'max_n_kfs': 30,
    'kfselect_mindist': 0.05, 'core_n_kfs': 6}


def numbers(text, name):
    """Return the numbers of a list in a sensor.yaml."""
    return [float(word) for word in re.search(name + r': \[(.*)\]', text)[1].split(',')]


def main(sequence, out):
    """Track a sequence and write the positions of the camera."""
    text = (sequence / 'mav0/cam0/sensor.yaml').read_text()
    svo_cpp.set_svo_config(SETTINGS)
    camera = svo_cpp.PinholeCamera(*numbers(text, 'resolution'), *numbers(text, 'intrinsics'))
    odometry = svo_cpp.SVO(camera)
    odometry.start()
    with out.open('w') as file:
        for stamp in (sequence / 'times.txt').read_text().split():
            image = cv2.imread(f'{sequence}/mav0/cam0/data/{stamp}.png', cv2.IMREAD_GRAYSCALE)
            odometry.addImage(image, 1e-9 * int(stamp))
            if odometry.stage() == svo_cpp.Stage.DEFAULT_FRAME:
                x, y, z = odometry.lastFrame().T_f_w.inverse().translation().ravel()
                print(f'{1e-9 * int(stamp):.9f} {x} {y} {z} 0 0 0 1', file=file)


if __name__ == '__main__':
    main(*map(Path, sys.argv[1:3]))
