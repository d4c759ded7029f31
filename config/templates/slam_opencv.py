"""A SLAM program in OpenCV for `run --slam`: stereo points, tracked, located by PnP."""

import cv2
import numpy as np

from lunar_rover_sim.judge.slam.client import serve


def begin(settings):
    """Return the tracker for these cameras; it gets a frame and the IMU samples before it."""
    K = np.array([[settings['fx'], 0, settings['cx']], [0, settings['fy'], settings['cy']],
                  [0, 0, 1.0]])
    T_map_camera, before, points, pixels = np.eye(4), None, None, None

    def track(frames, imu):
        nonlocal T_map_camera, before, points, pixels
        left, right = frames.images
        if before is not None and len(points) >= 6:
            now, found, _ = cv2.calcOpticalFlowPyrLK(before, left, pixels, None)
            kept = found.ravel() == 1
            ok, turn, shift, _ = cv2.solvePnPRansac(points[kept], now[kept], K, None)
            if not ok:
                return None
            T = np.eye(4)       # of the camera before in this one
            T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
            T_map_camera = T_map_camera @ np.linalg.inv(T)
        pixels = cv2.goodFeaturesToTrack(left, 500, 0.01, 8)
        there, found, _ = cv2.calcOpticalFlowPyrLK(left, right, pixels, None)
        disparity = (pixels - there)[:, 0, 0]
        kept = (found.ravel() == 1) & (disparity > 1.0) & (np.abs((pixels - there)[:, 0, 1]) < 1)
        pixels, disparity = pixels[kept], disparity[kept]
        depth = settings['fx'] * settings['baseline_m'] / disparity
        rays = np.c_[pixels[:, 0], np.ones(len(pixels))] @ np.linalg.inv(K).T
        points, before = rays * depth[:, None], left
        return T_map_camera

    return track


if __name__ == '__main__':
    serve(begin)
