"""Gait: shaping, phases, controller, calibration."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
from references.cases import reference
from references.words import said

from lunar_rover_sim.gait.calibration import GaitCalibration, packaged_calibration
from lunar_rover_sim.gait.conditions import differences, ground_conditions, rover_conditions
from lunar_rover_sim.gait.config import GAIT_ARRAYS, GaitConfig
from lunar_rover_sim.gait.controller import GaitController
from lunar_rover_sim.gait.phases import LegPhases
from lunar_rover_sim.gait.shaping import ShapingFunction
from lunar_rover_sim.gait.stride import STAND, Stride
from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.regolith.config import GroundConfig
from lunar_rover_sim.rover.description import Legs, RoverDescription


@reference
def shaping_functions() -> dict[str, Any]:
    """Angles, slopes and their inverse, for smooth and abrupt stances and flights."""
    phase = np.linspace(-1.3, 1.4, 109)
    found = {}
    for values in ((0.6, 1.05, 0.05, 1.0), (0.3, 0.5, 1.0, 0.0), (0.75, 1.9, 0.0, 0.4),
                   (0.5, 1.0, 0.6, 0.7), (0.1, 2.0, 1.0, 1.0), (0.9, 0.1, 0.3, 1.0)):
        shaping = ShapingFunction(*values)
        found[str(values)] = {'angle': shaping.angle(phase), 'slope': shaping.slope(phase),
                              'phase': shaping.phase(np.linspace(-3.0, 3.3, 11))}
    found['four spokes'] = ShapingFunction(0.55, 0.7, 0.2, 0.9, math.pi / 2.0).angle(phase)
    return found


@reference
def strides() -> dict[str, Any]:
    """Strides from straight on to on the spot, to both sides."""
    made = [Stride.turning(1.3, turn) for turn in np.linspace(-1.0, 1.0, 41).tolist()]
    return {'forward': np.array([dataclasses.astuple(one) for one in made]),
            'backward': np.array([dataclasses.astuple(one.reversed()) for one in made]),
            'stands': [STAND.stands, made[0].stands]}


@reference
def phases() -> dict[str, Any]:
    """Phases of the legs at each gait array: start, walk, turn, reverse, stand."""
    found = {}
    orders = [(Stride(1.2), 70), (Stride.turning(1.8, 0.8), 60), (Stride.turning(1.1, -1.0), 40),
              (Stride(1.5).reversed(), 50), (STAND, 60), (Stride(0.4), 30)]
    for name in (*GAIT_ARRAYS, 'custom'):
        config = GaitConfig(gait=name, phase_offsets=(0.1, 0.85, 0.3, 0.62))
        legs, rows = LegPhases(), []
        legs.start([0.3, -0.4, 0.12, 2.7])
        for stride, count in orders:
            for _ in range(count):
                legs.advance(0.02, config, stride)
                rows.append([*legs.phase, *legs.rate])
        found[name] = np.array(rows)
    return found


class _Motors:
    """Legs that follow their commands with a lag; one may be held."""

    def __init__(self) -> None:
        self.angle, self.velocity = np.array([0.2, -0.3, 1.4, -4.0]), np.zeros(4)

    def follow(self, command: np.ndarray, dt: float, held: bool) -> None:
        self.velocity += 0.3 * (command - self.velocity)
        if held:
            self.velocity[2] = 0.0
        self.angle = self.angle + dt * self.velocity


def _walk(controller: GaitController, changes: dict[int, Any]) -> dict[str, Any]:
    motors, rows, facts = _Motors(), [], []
    for k in range(300):
        stamp = 7 * 10**9 + k * 10_000_000
        change = changes.get(k)
        if isinstance(change, GaitConfig):
            controller.configure(change)
        elif isinstance(change, Stride):
            controller.set_stride(change, stamp)
        elif change is not None:
            controller.set_velocity(*change[:2], stamp if len(change) > 2 else None)
        command = controller.update(stamp, motors.angle, motors.velocity)
        rows.append([*command.velocity_radps, *command.angle_rad, *command.phase])
        motors.follow(command.velocity_radps, 0.01, 130 < k < 190)
        if k % 60 == 20:
            facts.append(f'{controller.saturated} {controller.stride.stands}')
    return {'commands': np.array(rows), 'facts': facts, 'reports': controller.take_reports()}


@reference
def controllers() -> dict[str, Any]:
    """Commands to the legs: start, curves, a held leg, other parameters, time-out, stand."""
    found = {}
    for name in GAIT_ARRAYS:
        config = GaitConfig(gait=name)
        other = dataclasses.replace(config, duty_factor=0.7, foot_width_deg=45.0,
                                    stance_smoothing=0.3, velocity_gain=0.4, position_gain=6.0)
        found[name] = _walk(GaitController(config), {
            5: (0.1, 0.0), 60: (0.08, 0.25), 120: (-0.05, 0.1), 170: (0.3, -0.9), 200: other,
            230: (0.06, 0.0, True)})
    found['stride'] = _walk(GaitController(GaitConfig(cmd_timeout_s=0.7, blend_time_s=0.3)), {
        3: Stride.turning(1.4, 0.6), 65: Stride.turning(2.0, -0.9), 140: (0.0, 0.2),
        200: (0.0, 0.0), 240: (1e-5, 0.0)})
    return found


@reference
def calibrations(folder: Path) -> dict[str, Any]:
    """From velocities to strides and back, of the analytic map and of the measured ones."""
    found: dict[str, Any] = {'names': [packaged_calibration(name) for name in (
        'rigid', 'highland', 'highland_loose', 'mare')]}
    maps = {'analytic': GaitCalibration.default(),
            **{name: GaitCalibration.of(GaitConfig(), name) for name in (
                'rigid', 'highland', 'highland_loose')}}
    other = GaitConfig(duty_factor=0.7, foot_width_deg=45.0, max_phase_rate_hz=1.3,
                       max_yaw_rate_radps=0.4)
    for name, calibration in maps.items():
        rows = []
        for config in (None, other):
            for v in (-0.3, -0.05, 0.0, 1.5e-4, 0.02, 0.11, 0.4):
                for w in (-0.8, -0.1, 0.0, 7e-4, 0.05, 0.5):
                    stride, scale = calibration.stride(v, w, config)
                    rows.append([*dataclasses.astuple(stride), scale])
        found[name] = {'strides': np.array(rows), 'velocities': np.array(
            [calibration.velocity(rate, turn, config) for config in (None, other)
             for rate in (0.2, 0.9, 1.7, 2.4)
             for turn in (-1.0, -0.5, 0.0, 0.15, 0.45, 0.8, 1.0)])}
    dented = GaitCalibration(
        (0.5, 1.0, 2.0), (0.0, 0.3, 0.7, 1.0),
        ((0.05, 0.045, 0.03, 0.001), (0.1, 0.11, 0.05, -0.004), (0.19, 0.15, 0.1, 0.0)),
        ((0.0, 0.12, 0.1, 0.3), (-0.01, 0.2, 0.4, 0.5), (0.0, 0.3, 0.6, 0.9)), 0.55, 50.0)
    dented.save(folder / 'table.yaml')
    found['saved'] = (folder / 'table.yaml').read_text()
    again = GaitCalibration.load(folder / 'table.yaml')
    found['dented'] = np.array([[*dataclasses.astuple(again.stride(v, w)[0])]
                                for v in (0.02, 0.07, 0.15) for w in (-0.3, 0.0, 0.1, 0.5)])
    return found


@reference
def conditions() -> dict[str, Any]:
    """What a table is measured with, and what of it differs here."""
    rover = RoverDescription(legs=Legs(spokes=4, spoke_length_m=0.09))
    soft = PhysicsConfig(ground=GroundConfig(model='regolith', preset='mare'), gravity_mps2=3.7)
    here = {**rover_conditions(RoverDescription()), **ground_conditions(PhysicsConfig())}
    there = {**rover_conditions(rover), **ground_conditions(soft)}
    close = {**here, 'stiffness_npm': 2018.0, 'gravity_mps2': 1.64}
    return {'here': here, 'there': there, 'differ': differences(there, here),
            'differ back': differences(here, there), 'close': differences(close, here),
            'old': differences({'gravity_mps2': 1.62}, there), 'nothing': differences({}, here)}


@reference
def refused_gaits(folder: Path) -> dict[str, Any]:
    """Gaits and tables that are refused, and those that just are not."""
    gaits: list[dict[str, Any]] = [
        {'spokes': 1}, {'spokes': 2}, {'foot_width_deg': 120.0}, {'foot_width_deg': 119.9},
        {'spokes': 12, 'foot_width_deg': 30.0}, {'stance_smoothing': 0.0, 'flight_smoothing': 0.0},
        {'stance_smoothing': 0.0}, {'phase_offsets': (0.0, 0.5, 1.0, 0.0)},
        {'phase_offsets': (0.0, 0.5, 0.999, 0.0)}]
    shapes = [(0.0, 1.0, 0.5, 0.5), (1.0, 1.0, 0.5, 0.5), (0.5, 0.0, 0.5, 0.5),
              (0.5, 2.1, 0.5, 0.5),
              (0.5, 1.0, -0.1, 0.5), (0.5, 1.0, 0.5, 1.1), (0.5, 1.0, 1.0, 0.0)]
    good = {'phase_rates_hz': (1.0, 2.0), 'turns': (0.0, 0.5, 1.0),
            'forward_mps': ((0.1, 0.05, 0.0), (0.2, 0.1, 0.0)),
            'yaw_rate_radps': ((0.0, 0.1, 0.2), (0.0, 0.2, 0.4))}
    tables: list[dict[str, Any]] = [
        {}, {'phase_rates_hz': (0.0, 1.0)}, {'phase_rates_hz': (1.0, 1.0)},
        {'phase_rates_hz': (1.0, 50.0)}, {'phase_rates_hz': (1.0, 50.1)},
        {'turns': (0.1, 0.5, 1.0)}, {'turns': (0.0, 0.5, 0.9)}, {'turns': (0.0, 0.0, 1.0)},
        {'turns': (0.0, math.nan, 1.0)}, {'duty_factor': 1.0}, {'duty_factor': 0.0},
        {'foot_width_deg': 180.0}, {'foot_width_deg': 0.0}, {'duty_factor': 'x'},
        {'conditions': 3},
        {'forward_mps': ((0.0, 0.0, 0.0), (0.2, 0.1, 0.0))},
        {'yaw_rate_radps': ((0.0, 0.1, 0.0), (0.0, 0.2, 0.4))},
        {'yaw_rate_radps': ((0.0, 0.1, 0.2), (0.0, 0.2, 0.18))},
        {'yaw_rate_radps': ((0.0, 0.1, 0.2), (0.0, 0.2, 0.179))},
        {'forward_mps': ((0.1, 0.05, -0.02), (0.2, 0.1, 0.0))},
        {'forward_mps': ((0.1, 0.05, -0.0201), (0.2, 0.1, 0.0))},
        {'forward_mps': ((0.1, 0.05, 0.0), (10.0, 0.1, 0.0))},
        {'forward_mps': ((0.1, 0.05, 0.0), (10.1, 0.1, 0.0))},
        {'yaw_rate_radps': ((0.0, 0.1, 0.2), (0.0, 0.2, 50.1))},
        {'forward_mps': ((0.1, 0.05), (0.2, 0.1))}, {'forward_mps': ((0.1, math.nan, 0.0),) * 2}]
    files = []
    for k, text in enumerate(('[]', 'a: 1', 'turns: [0, 1]', 'turns: [a]\nphase_rates_hz: [1]\n'
                              'forward_mps: [[1]]\nyaw_rate_radps: [[1]]')):
        (folder / f'{k}.yaml').write_text(text)
        files.append(said(GaitCalibration.load, folder / f'{k}.yaml', without=folder))
    controller = GaitController()
    controller.update(5, [0.0] * 4, [0.0] * 4)
    return {'gaits': [said(GaitConfig, **values) for values in gaits],
            'shapes': [said(ShapingFunction, *values) for values in shapes],
            'tables': [said(GaitCalibration, **{**good, **values}) for values in tables],
            'files': files, 'rover': [said(GaitConfig(spokes=n).for_rover, RoverDescription())
                                      for n in (0, 3, 4)],
            'velocity': [said(controller.set_velocity, *pair) for pair in (
                (math.inf, 0.0), (0.0, math.nan), (0.1, 0.0))],
            'joints': [said(controller.update, 6, *pair) for pair in (
                ([0.0] * 3, [0.0] * 4), ([0.0] * 4, [math.nan] * 4), (['a'] * 4, [0.0] * 4))],
            'running': said(controller.configure, GaitConfig(spokes=4))}
