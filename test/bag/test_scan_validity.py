"""Scans and clouds of a LiDAR: what is accepted, and what is said of the others."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from lunar_rover_sim.bag.message_validity import laser_scan_problem, lidar_cloud_problem


def scan(count=5, **values):
    """Return a scan of 5 ranges from -20 to 20 deg."""
    message = {'angle_min': math.radians(-20.0), 'angle_max': math.radians(20.0),
               'angle_increment': math.radians(10.0), 'range_max': 30.0,
               'ranges': np.full(count, 2.0, np.float32)}
    return SimpleNamespace(**{**message, **values})


@pytest.mark.parametrize('ranges', [
    [2.0] * 5, [np.inf, 2.0, np.inf, 30.0, 0.1], [30.002] * 5])
def test_a_scan_of_as_many_ranges_as_angles_is_valid(ranges):
    """Where nothing returns the range is inf; a float32 may round beyond the greatest one."""
    assert laser_scan_problem(scan(ranges=np.array(ranges, np.float32))) == ''


@pytest.mark.parametrize('message, said', [
    (scan(4), '4 ranges for 5.00 angles'), (scan(6), '6 ranges for 5.00 angles'),
    (scan(angle_max=math.radians(19.0)), '5 ranges for 4.90 angles'),
    (scan(angle_increment=0.0), '5 ranges for nan angles'),
    (scan(ranges=np.array([1.0, np.nan, 2.0, np.nan, 3.0])), '2 ranges are NaN; valid is inf'),
    (scan(ranges=np.array([1.0, 30.1, 2.0, 31.0, np.inf])), '2 ranges beyond range_max')])
def test_a_wrong_scan_is_named(message, said):
    assert laser_scan_problem(message).startswith(said)


LAYOUT = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '<f4'),
                   ('ring', '<u2'), ('time', '<f4')])
DATATYPES = {'<f4': 7, '<u2': 4}


def cloud(points, layout=LAYOUT, **values):
    """Return a cloud of one row."""
    fields = [SimpleNamespace(name=name, offset=layout.fields[name][1],
                              datatype=DATATYPES[layout.fields[name][0].str])
              for name in layout.names]
    message = {'fields': fields, 'point_step': layout.itemsize, 'width': len(points), 'height': 1,
               'row_step': layout.itemsize * len(points), 'is_dense': True,
               'is_bigendian': False, 'data': np.frombuffer(points.tobytes(), np.uint8)}
    return SimpleNamespace(**{**message, **values})


def three():
    points = np.zeros(3, LAYOUT)
    points['x'], points['ring'], points['time'] = [1.0, 2.0, 3.0], [0, 7, 15], [0.0, 0.01, 0.02]
    return points


def test_clouds_with_the_fields_of_a_lidar_are_valid():
    assert lidar_cloud_problem(cloud(three())) == ''
    assert lidar_cloud_problem(cloud(np.zeros(0, LAYOUT))) == ''
    unknown = three()
    unknown['y'][1] = np.nan
    assert lidar_cloud_problem(cloud(unknown, is_dense=False)) == ''
    rows = cloud(np.zeros(6, LAYOUT), width=3, height=2, row_step=3 * LAYOUT.itemsize)
    assert lidar_cloud_problem(rows) == ''


def test_a_wrong_cloud_is_named():
    short = np.dtype([item for item in LAYOUT.descr if item[0] not in ('ring', 'time')])
    assert lidar_cloud_problem(cloud(np.zeros(2, short), short)) == 'fields ring, time are missing'
    odd = cloud(three())
    odd.fields[1].datatype = 1
    assert lidar_cloud_problem(odd) == 'fields y are missing'
    size = LAYOUT.itemsize
    for wrong in ({'width': 4}, {'row_step': size}, {'height': 2}):
        assert lidar_cloud_problem(cloud(three(), **wrong)).startswith(
            f'data holds {3 * size} bytes, not ')
    assert lidar_cloud_problem(cloud(three(), point_step=size - 1)) == (
        f'fields end at {size} of {size - 1} bytes')
    assert lidar_cloud_problem(cloud(three(), is_bigendian=True)).startswith('data are big-endian')
    for axis in 'xyz':
        unknown = three()
        unknown[axis][[0, 2]] = np.inf, np.nan
        assert lidar_cloud_problem(cloud(unknown)) == '2 points are not finite in a dense cloud'
    early = three()
    early['time'][1] = -0.5
    assert lidar_cloud_problem(cloud(early)) == 'time is -0.5 s'
    early['time'][1] = np.nan
    assert lidar_cloud_problem(cloud(early)).startswith('time is nan')
