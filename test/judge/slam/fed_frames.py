"""What tests give to SLAM programs: a vocabulary, and frames one after the other."""

from collections.abc import Callable, Sequence

import numpy as np
from waiting import wait_until

from lunar_rover_sim.judge.slam.program import SlamProgram
from lunar_rover_sim.judge.slam.protocol import FrameSet, TrackedPose

# A root with two words, as DBoW2 writes it.
VOCABULARY = '2 1 0 0 \n' + 2 * f'0 1 {"17 " * 32}0.69\n'
LEFT = np.arange(12, dtype=np.uint8).reshape(3, 4)


def wait(program: SlamProgram, condition: Callable[[], object]) -> None:
    """Return when the condition holds; raise what the program has done wrong."""
    wait_until(condition, meanwhile=program.check, pause_s=0.005)


def feed(program: SlamProgram, stamps_ns: range, images: Sequence[np.ndarray] = (LEFT, LEFT),
         imu: bool = False) -> list[TrackedPose]:
    """Send frames, with a sample of the IMU 1 ns before each; return the answers."""
    answers = []
    for stamp_ns in stamps_ns:
        wait(program, lambda: not program.is_busy)
        if imu:
            program.send_imu([(stamp_ns - 1, (0.1,) * 3, (1.0,) * 3)])
        program.send(FrameSet(stamp_ns, tuple(images)))
        wait(program, lambda: not program.is_busy)
        taken = program.take()
        assert taken is not None and taken[1] >= 0.0
        answers.append(taken[0])
    return answers
