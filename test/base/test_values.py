"""Times as text, and reasons as one line."""

import pytest

from lunar_rover_sim.base.errors import one_line
from lunar_rover_sim.base.seconds import from_seconds, in_seconds, NS_PER_S


def test_reasons_are_one_line() -> None:
    """An error without words gives the name of its class."""
    assert one_line('a\n  b\tc ') == 'a b c'
    assert one_line(ValueError('not\nthis')) == 'not this'
    assert one_line(KeyError()) == 'KeyError' and one_line('') == ''


@pytest.mark.parametrize('time_ns', [
    0, 1, -1, NS_PER_S, -1_500_000_000, 1_700_000_000_123_456_789, -(1 << 62)])
def test_text_reads_back_exactly(time_ns: int) -> None:
    """Also what a float does not hold."""
    assert from_seconds(in_seconds(time_ns)) == time_ns


@pytest.mark.parametrize('text, time_ns', [
    ('2', 2 * NS_PER_S), ('.5', NS_PER_S // 2), ('+1.25', 1_250_000_000), ('-0.5', -NS_PER_S // 2),
    ('1.0000000019', NS_PER_S + 1), ('1.5e3', 1500 * NS_PER_S)])
def test_spellings(text: str, time_ns: int) -> None:
    """Signs, missing digits, more than nine decimals, exponents."""
    assert from_seconds(text) == time_ns


@pytest.mark.parametrize('text', ['', '.', 'x', 'nan', 'inf', '1.2.3'])
def test_what_is_no_time(text: str) -> None:
    """Readers of files name the line."""
    with pytest.raises((ValueError, OverflowError)):
        from_seconds(text)
