"""Returns of a beam: reflectance, drop-out, noise, limits of the range."""

import dataclasses

import numpy as np

from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.lidar.optics import LidarConfig, VLP16
from lunar_rover_sim.image.lidar.ray_caster import GROUND, RayHits
from lunar_rover_sim.image.lidar.returns import ReturnModel


def measured(config, distance_m, cosine=1.0, albedo=1.0, rock=False, seed=1):
    """Return what is measured of targets at distances and incidences, of albedo factors."""
    distance, cosine, albedo = np.broadcast_arrays(np.asarray(distance_m, float), cosine, albedo)
    count = len(distance)
    normal = np.stack([np.sqrt(1.0 - cosine ** 2), np.zeros(count), cosine], axis=-1)
    target = np.arange(count) if rock else np.full(count, GROUND)
    # Each beam falls on a sample of its own, or on a rock of its own.
    side = int(np.ceil(np.sqrt(count)))
    ground = np.full(side * side, 9.0, np.float32)
    if not rock:
        ground[:count] = albedo
    iy, ix = np.divmod(np.arange(count), side)
    place = np.stack([ix, iy, np.zeros(count)], axis=-1) - 0.5 * (side - 1) + 0.3
    model = ReturnModel(config, ground.reshape(side, side), 1.0, albedo.astype(np.float32))
    return model.measure(place, np.tile([0.0, 0.0, -1.0], (count, 1)),
                         RayHits(distance.copy(), target.astype(np.int32), normal),
                         np.random.default_rng(seed))


def test_reflectance_is_that_of_hapke_at_phase_0():
    config = LidarConfig(laser_albedo=1.2, noise=False)
    cosine = np.array([1.0, 0.8, 0.3, 0.05])
    for albedo in (0.6, 1.0, 1.7):
        for rock, name in ((False, 'highland'), (True, 'rock')):
            found = measured(config, np.full(4, 5.0), cosine, albedo, rock).intensity / 100.0
            law = np.pi * hapke.reflectance(cosine, cosine, 1.0, hapke.parameter_set(name),
                                            albedo=1.2 * albedo)
            # The table has steps of 0.03 of albedo.
            assert np.allclose(found, law, rtol=0.03)
    # The opposition surge is in it: without it the ground returns much less.
    bare = dataclasses.replace(hapke.parameter_set('highland'), b_s0=0.0)
    law = np.pi * hapke.reflectance(1.0, 1.0, 1.0, bare, albedo=1.2)
    assert measured(config, [5.0]).intensity[0] > 150.0 * law


def test_albedo_is_that_of_the_nearest_sample():
    """Three beams onto samples with an albedo of their own, and one beyond the ground: 1."""
    ground = np.ones((3, 3), np.float32)
    ground[1, 2], ground[2, 1], ground[0, 0] = 0.5, 1.5, 2.0
    model = ReturnModel(LidarConfig(noise=False), ground, 0.5, np.ones(0, np.float32))
    # They go 0.4 m along x while they go down: where they end counts.
    origin = np.array([[0.1, 0.1, 1.0], [-0.4, 0.4, 1.0], [-0.9, -0.6, 1.0], [0.5, 0.0, 1.0]])
    hits = RayHits(np.full(4, 1.077), np.full(4, GROUND, np.int32),
                   np.tile([0.0, 0.0, 1.0], (4, 1)))
    found = model.measure(origin, np.tile([0.3714, 0.0, -0.9285], (4, 1)), hits,
                          np.random.default_rng(0)).intensity
    alone = measured(LidarConfig(noise=False), np.full(4, 1.077), 0.9285, [0.5, 1.5, 2.0, 1.0])
    assert np.array_equal(found, alone.intensity)


def of_reference(distance_m, count=20_000, **changes):
    """Return what is measured of targets with the reflectance of the reference."""
    optics = dataclasses.replace(VLP16, resolution_m=0.0, max_range_m=1000.0, **changes)
    # Such an albedo factor that ground at right angles has the reference's reflectance.
    albedo = np.linspace(0.1, 3.9, 400)
    quiet = LidarConfig(part='own', own=optics, noise=False)
    factor = measured(quiet, np.full(400, 5.0), albedo=albedo).intensity / 100.0
    nearest = np.abs(factor - optics.reference_reflectance).argmin()
    # The range at which it returns as much as the reference does.
    scale = np.sqrt(float(factor[nearest]) / optics.reference_reflectance)
    return measured(dataclasses.replace(quiet, noise=True), np.full(count, distance_m * scale),
                    albedo=albedo[nearest], seed=5), distance_m * scale


def test_drop_out_and_noise_follow_the_signal():
    optics = {'reference_reflectance': 0.2, 'reference_range_m': 50.0}
    for share, least, most in ((0.5, 1.0, 1.0), (1.0, 0.893, 0.907), (1.4, 0.0, 0.02)):
        returns, _ = of_reference(50.0 * share, **optics)
        seen = np.isfinite(returns.range_m).mean()
        # 90 % +- 3.3 standard deviations of a share of 20,000.
        assert least <= seen <= most
    for share in (0.2, 1.0):
        returns, distance = of_reference(50.0 * share, **optics)
        found = returns.range_m[np.isfinite(returns.range_m)]
        weak2 = VLP16.limit_noise_m ** 2 - VLP16.noise_m ** 2
        deviation = np.sqrt(VLP16.noise_m ** 2 + weak2 * share ** 4)
        # Of n samples a deviation is known to 1 / sqrt(2 n).
        assert np.isclose(found.std(), deviation, rtol=3.3 / np.sqrt(2 * len(found)) + 0.005)
        assert abs(found.mean() - distance) < 3.3 * deviation / np.sqrt(len(found)) + 1e-5


def test_range_limits_and_resolution():
    found = measured(LidarConfig(), [0.2, 0.6, 5.0, 99.0, np.inf], albedo=3.9).range_m
    assert list(np.isfinite(found)) == [False, True, True, True, False]
    steps = found[1:3].astype(float) / 0.002
    assert np.allclose(steps, np.rint(steps), atol=1e-2)


def test_grazing_incidence_stretches_pulses():
    """At 45 m and 1 deg, 1.5 mrad spread a pulse of 0.9 m by 3.9 m; at right angles by nothing."""
    def share(cosine, distance_m):
        return np.isfinite(measured(LidarConfig(), np.full(2000, distance_m), cosine,
                                    seed=3).range_m).mean()
    assert share(1.0, 45.0) > 0.99 and share(0.0175, 45.0) < 0.01
    # Nearby the spot is small, and regolith sends light back at all incidences.
    assert share(0.0175, 5.0) > 0.99
