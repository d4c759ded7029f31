"""MuJoCo's warnings, and the diagnosis of a simulation that has diverged.

By default MuJoCo writes its warnings to the terminal and to a file MUJOCO_LOG.TXT in the working
directory. Here they go to the log, and the newest are kept for the error message.
"""

from __future__ import annotations

import collections
import logging
import re

import mujoco
import numpy as np

from lunar_rover_sim.errors import one_line

logger = logging.getLogger(__name__)

_texts: collections.deque[str] = collections.deque(maxlen=16)


def catch_warnings() -> None:
    """Send MuJoCo's warnings to the log, unless a handler is set already, and forget old ones."""
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_take)
    _texts.clear()


def diagnosis(model: mujoco.MjModel, data: mujoco.MjData, time_s: float) -> str:
    """Return one line that names the time and the body at which a simulation diverged.

    They are those of MuJoCo's first warning; without a warning, the body is the fastest one.
    """
    text = _texts[0] if _texts else ''
    found = re.search(r'DOF (\d+).*Time = (\d+\.\d+)', text)
    speed = np.abs(np.nan_to_num(data.qvel, nan=np.inf))
    if found:
        dof, time_s = int(found.group(1)), float(found.group(2))
    else:
        dof = int(np.argmax(speed))
    body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY,
                             int(model.dof_bodyid[min(dof, model.nv - 1)]))
    reason = f'; MuJoCo: {text}' if text else f' (speed {speed.max():.3g})'
    return (f'the simulation diverged at {time_s:.3f} s in body {body}{reason}; use a shorter'
            ' step_s or a softer contact')


def _take(text: str) -> None:
    line = one_line(text)
    _texts.append(line)
    logger.debug('MuJoCo: %s', line)
