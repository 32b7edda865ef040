"""The world `beyond`: its skin and pictures are what they say, nothing is told, scores add up."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.errors import UserError
from chromagrip.measure.bench import force as bench_force
from chromagrip.measure.bench import force_beyond
from chromagrip.measure.bench.force_sets import Measured
from chromagrip.measure.engine import measure
from chromagrip.measure.study import Asked, find_study
from chromagrip.measure.worlds.beyond import groups
from chromagrip.measure.worlds.beyond.carried_skin import CarriedSkin, Motion, turned
from chromagrip.measure.worlds.beyond.cases import EXPONENTS, SIGMAS, Case
from chromagrip.measure.worlds.beyond.finished_pictures import (
    gradient,
    lit,
    rolled,
    shifted,
    tilted,
)
from chromagrip.measure.worlds.beyond.groups import BEYOND, GROUPS, beyond_grasp, beyond_scenes
from chromagrip.measure.worlds.beyond.scores import UNITS, beyond_scores
from chromagrip.measure.worlds.force_scenes import watch
from chromagrip.measure.worlds.force_scores import Answers, answers, constant
from chromagrip.measure.worlds.grasps import calibration
from chromagrip.model import ContactObject, contact_forces, equilibrium, rest_state
from chromagrip.output.report import Bounds
from chromagrip.render import Defects, MembraneMap, decode_srgb, rest_membrane
from chromagrip.sensing.sensor import TactileSensor
from chromagrip.tracking import Z90, load_calibration

SENSOR, TIP = calibration().sensor, calibration().fingertip
NODES = TIP.nodes
ANGLES = np.linspace(-np.pi / 2, np.pi / 2, NODES)
THETA, PHI = SENSOR.places.T
REST = rest_membrane(SENSOR).centres


def skin(**motion: float) -> CarriedSkin:
    return CarriedSkin(SENSOR, NODES, Motion(**motion))


def pressed() -> np.ndarray:
    return equilibrium(TIP, ContactObject(friction=0.7), 3.0, 0.8).deformation.seen


def sheared() -> np.ndarray:
    """A chain whose nodes move along x alone, alike on both sides: 0.1 mm·cos θ."""
    return np.column_stack([1e-4 * np.cos(ANGLES), np.zeros(NODES)])


# ---- the skin ----


def test_a_skin_that_moves_as_it_should_is_that_of_the_shared_map() -> None:
    """Two implementations: one through harmonics and kernels, one through points in space."""
    for displacement in (pressed(), np.zeros((NODES, 2))):
        own, shared = skin()(displacement), MembraneMap(SENSOR, NODES)(displacement)
        np.testing.assert_allclose(own.centres, shared.centres, atol=1e-12)
        turn = np.arccos(np.clip((own.normals * shared.normals).sum(axis=-1), -1.0, 1.0))
        assert np.rad2deg(turn).max() < 0.05
        np.testing.assert_allclose(np.linalg.norm(own.axes, axis=-2), 0.25e-3, rtol=1e-9)


@pytest.mark.parametrize("motion", [{"shear": 0.85}, {"radial": 0.05}, {"contraction": 0.3}])
def test_the_chains_plane_moves_as_the_chain_does_and_other_points_do_not(
    motion: dict[str, float],
) -> None:
    as_told, other = skin()(pressed()).centres, skin(**motion)(pressed()).centres
    plane = abs(np.sin(PHI)) < 1e-9
    assert plane.sum() > 10
    np.testing.assert_allclose(other[:, plane], as_told[:, plane], atol=1e-12)
    off = np.linalg.norm(other - as_told, axis=-1).max()
    assert 2e-6 < off < 0.2e-3


def test_shear_and_contraction_are_what_they_say() -> None:
    """Under a pure shear a(θ) along x: (1 + (s−1)·sin²φ)·a along x, −ν·sin φ·cos φ·a along y."""
    a = 1e-4 * np.cos(THETA) * SENSOR.follow[:, None]
    sin, cos = np.sin(PHI), np.cos(PHI)
    moved = skin(shear=0.9, contraction=0.2)(sheared()).centres - REST
    inner = THETA > 1e-9  # φ means nothing on the apex
    for k, wanted in enumerate((1.0 - 0.1 * sin**2, -0.2 * sin * cos, 0.0 * sin)):
        np.testing.assert_allclose(moved[:, inner, k], (wanted * a)[:, inner], atol=1e-8)


def test_the_load_is_turned_about_the_axis() -> None:
    psi = np.deg2rad(35.0)
    moved = skin(azimuth=psi)(sheared()).centres - REST
    a = 1e-4 * np.cos(THETA) * SENSOR.follow[:, None]
    np.testing.assert_allclose(moved[..., 0], np.cos(psi) * a, atol=1e-8)
    np.testing.assert_allclose(moved[..., 1], np.sin(psi) * a, atol=1e-8)
    # By half a turn the picture is mirrored.
    turned_half, first = skin(azimuth=np.pi)(pressed()), skin()(pressed() * [-1.0, 1.0])
    mirrored = first.centres  # the same press, loaded the other way
    odd = skin()(pressed()[::-1] * [-1.0, 1.0]).centres
    np.testing.assert_allclose(turned_half.centres, odd, atol=1e-9)
    assert abs(mirrored - odd).max() > 1e-5


def test_a_twist_turns_the_contact_by_its_angle_and_the_rim_hardly() -> None:
    angle = np.deg2rad(5.0)
    flat = np.column_stack([np.zeros(NODES), np.minimum(7.5e-3 - 8e-3 * np.cos(ANGLES), 0.0)])
    rest = 8e-3 * np.stack(
        [np.sin(THETA) * np.cos(PHI), np.sin(THETA) * np.sin(PHI), np.cos(THETA)], axis=-1
    )

    def azimuths(motion: CarriedSkin) -> np.ndarray:
        point = rest + (motion(flat).centres[0] - REST[0])  # the outer layer follows wholly
        return np.unwrap(np.arctan2(point[:, 1], point[:, 0]) - PHI, period=2 * np.pi)

    turn = azimuths(skin(twist=angle)) - azimuths(skin())
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    edge = np.arccos(7.5 / 8.0)
    touching = (edge - 0.01 > THETA) & (THETA > 1e-6)
    assert touching.sum() > 5
    np.testing.assert_allclose(turn[touching], angle, atol=1e-6)
    far = THETA > 1.2
    assert (turn[far] > 0.0).all()
    assert (turn[far] < 0.05 * angle).all()
    untouched = skin(twist=angle)(np.zeros((NODES, 2)))
    np.testing.assert_allclose(untouched.centres, REST, atol=1e-12)


# ---- finished pictures ----


def spot(place: np.ndarray, width: float = 4.0) -> np.ndarray:
    """Black picture with a round, soft spot."""
    y, x = np.mgrid[:480, :640]
    bright = 250.0 * np.exp(-0.5 * ((x - place[0]) ** 2 + (y - place[1]) ** 2) / width**2)
    return np.repeat(np.rint(bright)[..., None], 3, axis=-1).astype(np.uint8)


def centre(image: np.ndarray) -> np.ndarray:
    weight = image[..., 0].astype(float)
    y, x = np.mgrid[:480, :640]
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


@pytest.mark.parametrize("smooth", [False, True])
def test_a_rolled_picture_is_that_of_a_rolled_camera(smooth: bool) -> None:
    angle = np.deg2rad(7.0)
    for k in (20, 250):
        before = SENSOR.view.project(REST[0, k])
        after = SENSOR.view.project(skin(roll=angle)(np.zeros((NODES, 2))).centres[0, k])
        assert np.linalg.norm(after - before) > 2.0
        found = centre(rolled(angle, smooth)(spot(before)))
        np.testing.assert_allclose(found, after, atol=0.03)


def test_a_picture_is_enlarged_about_its_middle_and_shifted() -> None:
    place, middle = np.array([420.0, 300.0]), np.array([319.5, 239.5])
    found = centre(shifted((8.0, -3.0), 1.04)(spot(place)))
    np.testing.assert_allclose(found, middle + 1.04 * (place - middle) + [8.0, -3.0], atol=0.03)


def test_a_tilted_camera_sees_turned_directions() -> None:
    camera, angle = SENSOR.view.camera, np.deg2rad(3.0)
    change = tilted(camera, angle, 0.0)  # about x
    cos, sin = np.cos(angle), np.sin(angle)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    for point in (np.array([0.0, 0.0, 8e-3]), np.array([4e-3, -3e-3, 5e-3])):
        seen = centre(change(spot(camera.project(point))))
        # The camera's axes turn one way, what it sees the other.
        np.testing.assert_allclose(seen, camera.project(point @ about_x), atol=0.1)


def test_dimmer_light_is_dimmer_in_linear_light() -> None:
    levels = np.tile(np.arange(256, dtype=np.uint8)[None, :, None], (2, 1, 3))
    found = decode_srgb(lit(0.8)(levels).astype(float))
    wanted = 0.8 * decode_srgb(levels.astype(float))
    assert abs(found - wanted).max() < 0.005  # half a level
    light = gradient(640, 480, 0.2, 0.0)
    assert light.min() >= 0.8
    assert light[:, 0].mean() > light[:, -1].mean() + 0.1


def test_a_camera_takes_another_map_and_changes_its_finished_pictures() -> None:
    frames = []
    for own_map, picture in (
        (None, None),
        (MembraneMap(SENSOR, NODES), None),
        (None, lambda image: 255 - image),
        (skin(roll=0.1), None),
    ):
        sensor = TactileSensor(
            SENSOR,
            body=TIP,
            noise=2.0,
            seed=1,
            defects=Defects(),
            membrane_map=own_map,
            picture=picture,
        )
        with closing(sensor.camera) as camera:
            rest = camera.expose_rest(rest_state(TIP), 1)
            frames.append([*rest, camera.expose(rest_state(TIP), 0)])
    plain, mapped, inverted, other = ([f.image for f in pair] for pair in frames)
    np.testing.assert_array_equal(mapped, plain)
    np.testing.assert_array_equal(inverted, 255 - np.array(plain))
    assert abs(np.array(other).astype(int) - plain).max() > 50


# ---- groups ----


def test_no_group_tells_its_estimators_what_is_unlike() -> None:
    shipped = load_calibration("thesis")
    for group, draw in GROUPS.items():
        for index in range(12):
            case = draw(np.random.default_rng([1, index]), index)
            known = case.known
            if group in ("stiffness-told", "friction-law-mismatched"):
                assert known.stiffness_deviation == pytest.approx(0.1 / np.sqrt(3.0))
            elif group == "stiffness-untold":
                assert known == shipped  # with the spread of the design
            else:
                assert known == replace(shipped, stiffness_deviation=0.0)
            assert known.sensor == shipped.sensor
            assert known.fingertip == shipped.fingertip


def test_each_group_differs_from_what_is_told() -> None:
    """In specimen, pictures, noise, map or grasp; else its figures would be those in range."""
    shipped = load_calibration("thesis")
    for group, draw in GROUPS.items():
        case = draw(np.random.default_rng([2, 1]), 1)
        made = case.specimen
        unlike = [
            made.fingertip != shipped.fingertip,
            made.sensor != shipped.sensor,
            made.membrane_map is not None,
            made.renderer != "painter",
            case.pictures is not None,
            case.draw.__name__ != "random_grasp",
        ]
        assert any(unlike), group


def test_specimens_are_off_by_as_much_as_is_said() -> None:
    def made(group: str, count: int = 60) -> list:
        draw = GROUPS[group]
        return [draw(np.random.default_rng([3, k]), k).specimen for k in range(count)]

    sensor = calibration().sensor
    follow = np.array([m.sensor.yellow.follow for m in made("layers")]) / sensor.yellow.follow
    depth = np.array([m.sensor.yellow.depth_mm for m in made("layers")]) / sensor.yellow.depth_mm
    for share, bound in ((follow, 0.10), (depth, 0.15)):
        off = abs(share - 1.0)
        assert 0.9 * bound < off.max() <= bound + 1e-9
        assert (off[off > 1e-9] > 0.29 * bound).all()
        assert (share < 1.0).any()
        assert (share > 1.0).any()
    poisson = np.array([m.fingertip.poisson_tissue for m in made("poisson")]) / TIP.poisson_tissue
    assert 0.18 < abs(poisson - 1.0).max() <= 0.2 + 1e-9
    told, untold = made("stiffness-told"), made("stiffness-untold")
    for specimens in (told, untold):
        ratio = np.array([m.fingertip.tissue_stiffness for m in specimens]) / TIP.tissue_stiffness
        assert 0.09 < abs(ratio - 1.0).max() <= 0.1 + 1e-9
    for specimen in untold[1::2]:
        off = specimen.fingertip.tissue_stiffness / TIP.tissue_stiffness
        assert abs(off - 1.0) == pytest.approx(0.1)
        both = specimen.fingertip.membrane_stiffness / TIP.membrane_stiffness
        assert both == pytest.approx(off)


def test_the_friction_laws_are_all_tried() -> None:
    laws = set()
    for index in range(24):
        grasped = GROUPS["friction-law"](np.random.default_rng(0), index).draw(
            np.random.default_rng(index), 0.2, 0.3
        )
        laws.add((grasped.obj.dahl_stiffness, grasped.obj.dahl_exponent, grasped.obj.drag))
    assert laws >= {(sigma, n, 120.0) for sigma in SIGMAS for n in EXPONENTS}
    assert {drag for *_, drag in laws} == {30.0, 120.0, 400.0}
    assert max(sigma for sigma, *_ in laws) >= 1e5


@pytest.mark.parametrize("group", ["soft", "grips", "round", "hollow", "sliding", "trembling"])
def test_a_group_is_what_it_is_named_for(group: str) -> None:
    for index in range(3):
        case, grasped, run, _ = beyond_grasp(group, index)
        field = contact_forces(case.specimen.fingertip, grasped.obj, run.state(len(run) - 1))
        margin = field.safety_margin(grasped.obj.friction)
        if group == "soft":
            assert 1.0 <= grasped.obj.stiffness <= 40.0
        if group == "grips":
            assert 6.5 < field.total_normal < 14.5
        if group == "round":
            assert 3.0 <= 1e3 / grasped.obj.curvature <= 4.0
        if group == "hollow":
            assert grasped.obj.curvature < -1e-9
        if group == "sliding":
            moved = run.pose[-1, 1] - run.pose[-11, 1]
            assert abs(margin) < 0.05
            assert abs(moved) > 1e-5  # in its last tenth of a second
        if group == "trembling":
            grips = grasped.drive.at(np.linspace(1.2, 1.5, 200))[:, 0]
            assert 0.05 < np.ptp(grips) / grips.mean() < 0.25
        if group != "sliding":
            assert 0.02 <= margin <= 0.92


def test_grip_steps_are_scored_after_the_step_with_a_standing_load() -> None:
    _, grasped, _, _ = beyond_grasp("grip-step", 0)
    step = grasped.ends[0] - 0.1
    assert grasped.ends == pytest.approx([step + 0.1, step + 0.3, step + 0.8])
    before, after = grasped.drive.at(np.array([step - 1e-3, step + 1e-3]))
    assert 1.2 <= after[0] / before[0] <= 2.5
    assert after[1] == before[1]


def test_a_rolled_scene_is_rolled_at_rest_too() -> None:
    """Index 1 is a finished picture, rolled by 1° to 4°."""
    (scene,) = beyond_scenes("roll", 1)
    assert {"finished", "1-4deg"} == set(scene.labels)
    told = SENSOR.view.project(REST[0]) - [319.5, 239.5]
    seen = scene.rest.position[0] - [319.5, 239.5]
    tree = KDTree(seen[np.isfinite(seen).all(axis=-1)])
    degrees = np.arange(-15.0, 15.01, 0.05)
    apart = [np.median(tree.query(told @ turned(np.deg2rad(d))[:2, :2])[0]) for d in degrees]
    assert min(apart) < 0.1
    assert 1.0 <= abs(degrees[np.argmin(apart)]) <= 4.0


def test_frames_that_the_tracker_refuses_are_flagged_and_have_a_truth(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def black(rng: np.random.Generator, index: int) -> Case:
        return replace(
            GROUPS["roll"](rng, index),
            pictures=lambda rest, run: ([replace(f, image=0 * f.image) for f in rest], run),
        )

    monkeypatch.setattr(groups, "GROUPS", {"black": black})
    (scene,) = beyond_scenes("black", 0)
    assert "grey" in scene.refused
    assert 0.05 <= scene.margin <= 0.85
    for read, by_name in answers("sequential", "sequential", scene).items():
        for found in by_name.values():
            assert found.flagged.all(), read
            assert np.isnan(found.interval).all()
    case, grasped, run, seed = beyond_grasp("black", 0)
    assert case.specimen.renderer == "painter"
    with pytest.raises(UserError, match="grey"):
        watch(case.known, case.specimen, grasped, run, seed, pictures=case.pictures)


def test_the_same_grasp_is_drawn_in_each_group_and_each_time() -> None:
    first, again, other = (beyond_grasp(g, 4) for g in ("roll", "roll", "azimuth"))
    assert first[1].obj == again[1].obj == other[1].obj
    np.testing.assert_array_equal(first[2].nodes, again[2].nodes)
    np.testing.assert_array_equal(first[2].nodes, other[2].nodes)
    assert first[3] == again[3] != other[3]


# ---- scores ----

COUNT = 4000
TRUE = np.column_stack(
    [
        np.linspace(0.5, 6.0, COUNT),
        np.linspace(0.1, 1.0, COUNT),
        np.full(COUNT, 0.5),
        np.linspace(0.05, 0.84, COUNT),
    ]
)
DEVIATION = np.array([0.05, 0.01, 0.04, 0.06])


def said(share: float = 1.0, flags: float = 0.0) -> Answers:
    """Normal errors whose intervals are a share of what they should be."""
    rng = np.random.default_rng(0)
    value = TRUE + DEVIATION * rng.standard_normal(TRUE.shape)
    half = share * Z90 * DEVIATION
    return Answers(
        value=value,
        interval=np.stack([value - half, value + half], axis=-1),
        flagged=np.arange(COUNT) < flags * COUNT,
    )


def test_right_intervals_are_honest_and_half_as_wide_ones_are_not() -> None:
    right, narrow = beyond_scores(said(), TRUE), beyond_scores(said(share=0.5), TRUE)
    assert set(right) == set(UNITS)
    assert right["honest"] == pytest.approx(90.0, abs=1.5)
    # |z| > 3.29 in any of four: 4 × 0.1 %; |z| > 1.645: 1 − 0.9⁴.
    assert right["narrow"] == pytest.approx(0.4, abs=0.3)
    assert narrow["narrow"] == pytest.approx(34.4, abs=2.5)
    # |z| < 0.822 in 58.9 %.
    assert narrow["margin_honest"] == pytest.approx(58.9, abs=2.5)
    assert right["mu_width"] == pytest.approx(Z90, rel=0.05)
    assert narrow["margin_width"] == pytest.approx(Z90 / 2, rel=0.05)
    assert right["margin_error"] == pytest.approx(0.06, rel=0.05)
    assert right["flagged"] == narrow["flagged"] == 0.0


def test_flagged_frames_are_honest_and_no_error_is_counted_of_them() -> None:
    estimate = said(flags=0.25)
    estimate.value[estimate.flagged] = 9.0
    found = beyond_scores(estimate, TRUE)
    assert found["flagged"] == 25.0
    assert found["honest"] == pytest.approx(25.0 + 0.75 * 90.0, abs=1.5)
    assert found["margin_coverage"] == pytest.approx(90.0, abs=1.5)
    assert found["margin_error"] == pytest.approx(0.06, rel=0.05)


def test_an_interval_without_an_end_is_a_flag_and_none_at_all_is_too_narrow() -> None:
    endless, missing = said(), said()
    endless.interval[:400, 3] = [-np.inf, np.inf]
    missing.interval[:400, 3] = np.nan
    assert beyond_scores(endless, TRUE)["flagged"] == 10.0
    found = beyond_scores(missing, TRUE)
    assert found["flagged"] == 0.0
    assert found["margin_narrow"] == pytest.approx(10.0, abs=0.3)


def test_mu_is_not_asked_for_where_it_cannot_be_seen() -> None:
    true = TRUE.copy()
    true[:, 3] = 0.9
    estimate = said()
    estimate.value[:, 2] = 7.0
    found = beyond_scores(estimate, true)
    assert np.isnan(found["mu_honest"])


def test_rows_of_groups_and_parts_mark_what_a_constant_passes() -> None:
    results = Measured(
        true=TRUE,
        answers={read: {"sequential": said(share=0.5)} for read in ("single", "0.1s")},
        limit={},
        labels=tuple(("left" if k % 2 else "right", "all") for k in range(COUNT)),
    )
    rows = {
        row.name: row
        for row in force_beyond.beyond_rows(
            {"beyond/roll": results}, {"sequential": "sequential"}, "sequential"
        )
    }
    honest = rows["beyond/roll/0.1s/sequential/honest"]
    assert (honest.met, str(honest.target)) == (False, "≥ 90")
    assert honest.note == "a constant answer passes"
    error = rows["beyond/roll/0.1s/sequential/margin_error"]
    assert (error.met, error.note) == (True, "")  # the scatter of Γ is 0.23
    assert rows["beyond/roll/single/sequential/honest"].target is None
    assert rows["beyond/roll/0.1s/constant/honest"].value == pytest.approx(
        beyond_scores(constant(TRUE), TRUE)["honest"]
    )
    assert rows["beyond/roll/left/0.1s/sequential/scenes"].value == COUNT / 2
    assert rows["beyond/roll/all/0.1s/sequential/honest"].value == honest.value


def test_targets_are_of_groups_and_scores_that_there_are() -> None:
    labels = {
        (group, label)
        for group, *_ in force_beyond.PART_TARGETS
        for k in range(6)
        for label in GROUPS[group](np.random.default_rng([4, k]), k).labels
    }
    assert {group for group, _ in force_beyond.TARGETS} == set(GROUPS)
    assert {score for _, score in force_beyond.TARGETS} <= set(UNITS)
    assert {part[:2] for part in force_beyond.PART_TARGETS} <= labels
    assert force_beyond.TARGETS["roll", "flagged"] == Bounds(high=20.0)
    assert force_beyond.TARGETS["soft", "flagged"] == Bounds(high=50.0)


def test_a_run_has_the_groups_that_are_asked_for() -> None:
    full = bench_force._counts(False, "", ())
    assert {kind for world, kind in full if world == BEYOND} == set(GROUPS)
    assert min(n for (world, _), n in full.items() if world == BEYOND) >= 24
    asked = bench_force._counts(False, BEYOND, ("roll", "jpeg"))
    assert set(asked) == {(BEYOND, "roll"), (BEYOND, "jpeg")}
    assert {w for w, _ in bench_force._counts(True, "matched", ())} == {"matched"}
    for asked, said in (
        (
            Asked(world=BEYOND, only=("rolls",)),
            r"has no group 'rolls' \(did you mean roll\?\); there is roll, ",
        ),
        (Asked(world="outer"), "no world 'outer'; there is matched, "),
    ):
        with pytest.raises(UserError, match=said):
            measure("bench", "force", asked)
    # A group says which world it belongs to.
    assert find_study("bench", "force", Asked(only=("roll",))).worlds[-1] == BEYOND
    assert find_study("bench", "force", Asked(only=("elements",))).worlds == ("dome",)
