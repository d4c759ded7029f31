"""How long work will go on: right or not told."""

from __future__ import annotations

from lunar_rover_sim.cli.terminal import Pace


def left_s(steps: list[tuple[float, float]], now_s: float, total: float) -> float | None:
    """Return what is left [s] after steps of time [s] and work."""
    pace = Pace()
    for step in steps:
        pace.step(*step)
    return pace.left_s(now_s, total)


def test_even_steps() -> None:
    """The first step, whatever came before it, does not count."""
    steps = [(50.0 + 2.0 * k, k + 1.0) for k in range(4)]
    assert left_s(steps, 56.0, 10.0) == 12.0
    assert left_s(steps[:2], 52.0, 10.0) is None


def test_first_light() -> None:
    """Steps of a run on two cores: nothing is told while the first light is computed."""
    before = [(75.1, 0.05), (76.6, 0.10)]
    assert left_s(before, 100.0, 4.0) is None
    after = [(179.8, 0.15)]
    assert left_s(before + after, 185.0, 4.0) is None
    frames = [(180.0 + k, 0.15 + 0.05 * k) for k in range(1, 78)]
    for k in range(5, 77):
        told = left_s(before + after + frames[:k], frames[k - 1][0], 4.0)
        assert told is not None
        assert 0.9 < (told + 1.0) / (77 - k + 1.0) < 1.1


def test_one_step_before_the_first_light() -> None:
    """The pause may be the first thing after the first step."""
    steps = [(0.0, 0.1), (103.0, 0.15), (104.0, 0.20), (105.0, 0.25), (106.0, 0.30)]
    told = left_s(steps, 106.0, 1.3)
    assert told is not None
    assert 18.0 < told < 22.0


def test_stalled() -> None:
    """Work that stands for longer than it went tells nothing; a repeated count is no step."""
    steps = [(float(k), float(k)) for k in range(1, 6)] + [(9.0, 5.0)]
    assert left_s(steps, 8.0, 10.0) is not None
    assert left_s(steps, 9.5, 10.0) is None
