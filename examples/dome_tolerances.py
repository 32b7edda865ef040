"""What a silicone that is not as told costs: a dome that differs is read as designed.

python examples/dome_tolerances.py [SENSOR ...]   # dome-2020 and dome-2022 by default
"""

import sys

import numpy as np
from msgspec.structs import replace

from chromagrip.model import Motion, Solid, dome_forces, shapes, simulate_contact
from chromagrip.render import DomeMap, SensorDesign, areas, centroids, outlines
from chromagrip.tracking import Tracks, load_reconstructor, sensor_as_designed
from chromagrip.tracking.forces import silicone_of, with_silicone

MU, NORMAL, MARGIN = 0.6, 3.0, 0.2  # of the grip, whose load leaves this Γ


def gripped(sensor: SensorDesign) -> list:
    """States of a dome that a plate is pressed on by a force, and then pulled."""
    loads = np.zeros((4, 6))
    loads[1:, 2], loads[2:, 0] = -NORMAL, (1.0 - MARGIN) * MU * NORMAL
    motion = Motion(
        times=[0.0, 0.2, 0.6, 0.7],
        poses=np.zeros((4, 6)),
        free=("x", "y", "z"),
        drag=(2.0, 2.0, 25.0, 0.0, 0.0, 0.0),
        loads=loads,
    )
    plate = Solid(shape=shapes.plane(), friction=MU)
    return simulate_contact(sensor.dome, plate, motion, dt=15e-3, keep=24).states


def tracked(sensor: SensorDesign, states: list) -> list[Tracks]:
    """Tracks of its markers without noise, the first at rest."""
    markers, tracks, sizes = DomeMap(sensor, sensor.dome), [], 0.0
    for state in [None, *states]:
        linear = np.zeros_like(states[0].linear) if state is None else state.linear
        image = outlines(markers(linear), sensor.view)
        size = 0.5 * np.log(areas(image, False))
        sizes = size if state is None else sizes
        count, time = size.shape[1], 0.0 if state is None else state.time
        tracks.append(
            Tracks(
                time=time,
                position=centroids(image, False),
                log_size=size - sizes,
                hue=np.full(count, np.nan),
                visible=np.ones(size.shape, bool),
                ambiguous=np.zeros(size.shape, bool),
                last_seen=np.full(size.shape, time),
                covariance=np.tile(np.diag([1e-4, 1e-4, 1e-6] * 2), (count, 1, 1)),
            )
        )
    return tracks


print("| sensor | its silicone | ΣFn as read | Γ as read |")
print("|---|---|---|---|")
for name in sys.argv[1:] or ("dome-2020", "dome-2022"):
    told = sensor_as_designed(name)
    values = silicone_of(told)
    for words, changes in (
        ("as designed", {}),
        ("core 0.1 mm larger", {"core_mm": values.core_mm + 0.1}),
        ("10 % softer", {"young_kpa": 0.9 * values.young_kpa}),
        ("magenta 0.1 mm deeper", {"magenta_depth_mm": values.magenta_depth_mm + 0.1}),
    ):
        specimen = with_silicone(told, replace(values, **changes)).sensor
        states = gripped(specimen)
        rest, *frames = tracked(specimen, states)
        reader = load_reconstructor("contact")(told, rest)
        field = [reader.update(frame) for frame in frames][-1]
        truth = dome_forces(specimen.dome, states[-1])
        force = field.total_normal / truth.total_normal - 1.0
        margin = field.safety_margin(field.friction_reading.value) - truth.safety_margin(MU)
        print(f"| `{name}` | {words} | {100 * force:+.0f} % | {margin:+.2f} |", flush=True)
