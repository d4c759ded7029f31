"""Isaac Sim as the picture of a running simulation: its rover follows pose_bridge_node.

    ./python.sh isaac_sim_live.py SITE.usd ROVER.usd

UNTRIED: written from the documentation of Isaac Sim 6, without an RTX card. The rover stands at
/World/Rover without physics, so that nothing but the bridge moves it; the stage plays, because
SetEntityState is served only then.
"""

from pathlib import Path
import sys

from isaacsim import SimulationApp

app = SimulationApp({'headless': False})

# Only now there is an application that these belong to.
import carb.settings  # noqa: E402
from isaacsim.core.utils.extensions import enable_extension  # noqa: E402
import omni.timeline  # noqa: E402
import omni.usd  # noqa: E402
from pxr import UsdPhysics  # noqa: E402

ROVER = '/World/Rover'

site, rover = (str(Path(name).absolute()) for name in sys.argv[1:3])
enable_extension('isaacsim.ros2.bridge')
enable_extension('isaacsim.ros2.sim_control')
carb.settings.get_settings().set('/rtx/sceneDb/ambientLightIntensity', 0.0)
omni.usd.get_context().open_stage(site)
stage = omni.usd.get_context().get_stage()
stage.SetEditTarget(stage.GetSessionLayer())      # the file stays as it is
prim = stage.DefinePrim(ROVER)
prim.GetReferences().AddReference(rover)
for link in prim.GetChildren():
    if link.HasAPI(UsdPhysics.RigidBodyAPI):
        UsdPhysics.RigidBodyAPI(link).GetRigidBodyEnabledAttr().Set(False)
# A joint needs an enabled body, an articulation a joint.
stage.GetPrimAtPath(f'{ROVER}/joints').SetActive(False)
prim.RemoveAPI(UsdPhysics.ArticulationRootAPI)
for layer in stage.GetUsedLayers():     # materials for RTX, in memory only
    path = Path(layer.realPath) if layer.realPath else Path()
    twins = path.with_name(f'{path.stem}_parts') / 'omniverse.usda' if path.name else path
    if twins.name == 'omniverse.usda' and twins.is_file():
        layer.subLayerPaths.append(str(twins))
while app.is_running() and omni.usd.get_context().get_stage_loading_status()[2] > 0:
    app.update()
omni.timeline.get_timeline_interface().play()
while app.is_running():
    app.update()
app.close()
