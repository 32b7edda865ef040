"""What every reconstructor keeps to, on tracks of a chain or of a dome with known forces."""

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from chromagrip import Reader
from chromagrip.errors import UserError
from chromagrip.model import ForceField, Solid, contact_forces, dome_forces
from chromagrip.model.shapes import plane
from chromagrip.render import DomeMap, MembraneMap, add_noise, open_renderer
from chromagrip.tracking import (
    Z90,
    NoEstimateError,
    SensorCalibration,
    Tracks,
    check_reconstructor,
    load_calibration,
    load_reconstructor,
)
from chromagrip.tracking.forces import DOME_METHODS
from chromagrip.tracking.forces.reconstructors import (
    AUTOMATIC,
    DEFAULT_RECONSTRUCTOR,
    RECONSTRUCTORS,
    Reconstructor,
)

from .drawn import DESIGN, DOME, SENSOR, TIP, Drawn, Specimen, grasped, known, pulled
from .drawn import OBJECT as CHAIN_OBJECT

METHODS = [name for name in RECONSTRUCTORS.entries if name != DEFAULT_RECONSTRUCTOR]
each = pytest.mark.parametrize("name", METHODS)
#: Direction of the load on a dome [rad].
AZIMUTH = 0.4


def made(name: str) -> Reconstructor:
    return load_reconstructor(name)(known(name in DOME_METHODS), course(name in DOME_METHODS)[0])


@cache
def states(dome: bool, side: float = 1.0) -> list[tuple[np.ndarray, ForceField]]:
    """A press that is then pulled: what the skin's markers go by, and the true forces."""
    if dome:
        azimuth = AZIMUTH + (math.pi if side < 0.0 else 0.0)
        grasp = grasped(Solid(shape=plane(), friction=0.6), azimuth, 0.2)
        return [(state.linear, dome_forces(DOME, state)) for state in grasp]
    run = pulled(side)
    chain = [run.state(k) for k in range(0, len(run), 2)]
    return [(s.deformation.seen, contact_forces(TIP, CHAIN_OBJECT, s)) for s in chain]


@cache
def course(dome: bool, side: float = 1.0) -> tuple[Tracks, list[Tracks], list[ForceField]]:
    """Tracks at rest; tracks and true forces of a press that is then pulled."""
    truths = [truth for _, truth in states(dome, side)]
    if dome:
        drawn = Drawn(DESIGN, DOME, 7)
        return drawn(), [drawn(linear) for linear, _ in states(dome, side)], truths
    specimen, frames = Specimen(), []
    for k, (seen, _) in enumerate(states(dome, side)):
        frames.append(specimen.tracks(seen, 1.0, 100 + k, 0.02 * k))
    return specimen.rest, frames, truths


@cache
def readings(name: str, side: float = 1.0) -> list[ForceField]:
    reader = made(name)
    return [reader.update(tracks) for tracks in course(name in DOME_METHODS, side)[1]]


def same(one: ForceField, other: ForceField) -> bool:
    return all(
        np.array_equal(getattr(one, field), getattr(other, field))
        for field in ("normal", "friction", "totals_covariance")
    )


@each
def test_at_rest_there_is_no_force(name: str) -> None:
    dome = name in DOME_METHODS
    untouched = (
        Drawn(DESIGN, DOME, 1)() if dome else Specimen().tracks(np.zeros((TIP.nodes, 2)), 1.0, 7)
    )
    field = made(name).update(untouched)
    assert field.total_normal < 0.06
    assert field.friction_reading is None or not field.friction_reading.observable


@each
def test_a_press_is_read_within_its_interval(name: str) -> None:
    """Sums of every loaded frame, and in the end µ and Γ with theirs."""
    truths, held = course(name in DOME_METHODS)[2], []
    for field, truth in zip(readings(name), truths, strict=True):
        if truth.total_normal < 1.5:
            continue
        found = np.array([field.total_normal, field.total_friction])
        true = np.array([truth.total_normal, truth.total_friction])
        assert found[0] == pytest.approx(true[0], rel=0.12)
        assert found[1] == pytest.approx(true[1], abs=0.12)
        deviations = np.sqrt(np.diag(field.totals_covariance))
        held.append(abs(found - true) < Z90 * deviations)
        assert (deviations < 0.15 * true[0]).all()
    assert np.mean(held) > 0.7
    reading, friction = field.friction_reading, 0.6 if name in DOME_METHODS else 0.45
    assert reading is not None
    assert reading.observable
    assert abs(reading.value - friction) < 3.0 * reading.deviation < 0.6
    off = field.safety_margin(reading.value) - truth.safety_margin(friction)
    # A constant margin of 0.5 would be off by 0.3, and its interval would not hold the truth.
    assert abs(off) < min(0.15, 2.5 * reading.margin_deviation)


@each
def test_shear_to_the_other_side_has_the_other_sign(name: str) -> None:
    dome = name in DOME_METHODS
    there = readings(name)[-1]
    reader = made(name)
    for tracks in course(dome, -1.0)[1]:
        back = reader.update(tracks)
    ways = []
    for field, truth in ((there, course(dome)[2][-1]), (back, course(dome, -1.0)[2][-1])):
        if dome:
            assert field.net_friction == pytest.approx(truth.net_friction, abs=0.1)
            ways.append(field.net_friction)
        else:
            # The plane of the load is known but for its sense.
            ways.append(field.friction[field.contact].sum())
            assert ways[-1] == pytest.approx(truth.friction[truth.contact].sum(), abs=0.06)
    assert ways[1] == pytest.approx(-np.asarray(ways[0]), abs=0.1)


@each
def test_the_same_tracks_are_the_same_reading_and_a_copy_goes_its_own_way(name: str) -> None:
    """After a reset too, and whatever object or body made them: nothing else is known."""
    _, frames, _ = course(name in DOME_METHODS)
    reader = made(name)
    for tracks in frames[:4]:
        reader.update(tracks)
    other = deepcopy(reader)
    other.update(frames[-1])
    for tracks, before in zip(frames[4:6], readings(name)[4:6], strict=True):
        assert same(reader.update(tracks), before)
    reader.reset()
    for tracks, before in zip(frames[:2], readings(name)[:2], strict=True):
        assert same(reader.update(tracks), before)


@each
def test_covered_markers_are_refused_by_number_and_the_next_frame_is_read(name: str) -> None:
    frames = course(name in DOME_METHODS)[1]
    reader = made(name)
    for tracks in frames[:5]:
        reader.update(tracks)
    few = np.zeros_like(frames[5].visible)
    few[:, :5] = True
    with pytest.raises(NoEstimateError, match=r"^5 marker pairs visible .* at least \d+ are"):
        reader.update(replace(frames[5], visible=few))
    field, before = reader.update(frames[6]), readings(name)[6]
    assert field.total_normal == pytest.approx(before.total_normal, rel=0.1)


@pytest.mark.parametrize("dome", [pytest.param(False, marks=pytest.mark.stages), True])
def test_a_reader_goes_on_after_a_black_picture_and_copies_go_their_own_way(dome: bool) -> None:
    """Pictures at rest and of three states, read by the reconstructor of each body."""
    design, skin = (DESIGN, DomeMap(DESIGN, DOME)) if dome else (SENSOR, MembraneMap(SENSOR, 251))
    painter, images, course = open_renderer("painter", design), [], states(dome)
    for k, number in enumerate((0, 12, 16, -1)):
        images.append(painter.render(skin((k > 0) * course[number][0])))
        add_noise(images[-1], 1.0, 3, k)
    reader = Reader(known(dome), images[:1], noise=1.0)
    assert reader.update(images[1], 0.0).ok
    other, third = reader.copied(), reader.copied()
    black = reader.update(np.zeros_like(images[0]), 0.1)
    assert black.no_estimate
    assert math.isnan(black.margin)
    assert reader.update(images[2], 0.2).ok
    first, again = (one.update(images[3], 0.3).observation for one in (other, third))
    assert first is not None
    assert again is not None
    assert same(first.field, again.field)
    assert first.field.total_normal == pytest.approx(course[-1][1].total_normal, rel=0.12)


class Foreign:
    """One that somebody else wrote."""

    def __init__(self, calibration: SensorCalibration, rest: Tracks) -> None: ...

    def reset(self) -> None: ...

    def update(self, tracks: Tracks) -> ForceField: ...


def test_reconstructors_go_by_name() -> None:
    loaded: Callable[[SensorCalibration, Tracks], object]
    loaded = load_reconstructor(f"{__name__}:Foreign")
    assert loaded is Foreign
    with pytest.raises(UserError, match="there is auto, sequential"):
        load_reconstructor("magic")
    with pytest.raises(UserError, match="has no reset"):
        load_reconstructor("collections:OrderedDict")
    for body, name in AUTOMATIC.items():
        dome = body == "dome"
        automatic = load_reconstructor(DEFAULT_RECONSTRUCTOR)(known(dome), course(dome)[0])
        assert type(automatic) is load_reconstructor(name)


@pytest.mark.parametrize("name", RECONSTRUCTORS.entries)
def test_only_trained_reconstructors_refuse_a_sensor_without_a_read_out(
    name: str, no_kept: Path
) -> None:
    fovea = load_calibration("fovea")
    check_reconstructor(name, load_calibration("thesis"))
    if name in DOME_METHODS:
        check_reconstructor(name, fovea)
        with pytest.raises(UserError, match="silicone"):
            load_reconstructor(name)(load_calibration("flat-2019"), course(True)[0])
        return
    sentence = "^sensor fovea has no trained read-out: .*`chromagrip calibrate readout fovea`"
    with pytest.raises(UserError, match=sentence):
        check_reconstructor(name, fovea)
    with pytest.raises(UserError, match="sensor fovea has no trained read-out"):
        load_reconstructor(name)(fovea, course(False)[0])
