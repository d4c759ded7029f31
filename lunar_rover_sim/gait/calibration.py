"""The map from a commanded velocity to the stride that makes it."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import yaml

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.gait.stride import STAND, Stride


@dataclasses.dataclass(frozen=True)
class GaitCalibration:
    """Analytic map: feet that stand still on the ground, and a track wider than the real one."""

    advance_m: float = 0.14
    half_track_m: float = 0.2
    max_rate_hz: float = 2.5

    @classmethod
    def default(cls) -> GaitCalibration:
        """Return the analytic map for the default rover."""
        return cls()

    @classmethod
    def load(cls, path: str | Path | None) -> GaitCalibration:
        """Read a table; None gives the analytic default. Raises ConfigError."""
        if path is None:
            return cls.default()
        try:
            return cls(**yaml.safe_load(Path(path).read_text()))
        except (OSError, TypeError, yaml.YAMLError) as error:
            raise ConfigError(f'calibration: {path} cannot be read: {error}') from None

    def save(self, path: str | Path) -> None:
        """Write the table."""
        Path(path).write_text(yaml.safe_dump(dataclasses.asdict(self)))

    def stride(self, forward_mps: float, yaw_rate_radps: float) -> tuple[Stride, float]:
        """Return the stride for a velocity, and the factor (<= 1) by which it was scaled."""
        left = forward_mps - yaw_rate_radps * self.half_track_m
        right = forward_mps + yaw_rate_radps * self.half_track_m
        top = max(abs(left), abs(right))
        if top < 1e-4:
            return STAND, 1.0
        rate = top / self.advance_m
        scale = min(1.0, self.max_rate_hz / rate)
        return Stride(rate * scale, 0.0, left / top, right / top), scale


def _sign(value: float) -> float:
    return math.copysign(1.0, value)
