"""Stereo frames of an exported drive, drawn by Isaac Sim, in the layout of our EuRoC export.

    ./python.sh isaac_sim.py DRIVE.usd FOLDER [path-tracing]

UNTRIED: written from the documentation of Isaac Sim 5 and Replicator, without an RTX card. It
draws linear radiance (annotator HdrColor), so that no tone mapping or automatic exposure takes
part, and gives all frames one exposure. Images are mono8, the root of the signal, as ours are.
"""

from pathlib import Path
import sys

from isaacsim import SimulationApp

app = SimulationApp({'headless': True})

# Only now there is an application that these belong to.
import carb.settings  # noqa: E402
import numpy as np  # noqa: E402
import omni.replicator.core as rep  # noqa: E402
import omni.timeline  # noqa: E402
import omni.usd  # noqa: E402
from PIL import Image  # noqa: E402

LEVEL = 0.40        # mean of the lit ground in the first frame, of full scale
CAMERAS = {'cam0': 'left_camera', 'cam1': 'right_camera'}

drive, folder = sys.argv[1], Path(sys.argv[2])
if folder.exists():
    sys.exit(f'{folder}: exists already')
settings = carb.settings.get_settings()
settings.set('/rtx/rendermode', 'PathTracing' if 'path-tracing' in sys.argv
             else 'RaytracedLighting')
settings.set('/rtx/sceneDb/ambientLightIntensity', 0.0)
omni.usd.get_context().open_stage(drive)
stage = omni.usd.get_context().get_stage()
for layer in stage.GetUsedLayers():     # materials for RTX, in memory only
    path = Path(layer.realPath) if layer.realPath else Path()
    twins = path.with_name(f'{path.stem}_parts') / 'omniverse.usda' if path.name else path
    if twins.name == 'omniverse.usda' and twins.is_file():
        layer.subLayerPaths.append(str(twins))
while app.is_running() and omni.usd.get_context().get_stage_loading_status()[2] > 0:
    app.update()

base = '/Drive/Rover/base_link'
left = stage.GetPrimAtPath(f'{base}/left_camera')
stamps = left.GetAttribute('lunar_rover_sim:stamp_ns')
width, height = left.GetAttribute('lunar_rover_sim:size_px').Get()
annotators = {}
for name, camera in CAMERAS.items():
    product = rep.create.render_product(f'{base}/{camera}', (width, height))
    annotators[name] = rep.AnnotatorRegistry.get_annotator('HdrColor')
    annotators[name].attach(product)
    (folder / 'mav0' / name / 'data').mkdir(parents=True)
timeline = omni.timeline.get_timeline_interface()
rows, gain = [], 0.0
for code in stamps.GetTimeSamples():
    timeline.set_current_time(code / stage.GetTimeCodesPerSecond())
    rep.orchestrator.step(rt_subframes=32, delta_time=0.0)
    stamp = int(stamps.Get(code))
    rows.append(stamp)
    for name, annotator in annotators.items():
        radiance = np.asarray(annotator.get_data(), np.float32)[..., :3].mean(axis=-1)
        if not gain:
            gain = LEVEL / radiance[radiance > 0.05 * radiance.max()].mean()
        grey = np.sqrt(np.clip(gain * radiance, 0.0, 1.0)) * 255.0
        Image.fromarray(np.rint(grey).astype(np.uint8)).save(
            folder / 'mav0' / name / 'data' / f'{stamp}.png')
for name in CAMERAS:
    (folder / 'mav0' / name / 'data.csv').write_text(
        '#timestamp [ns],filename\n' + ''.join(f'{t},{t}.png\n' for t in rows))
(folder / 'times.txt').write_text(''.join(f'{t}\n' for t in rows))
app.close()
