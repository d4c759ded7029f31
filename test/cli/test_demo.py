"""`demo`, and what --fast sets."""

from pathlib import Path

from command_line import given
import pytest

from lunar_rover_sim.cli import main as command_line


def demo(monkeypatch: pytest.MonkeyPatch, statuses: dict[str, int],
         *words: str) -> tuple[int, list[list[str]]]:
    """Run `demo` with commands that only return a status; return its own, and their words."""
    run, steps = command_line.execute, list[list[str]]()

    def execute(step: list[str]) -> int:
        with monkeypatch.context() as real:
            real.setattr(command_line, 'execute', run)
            given(*step)        # it is a command
        steps.append(step)
        return statuses.get(step[1], 0)

    monkeypatch.setattr(command_line, 'execute', execute)
    return run(['demo', *words]), steps


def test_the_demo_is_three_commands(monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
                                    capsys: pytest.CaptureFixture[str]) -> None:
    """They take a folder that is free, and the last line says where the pictures are."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'runs' / 'demo-1').mkdir(parents=True)
    status, steps = demo(monkeypatch, {}, '--fast')
    assert status == 0
    assert [step[:2] for step in steps] == [['run', 'baseline'], ['bag', 'check'],
                                            ['bag', 'preview']]
    assert '--fast' in steps[0] and 'runs/demo-2' in steps[0]
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith('$ lunar_rover_sim run baseline --duration 5 ')
    assert ' '.join(lines).endswith(f'pictures:   {tmp_path}/runs/demo-2/preview') \
        or lines[-1] == f'pictures: {tmp_path}/runs/demo-2/preview'


def test_a_bag_that_fails_ends_the_demo(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    status, steps = demo(monkeypatch, {'check': 1}, '-o', str(tmp_path / 'new'))
    assert (status, len(steps)) == (1, 2)
