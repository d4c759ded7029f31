"""The script for a live rover in Isaac Sim, on stand-ins of its modules and a real stage."""

from pathlib import Path
import runpy
import sys
from types import ModuleType
from typing import Any
from unittest.mock import MagicMock

import pytest
from snippets import ROOT

Usd = pytest.importorskip('pxr.Usd')

from pxr import UsdPhysics  # noqa: E402

from lunar_rover_sim.products.usd.conventions import new_stage  # noqa: E402
from lunar_rover_sim.products.usd.rover_stage import write_rover  # noqa: E402
from lunar_rover_sim.rover.description import RoverDescription  # noqa: E402


def test_the_live_rover_has_no_physics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its links are where the bridge expects them, and nothing but the bridge moves them."""
    rover = write_rover(RoverDescription(), tmp_path / 'rover.usd')
    site = tmp_path / 'site.usda'
    new_stage(site, 'World')[0].Save()
    opened: list[Any] = []
    modules = {name: MagicMock(spec=ModuleType) for name in (
        'isaacsim', 'carb', 'carb.settings', 'isaacsim.core', 'isaacsim.core.utils',
        'isaacsim.core.utils.extensions', 'omni', 'omni.timeline', 'omni.usd')}
    modules['isaacsim'].SimulationApp = lambda config: app
    app = MagicMock(is_running=lambda: False)
    modules['omni'].usd, modules['omni'].timeline = modules['omni.usd'], modules['omni.timeline']
    modules['carb'].settings = modules['carb.settings']
    context = MagicMock()
    context.open_stage = lambda path: opened.append(Usd.Stage.Open(path))
    context.get_stage = lambda: opened[0]
    modules['omni.usd'].get_context = lambda: context
    modules['omni.timeline'].get_timeline_interface = MagicMock()
    modules['carb.settings'].get_settings = MagicMock()
    modules['isaacsim.core.utils.extensions'].enable_extension = MagicMock()
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(sys, 'argv', ['isaac_sim_live.py', str(site), str(rover)])
    runpy.run_path(str(ROOT / 'docs' / 'isaac_sim_live.py'))
    stage = opened[0]
    for link in ('base_link', 'front_left', 'front_right', 'rear_left', 'rear_right'):
        body = UsdPhysics.RigidBodyAPI(stage.GetPrimAtPath(f'/World/Rover/{link}'))
        assert body and not body.GetRigidBodyEnabledAttr().Get()
    assert stage.GetPrimAtPath('/World/Rover/base_link/left_camera')
    assert not stage.GetPrimAtPath('/World/Rover/joints').IsActive()
    assert not stage.GetPrimAtPath('/World/Rover').HasAPI(UsdPhysics.ArticulationRootAPI)
    assert 'Rover' not in site.read_text()
