"""The list of cameras: what a run knows of each entry, and when its images are due."""

import pytest

from lunar_rover_sim.camera.chase import ChaseConfig, ChaseMount
from lunar_rover_sim.camera.hazard import HazardMount
from lunar_rover_sim.run.scenario import Scenario

BACK = {'render_node.hazard.back.rate_hz': 4, 'render_node.hazard.back.stereo_baseline_m': 0.1,
        'render_node.chase.enabled': True}


def test_a_camera_at_the_back_is_an_entry_like_the_pair() -> None:
    """Two parameters make it; topics, layers, frames and periods follow."""
    scenario = Scenario.load('flat', BACK)
    pair, back, chase = scenario.render_node.cameras
    assert [entry.name for entry in (pair, back, chase)] == ['', 'hazard.back', 'chase']
    assert (pair.baseline_m, back.baseline_m, chase.baseline_m) == (None, 0.1, 0.0)
    by_name = {output.topic.name: output for output in back.outputs}
    right = by_name['ground_truth/hazard/back/right/depth/image']
    assert (right.layers, right.side, right.period_ns) == (('right_depth',), 1, 250_000_000)
    assert back.images == {'hazard_back_left': 'left', 'hazard_back_right': 'right'}
    assert chase.images == {'chase': 'left'}
    assert [child for _, child, _ in back.frames] == [
        f'hazard_back_{side}_{part}' for side in ('left', 'right')
        for part in ('link', 'optical_frame')]
    depth = next(o for o in pair.outputs if o.topic.name == 'ground_truth/depth/image')
    assert depth.period_ns == scenario.render_node.depth_period_ns == 100_000_000
    assert [o.topic.name for o in pair.outputs if o.always] == [
        'stereo/left/camera_info', 'stereo/right/camera_info']
    # Each topic is that of one camera.
    names = [o.topic.name for entry in scenario.render_node.cameras for o in entry.outputs]
    assert len(set(names)) == len(names)


def test_its_mount_and_its_noise_are_its_own() -> None:
    """The noise of a camera does not depend on which others there are."""
    pair, back, chase = Scenario.load('flat', BACK).render_node.cameras
    alone = Scenario.load('flat', {'render_node.hazard.back.rate_hz': 4}).render_node.cameras[1]
    other = Scenario.load('flat', {'render_node.hazard.front.rate_hz': 4}).render_node.cameras[1]
    seeds = [entry.noise_seed(7) for entry in (pair, back, chase, other)]
    assert len(set(seeds)) == 4 and alone.noise_seed(7) == back.noise_seed(7)
    assert back.mount is not None and chase.mount is not None and pair.mount is None
    world = None      # where the camera is fixed or follows, none is asked
    assert isinstance(back.mount(world, 0.0), HazardMount)      # type: ignore[arg-type]
    assert isinstance(chase.mount(world, 0.0), ChaseMount)      # type: ignore[arg-type]
    assert ChaseConfig().mode == 'follow'


@pytest.mark.ros
def test_an_image_is_due_in_the_first_frame_of_each_of_its_periods() -> None:
    """Frames at 20 Hz, images at 10 and 5 Hz: in lockstep after the first whole period."""
    pytest.importorskip('rclpy')
    from lunar_rover_sim.nodes.camera_publisher import Periods
    ten, five = 100_000_000, 200_000_000
    frames_ns = [50_000_000 * k for k in range(1, 9)]
    due = Periods([ten, five], lockstep=True)
    found = [due.begun(stamp) for stamp in frames_ns]
    assert [stamp for stamp, begun in zip(frames_ns, found) if ten in begun] == frames_ns[1::2]
    assert [stamp for stamp, begun in zip(frames_ns, found) if five in begun] == frames_ns[3::4]
    due.restart()
    assert due.begun(frames_ns[0]) == frozenset() and due.begun(frames_ns[1]) == {ten}
    # In real time the first frame has all; where frames are lost, the next one has them.
    live = Periods([ten, five], lockstep=False)
    assert not live.has_begun and live.begun(frames_ns[0]) == {ten, five} and live.has_begun
    assert live.begun(frames_ns[4]) == {ten, five} and live.begun(frames_ns[4]) == frozenset()
