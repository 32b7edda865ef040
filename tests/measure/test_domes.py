"""Pictures of domes for estimators: grips, specimens and scores are what they say."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from msgspec import structs

from chromagrip.measure.worlds.dome.elements import CASES, ElementField, presses
from chromagrip.measure.worlds.dome.grips import MARGINS, SMOOTH, UNLIKE, Grip, random_grip
from chromagrip.measure.worlds.dome.readings import UNITS, Reading, constant, read, scores
from chromagrip.measure.worlds.dome.scenes import Watched, watch
from chromagrip.measure.worlds.dome.specimens import (
    OFF,
    SPECIMENS,
    matched,
    mismatched,
    signs,
)
from chromagrip.measure.worlds.force_scores import Answers
from chromagrip.model import ForceField, Solid, simulate_contact
from chromagrip.model.dome import MarkerField, press_and_move
from chromagrip.model.shapes import plane
from chromagrip.render import Defects
from chromagrip.tracking import NoEstimateError, Tracks, sensor_as_designed

FIXTURES = Path(__file__).parents[2] / "fixtures"


# ---- grips and specimens ----


@pytest.mark.parametrize("kind", [*SMOOTH, "edge", "beside", "ring"])
def test_a_grip_is_loaded_to_its_margins(kind: str) -> None:
    grip = random_grip(np.random.default_rng(5), matched("dome-2020").dome, kind, 2.0)
    motion = grip.motion
    held = np.array([motion.loads[np.argmin(abs(motion.times - end)), :3] for end in grip.ends])
    assert np.linalg.norm(held[0]) == pytest.approx(2.0)
    down = held[0] / 2.0
    across = held[1:] - np.outer(held[1:] @ down, down)
    assert held[1:] @ down == pytest.approx(np.full(3, 2.0))
    load = np.linalg.norm(across, axis=1)
    assert 1.0 - load / (2.0 * grip.solid.friction) == pytest.approx(grip.margins)
    assert grip.margins == pytest.approx(MARGINS, abs=0.031)
    # A plane and a rod are pressed along their own normal, however they are tilted.
    assert math.degrees(math.acos(-down[2])) <= (8.0 if kind in ("rod", "tilted") else 1e-6)
    assert set(UNLIKE).isdisjoint(SMOOTH)


def test_each_deviation_is_up_in_half_of_the_specimens_whatever_another_is() -> None:
    table = np.array([signs(k) for k in range(SPECIMENS)])
    assert table.shape == (SPECIMENS, len(OFF))
    assert np.array_equal(table.T @ table, SPECIMENS * np.eye(len(OFF)))
    assert (table.sum(axis=0) == 0).all()


def test_a_mismatched_specimen_is_off_by_what_is_said() -> None:
    nominal, off = matched("dome-2022"), mismatched("dome-2022", 3)
    up = dict(zip(OFF, signs(3), strict=True))
    one, other = nominal.dome, off.dome
    assert other.young / one.young == pytest.approx(1.0 + 0.1 * up["young"])
    assert other.thickness / one.thickness == pytest.approx(1.0 + 0.03 * up["thickness"])
    assert other.poisson - one.poisson == pytest.approx(0.01 * up["poisson"])
    assert math.degrees(off.roll) == pytest.approx(0.5 * up["roll_deg"])
    assert other.spacing < one.spacing
    moved = 1e3 * (off.sensor.depths - nominal.sensor.depths)
    assert moved[0] == pytest.approx(0.05 * up["depth_mm"])
    assert off.sensor.depths[1] == pytest.approx(other.thickness)  # still on the core
    camera = off.sensor.camera
    middle = ((camera.width_px - 1) / 2, (camera.height_px - 1) / 2)
    shift = np.array(camera.centre_px) - np.array(middle)
    assert shift == pytest.approx([0.5 * up["centre_x_px"], 0.5 * up["centre_y_px"]])


# ---- pictures ----


@pytest.fixture(scope="module")
def watched() -> Watched:
    """Pictures of a flat object on a coarse dome without defects, loaded to one margin."""
    made, solid = matched("dome-2020"), Solid(shape=plane(), friction=0.6)
    dome = replace(made.dome, pitch=2e-3, reach=math.radians(40.0))
    coarse = replace(made, dome=dome, sensor=structs.replace(made.sensor, defects=Defects()))
    zeros = {"pose": np.zeros(6), "lean": np.zeros(3)}
    grip = Grip(solid=solid, **zeros, normal=3.0, azimuth=2.0, margins=(0.4,))
    return watch(sensor_as_designed("dome-2020"), coarse, grip, 1)


def test_true_forces_are_grip_and_load(watched: Watched) -> None:
    assert watched.true[:, 0] == pytest.approx([3.0, 3.0], rel=0.01)
    assert watched.true[:, 3] == pytest.approx([1.0, 0.4], abs=0.03)
    load = 0.6 * 3.0 * 0.6
    pulled = load * math.cos(2.0), load * math.sin(2.0)
    assert watched.side[1, :2] == pytest.approx(pulled, abs=0.03)
    assert len(watched.tracks) == watched.scored[-1] + 1


def test_a_rolled_camera_turns_the_markers_about_its_axis() -> None:
    def field(places: np.ndarray, _forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((*places.shape[:2], 3)), np.zeros((*places.shape[:2], 3, 2))

    made, forces = matched("dome-2020"), np.zeros((1, 3))
    cameras = [replace(made, roll=roll).camera(1, field) for roll in (0.0, math.pi / 2)]
    straight, rolled = (camera.membrane(forces).centres for camera in cameras)
    x, y, z = np.moveaxis(straight, -1, 0)
    assert np.allclose(rolled, np.stack([-y, x, z], axis=-1), equal_nan=True)


# ---- finite elements ----


def test_element_presses_are_those_of_the_table_of_forces() -> None:
    """The same presses at other depths: forces of `presses.json`, by its own interpolation."""
    book = json.loads((FIXTURES / "hyperelastic" / "presses.json").read_text(encoding="utf-8"))
    for how in ("stick", "slip"):
        force = book["cases"][f"20/15.6 nu 0.48 plane {how}"]["hyperelastic"]["force"][:2]
        table = 1e6 * presses()[f"dome-2020 plane {how}s/normal"]
        depths = 0.5 * (np.arange(len(table)) / 24) ** 1.5
        found = np.interp(book["depths"][:2], depths, table)
        assert found == pytest.approx(force, rel=0.02)


@pytest.mark.parametrize("case", CASES)
def test_slopes_of_element_fields_are_those_of_their_motion(case: str) -> None:
    made = matched("dome-2022")
    field = ElementField("dome-2022", case, made)
    places = np.broadcast_to([[0.05, 0.3], [0.2, 2.0], [0.5, -1.0]], (2, 3, 2)).copy()
    moved, slope = field(places, 2.0)
    assert not field(places, 0.0)[0].any()
    step = 1e-5
    for k in range(2):
        shifted = places.copy()
        shifted[..., k] += step
        length = (made.dome.radius - made.sensor.depths)[:, None, None] * np.ones((1, 3, 1))
        if k:
            length = length * np.sin(places[..., :1])
        found = (field(shifted, 2.0)[0] - moved) / (step * length)
        assert slope[..., k] == pytest.approx(found, abs=2e-4)


def test_light_presses_of_elements_and_of_the_dome_move_markers_alike() -> None:
    made = matched("thesis")
    places = np.broadcast_to([[0.02, 0.0], [0.1, 1.0], [0.25, -2.0]], (2, 3, 2))
    sticky = Solid(shape=plane(), stiffness=1e12, friction=5.0, dahl_stiffness=1e12)
    run = simulate_contact(made.dome, sticky, press_and_move(0.25e-3, press_s=0.02), 2e-3)
    normal = -float(run.total_forces[-1, 2])
    moved = MarkerField(made.dome, places, made.sensor.depths)(run.end.linear)[0]
    found = ElementField("thesis", "plane sticks", made)(places, normal)[0]
    off = np.linalg.norm(found - moved, axis=-1).max()
    assert off < 0.12 * np.linalg.norm(found, axis=-1).max()


# ---- readings ----


class Counting:
    """Reads 2 N off every third frame that it is given, and refuses the others."""

    given: ClassVar[list[float]] = []

    def __init__(self, _calibration: object, _rest: Tracks) -> None:
        self.given.clear()

    def reset(self) -> None: ...

    def update(self, tracks: Tracks) -> ForceField:
        self.given.append(tracks.time)
        if round(tracks.time) % 3:
            raise NoEstimateError("not a third frame")
        return ForceField(
            position=np.zeros((1, 3)),
            normal=np.array([2.0]),
            friction=np.array([[0.3, -0.4, 0.0]]),
            contact=np.array([True]),
            totals_covariance=np.diag([0.01, 0.01]),
            directions=np.array([[0.0, 0.0, -1.0]]),
        )


def test_a_scene_is_read_in_order_and_refusals_are_flags(watched: Watched) -> None:
    tracks = [replace(watched.rest, time=float(k)) for k in range(8)]
    true, side = np.array([[2.0, 0.5, 0.5, 0.5]] * 2), np.array([[0.3, -0.4, 0.0]] * 2)
    reading = read(Counting, replace(watched, tracks=tracks, scored=(6, 7), true=true, side=side))
    assert Counting.given == list(range(8))
    assert list(reading.answers.flagged) == [False, True]
    assert reading.answers.value[0, :2] == pytest.approx([2.0, 0.5])
    assert reading.side[0] == pytest.approx([0.3, -0.4, 0.0])
    found = scores(reading, true, side)
    assert (found["flagged"], found["normal_share"]) == (50.0, pytest.approx(0.0))


def _reading(value: np.ndarray, half: np.ndarray, side: np.ndarray) -> Reading:
    flagged, interval = np.zeros(len(value), np.bool_), np.stack([value - half, value + half], -1)
    return Reading(
        answers=Answers(value=value, interval=interval, flagged=flagged),
        side=side,
        spent=np.array([0.01, 0.02, 0.04]),
        each=np.array([*[0.01] * 97, 0.02, 0.04, 0.1]),
        late=np.array([False]),
    )


def test_scores_are_the_errors_that_are_put_in() -> None:
    true = np.array([[3.0, 1.0, 0.5, 0.1], [3.0, 1.0, 0.5, 0.3], [3.0, 1.0, 0.5, 0.6]])
    side = np.array([[0.6, 0.8, 0.002]] * 3)
    off = np.array([[0.3, 0.0, 0.0, 0.05], [-0.3, 0.0, 0.0, 0.1], [0.3, 0.0, 0.0, -0.2]])
    half = np.full((3, 4), 0.14)
    half[:, 1] = 1e-3
    found = scores(_reading(true + off, half, side + np.array([0.03, -0.04, 1e-4])), true, side)
    assert found.keys() == UNITS.keys()
    assert found["normal_share"] == pytest.approx(10.0)
    assert found["side_x"] == pytest.approx(0.03)
    assert found["side_share"] == pytest.approx(5.0)
    assert found["torque"] == pytest.approx(0.1)  # N·mm
    assert found["torque_share"] == pytest.approx(5.0)
    assert [found[f"margin_{n}"] for n in ("10", "30", "60")] == pytest.approx([0.05, 0.1, 0.2])
    assert found["normal_narrow"] == 100.0  # 0.3 is further than twice 0.14
    assert found["margin_narrow"] == 0.0
    assert found["margin_coverage"] == pytest.approx(200.0 / 3.0)
    assert found["rate"] == pytest.approx(50.0)
    assert found["time_p95"] == pytest.approx(10.0)  # ms
    assert 20.0 <= found["time_p99"] <= 100.0
    assert found["time_worst"] == pytest.approx(100.0)
    # The constant answer is right on average, and no better.
    guess = scores(constant(true, side), true, side)
    assert guess["normal_share"] == pytest.approx(0.0)
    assert guess["margin_10"] == pytest.approx(0.7 / 3.0, abs=0.01)


# ---- rows ----
