"""A gripper in MuJoCo lifts a box and holds Γ = 0.3 by both cameras; writes gripper.mp4."""

import cv2
import mujoco
import numpy as np

import chromagrip
from chromagrip.mujoco import attach

FINGER = """
<body name="{name}" pos="{x} 0 0"><joint name="{name}" type="slide" axis="1 0 0" damping="20"/>
  <geom type="sphere" size=".02" mass=".1" rgba=".9 .6 .8 .5"/>
  <site name="{name}" euler="0 {turn} 0"/></body>"""
MODEL = f"""
<mujoco><option timestep=".002"/><worldbody><geom type="plane" size="1 1 .1"/>
  <body name="box" pos="0 0 .03"><freejoint/><geom type="box" size=".02 .02 .03" mass=".1"
    friction=".6"/></body>
  <body pos="0 0 .03"><joint name="lift" type="slide" axis="0 0 1"/>
    <geom type="box" pos="0 0 .1" size=".06 .02 .01" mass=".2" contype="0" conaffinity="0"/>
    {FINGER.format(name="left", x=-0.042, turn=90)}
    {FINGER.format(name="right", x=0.042, turn=-90)}
</body></worldbody><actuator><position joint="lift" kp="2000" kv="80"/>
  <motor joint="left"/><motor joint="right" gear="-1"/></actuator></mujoco>"""

model = mujoco.MjModel.from_xml_string(MODEL)
data = mujoco.MjData(model)
tips = [
    attach(model, data, site=name, body="box", sensor="dome-2022", two_way=True, noise=2.0, seed=k)
    for k, name in enumerate(("left", "right"))
]
readers = [chromagrip.Reader("dome-2022", tip.sensor.rest_frames(8), noise=2.0) for tip in tips]
video, grip, every, margins = None, 1.0, 8, []  # every 8th step of 2 ms has a picture: 62.5 Hz
for step in range(1500):
    seconds = 2e-3 * step
    data.ctrl[:] = 0.05 * np.clip(seconds - 0.8, 0.0, 1.0), grip, grip
    mujoco.mj_step(model, data)
    for tip in tips:
        tip.update()
    if step % every:
        continue
    images = [tip.data.image for tip in tips]
    seen = [reader.update(image, seconds) for reader, image in zip(readers, images, strict=True)]
    known = [one.margin for one in seen if one.ok and np.isfinite(one.margin)]
    if len(known) == 2 and min(known) < 0.9:  # the weight is on the fingers: µ shows
        needed = grip * (1.0 - min(known)) / 0.7  # that leaves Γ = 0.3
        grip += 0.05 * (np.clip(needed, 0.3, 3.0) - grip)
    margins.append([grip, min(known, default=np.nan), *(tip.data.margin for tip in tips)])
    picture = cv2.cvtColor(np.hstack(images), cv2.COLOR_RGB2BGR)
    for row, words in enumerate((f"{seconds:.2f} s", f"{grip:.2f} N", f"{margins[-1][1]:.2f}")):
        cv2.putText(picture, words, (8, 20 + 18 * row), 0, 0.5, (255, 255, 255))
    if video is None:
        size = picture.shape[1::-1]
        video = cv2.VideoWriter("gripper.mp4", cv2.VideoWriter_fourcc(*"mp4v"), 62.5, size)
    video.write(picture)
video.release()
height = data.body("box").xpos[2] - 0.03
print(f"lifted by {1e3 * height:.1f} mm, grip {grip:.2f} N, true margins", np.round(margins[-1], 2))
