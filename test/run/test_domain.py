"""ROS domains: numbers that are one, and one run in each."""

from __future__ import annotations

from typing import Any

import pytest

from lunar_rover_sim.errors import ConfigError, GraphError
from lunar_rover_sim.run.ros_domain import OwnDomain


@pytest.mark.parametrize('domain', [-1, 233, 10**9, '7', 1.5])
def test_numbers_that_are_no_domain(domain: Any) -> None:
    """Their ports would not exist; rclpy takes a negative one for domain 0 without a word."""
    with pytest.raises(ConfigError, match=f'--domain {domain!r}: is not valid; valid is 0 to 23'):
        OwnDomain(domain)


def test_a_domain_is_given_once() -> None:
    """Named or chosen, and again when it was given back."""
    with OwnDomain() as first, OwnDomain() as second:
        assert first.id != second.id
        with pytest.raises(GraphError, match=f'--domain {first.id}: another run is using it'):
            OwnDomain(first.id)
    with OwnDomain(first.id) as again:
        assert again.id == first.id
