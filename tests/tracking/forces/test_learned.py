from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from chromagrip.calibrate.histories import Plan, Snapshots, random_plan, snapshots
from chromagrip.errors import UserError
from chromagrip.model import ContactObject, Fingertip, ForceField, equilibrium
from chromagrip.render import load_sensor
from chromagrip.tracking import NoEstimateError, SensorCalibration, Tracks, load_calibration
from chromagrip.tracking.forces.chain.learned import Learned
from chromagrip.tracking.forces.chain.readout import forward, linearised, load_readout, save_readout
from chromagrip.tracking.forces.chain.sensitivity import MarkerResponse
from chromagrip.tracking.forces.chain.settings import CodeSettings, LearnedSettings

SENSOR = load_sensor("thesis")
TIP = Fingertip()
KNOWN = load_calibration("thesis")
#: Of (x, y, log size) of both layers, as the tracker reaches it at a noise of 2 levels.
NOISE = np.array([7.5e-3, 7.5e-3, 1.35e-3, 6e-3, 6e-3, 1.05e-3])
#: Of the image [px].
CENTRE = np.array([319.5, 239.5])


class Specimen:
    """Tracks of a sensor whose markers do not sit where the design has them."""

    def __init__(self, scatter: float = 0.0, turned_by: float = 0.0) -> None:
        rng = np.random.default_rng(3)
        places = SENSOR.places - [0.0, turned_by]
        self._turn = np.array(
            [[np.cos(turned_by), np.sin(turned_by)], [-np.sin(turned_by), np.cos(turned_by)]]
        )
        off = rng.normal(0.0, scatter, (2, *places.shape)) / 8e-3
        off[..., 1] /= np.maximum(np.sin(places[:, 0]), 0.02)
        self._response = MarkerResponse(SENSOR, places + off, TIP.angles())
        self.pairs = len(places)
        self.rest = self.tracks(np.zeros((TIP.nodes, 2)), 0.25, 0)

    def tracks(self, seen: np.ndarray, noise: float, seed: int) -> Tracks:
        rng = np.random.default_rng(seed)
        shown = self._response.measured(seen.astype(float))
        shown = shown + noise * NOISE * rng.standard_normal(shown.shape)
        found = np.ones((2, self.pairs), dtype=bool)
        return Tracks(
            time=0.0,
            position=(np.stack([shown[:, :2], shown[:, 3:5]]) - CENTRE) @ self._turn + CENTRE,
            log_size=np.stack([shown[:, 2], shown[:, 5]]),
            hue=np.zeros(self.pairs),
            visible=found,
            ambiguous=~found,
            last_seen=np.zeros((2, self.pairs)),
            covariance=np.tile(np.diag((noise * NOISE) ** 2), (self.pairs, 1, 1)),
        )


@pytest.fixture(scope="module")
def unseen() -> Snapshots:
    """Of histories that no training has seen, those that a gripper meets."""
    plans = {number: random_plan(TIP, number) for number in range(900_000, 900_640)}
    numbers = [number for number, plan in plans.items() if _is_usual(plan)]
    parts = [vars(snapshots(TIP, range(number, number + 1))) for number in numbers]
    found = Snapshots(**{k: np.concatenate([part[k] for part in parts]) for k in parts[0]})
    normal, friction, mu = found.totals.T
    margin = 1.0 - abs(friction) / (mu * normal)
    usual = (normal > 0.4) & (normal < 6.0) & (margin > 0.05) & (margin < 0.85)
    return Snapshots(**{name: value[usual] for name, value in vars(found).items()})


def _is_usual(plan: Plan) -> bool:
    shape, obj = plan.contact.shape, plan.contact.obj
    stiff = obj.stiffness > 70.0 and 2000.0 < obj.dahl_stiffness < 2e4
    rough = 0.12 < obj.friction < 1.2 and obj.dahl_exponent < 1.0
    return shape in ("flat", "round") and stiff and rough


def press_of(unseen: Snapshots, newtons: float) -> np.ndarray:
    """Displacements of the press whose ΣFn is nearest to that."""
    nearest: np.ndarray = unseen.displacement[abs(unseen.totals[:, 0] - newtons).argmin()]
    return nearest


@pytest.fixture(scope="module")
def specimen() -> Specimen:
    return Specimen(scatter=80e-6)


@pytest.fixture(scope="module")
def learned(specimen: Specimen) -> Learned:
    return Learned(KNOWN, specimen.rest, averaged=False)


@pytest.mark.stages
def test_what_no_trained_press_shows_is_a_setting(specimen: Specimen, unseen: Snapshots) -> None:
    tracks = specimen.tracks(press_of(unseen, 2.0), 1.0, 4)
    assert Learned(KNOWN, specimen.rest).update(tracks).total_normal > 1.0
    strict = LearnedSettings(codes=CodeSettings(unlike=0.01))
    with pytest.raises(NoEstimateError, match=r"0\.01 at most is allowed"):
        Learned(KNOWN, specimen.rest, settings=strict).update(tracks)
    vague = LearnedSettings(vague_share=0.0, vague=0.0)
    with pytest.raises(NoEstimateError, match="leave ΣFn open"):
        Learned(KNOWN, specimen.rest, settings=vague).update(tracks)


def errors(fields: list[ForceField], truth: Snapshots) -> tuple[np.ndarray, np.ndarray]:
    """Errors of ΣFn, ΣFf and µ, and the deviations stated, each (S, 3)."""
    found, stated = [], []
    for field in fields:
        reading = field.friction_reading
        assert reading is not None
        found.append((field.total_normal, field.total_friction, reading.value))
        variances = (*np.diag(field.totals_covariance), reading.deviation**2)
        stated.append(np.sqrt(variances))
    return np.array(found) - abs(truth.totals), np.array(stated)


def test_forces_of_unseen_presses_on_a_specimen_of_its_own(
    learned: Learned, specimen: Specimen, unseen: Snapshots
) -> None:
    """Better than the mean by ten and more, on markers 80 µm off the places trained with."""
    fields = [learned.update(specimen.tracks(s, 1.0, k)) for k, s in enumerate(unseen.displacement)]
    error, stated = errors(fields, unseen)
    normal, friction, mu = np.sqrt((error**2).mean(axis=0))
    assert normal < 0.08 * unseen.totals[:, 0].mean()
    assert friction < 0.05
    # The friction law is one of many: µ is read less sharply than with a law that is known.
    assert mu < min(0.09, 0.45 * unseen.totals[:, 2].std())
    covered = (abs(error) < 1.645 * stated).mean(axis=0)
    assert (covered > 0.8).all()
    # The interval of ΣFn is too wide on a specimen as designed: it spans those that are not.
    assert (covered[1:] < 0.98).all()
    signs = [np.sign(f.friction[f.contact].sum()) for f in fields]
    loaded = abs(unseen.totals[:, 1]) > 0.2
    assert np.array_equal(np.array(signs)[loaded], np.sign(unseen.totals[loaded, 1]))


def test_nodal_forces_lie_where_the_contact_is(
    learned: Learned, specimen: Specimen, unseen: Snapshots
) -> None:
    x = TIP.rest_positions()[:, 0]
    for k in range(0, len(unseen.displacement), 10):
        field = learned.update(specimen.tracks(unseen.displacement[k], 1.0, k))
        true = unseen.normal[k]
        middle = np.average(x, weights=true)
        width = np.sqrt(np.average((x - middle) ** 2, weights=true))
        found = np.average(x, weights=field.normal)
        assert found == pytest.approx(middle, abs=0.3e-3)
        # No place is told more finely than the middle.
        assert np.sqrt(np.average((x - found) ** 2, weights=field.normal)) == pytest.approx(
            width, rel=0.25, abs=0.3e-3
        )
        assert (field.normal >= 0.0).all()


def test_lost_pairs_widen_the_interval_and_do_not_bend_the_field(
    learned: Learned, specimen: Specimen, unseen: Snapshots
) -> None:
    full = specimen.tracks(unseen.displacement[5], 0.0001, 1)
    full = replace(full, covariance=specimen.tracks(unseen.displacement[5], 1.0, 1).covariance)
    lost = full.visible.copy()
    lost[:, np.random.default_rng(0).random(specimen.pairs) < 0.5] = False
    whole, part = learned.update(full), learned.update(replace(full, visible=lost))
    assert part.totals_covariance[0, 0] > 1.2 * whole.totals_covariance[0, 0]
    moved = abs(part.total_normal - whole.total_normal)
    assert moved < np.sqrt(part.totals_covariance[0, 0])
    few = np.zeros_like(lost)
    few[:, :59] = True
    with pytest.raises(NoEstimateError, match=r"^59 .* at least 60 "):
        learned.update(replace(full, visible=few))


def test_a_pair_that_is_not_where_it_was_found_is_as_good_as_lost(
    learned: Learned, specimen: Specimen, unseen: Snapshots
) -> None:
    tracks = specimen.tracks(unseen.displacement[8], 1.0, 4)
    thrown = tracks.position.copy()
    moved = np.linalg.norm(tracks.position[0] - specimen.rest.position[0], axis=-1)
    # Those in the contact draw all others with them.
    for pair in (30, *np.argsort(moved)[-12:]):
        thrown = tracks.position.copy()
        thrown[0, pair] += 10.0
        lost = tracks.visible.copy()
        lost[:, pair] = False
        a = learned.update(replace(tracks, position=thrown))
        b = learned.update(replace(tracks, visible=lost))
        assert a.total_normal == pytest.approx(b.total_normal, rel=1e-9)
        assert a.total_friction == pytest.approx(b.total_friction, rel=1e-9)


def test_sizes_that_tell_less_are_read_for_less(
    learned: Learned, specimen: Specimen, unseen: Snapshots
) -> None:
    """As if all had been so vague from the start; what is wrong with them then bends little."""
    tracks = specimen.tracks(press_of(unseen, 2.0), 1.0, 4)
    moved = np.linalg.norm(tracks.position[0] - specimen.rest.position[0], axis=-1)
    covariance = tracks.covariance.copy()
    covariance[np.argsort(moved)[-12:][:, None], [2, 5], [2, 5]] += 0.05**2
    vague = replace(tracks, covariance=covariance)
    later = learned.update(vague)
    fresh = Learned(KNOWN, specimen.rest).update(vague)
    sure = learned.update(tracks)
    little = 0.2 * np.sqrt(later.totals_covariance[0, 0])
    assert later.total_normal == pytest.approx(fresh.total_normal, abs=little)
    assert later.totals_covariance[0, 0] > sure.totals_covariance[0, 0]
    off = tracks.log_size.copy()
    off[:, np.argsort(moved)[-12:]] += 0.003
    bent = [learned.update(replace(t, log_size=off)).total_normal for t in (tracks, vague)]
    assert abs(bent[1] - later.total_normal) < 0.1 * abs(bent[0] - sure.total_normal)


def test_a_pair_of_doubtful_number_is_read_where_the_others_expect_it(
    learned: Learned, specimen: Specimen, unseen: Snapshots
) -> None:
    """Found right it is as good as certain; with its neighbour's place, as good as lost."""
    tracks = specimen.tracks(unseen.displacement[8], 1.0, 4)
    moved = np.linalg.norm(tracks.position[0] - specimen.rest.position[0], axis=-1)
    most = np.argsort(moved)[-6:]
    doubtful = np.zeros_like(tracks.visible)
    doubtful[0, most] = True
    certain = learned.update(tracks)
    right = learned.update(replace(tracks, ambiguous=doubtful))
    assert right.total_normal == pytest.approx(certain.total_normal, rel=1e-9)
    one = most[-1]
    apart = np.linalg.norm(tracks.position[0] - tracks.position[0, one], axis=-1)
    two = np.argsort(apart)[1]
    swapped = tracks.position.copy()
    swapped[:, [one, two]] = swapped[:, [two, one]]
    doubtful[0, [one, two]] = True
    wrong = learned.update(replace(tracks, position=swapped, ambiguous=doubtful))
    lost = tracks.visible.copy()
    lost[:, [one, two]] = False
    without = learned.update(replace(tracks, visible=lost))
    assert wrong.total_normal == pytest.approx(without.total_normal, rel=1e-9)


def test_what_no_press_does_is_refused(learned: Learned, specimen: Specimen) -> None:
    tracks = specimen.tracks(np.zeros((TIP.nodes, 2)), 1.0, 4)
    turned = tracks.position.copy()  # the camera has slipped round its axis
    turned[..., 1] += 0.02 * (turned[..., 0] - 320.0)
    with pytest.raises(NoEstimateError, match=r"χ² is \d+ a measurement, 9 at most"):
        learned.update(replace(tracks, position=turned))


def test_forces_scale_with_the_calibrated_stiffness(specimen: Specimen, unseen: Snapshots) -> None:
    """Springs 10 % stiffer, the same picture: forces 10 % higher, µ untouched."""
    stiff = replace(
        TIP,
        tissue_stiffness=1.1 * TIP.tissue_stiffness,
        membrane_stiffness=1.1 * TIP.membrane_stiffness,
    )
    readers = [Learned(replace(KNOWN, fingertip=tip), specimen.rest) for tip in (TIP, stiff)]
    tracks = specimen.tracks(unseen.displacement[3], 1.0, 2)
    a, b = (reader.update(tracks) for reader in readers)
    assert b.total_normal == pytest.approx(1.1 * a.total_normal, rel=1e-6)
    assert b.total_friction == pytest.approx(1.1 * a.total_friction, rel=1e-6)
    assert a.friction_reading is not None
    assert b.friction_reading is not None
    assert b.friction_reading.value == pytest.approx(a.friction_reading.value)


def test_standing_still_steadies_the_reading_and_a_change_is_followed_at_once(
    specimen: Specimen, unseen: Snapshots
) -> None:
    alone, steady = (Learned(KNOWN, specimen.rest, averaged=way) for way in (False, True))
    first, second = press_of(unseen, 2.0), press_of(unseen, 4.0)
    still = [specimen.tracks(first, 1.0, k) for k in range(30)]
    single = np.array([alone.update(t).total_normal for t in still])
    fields = [steady.update(t) for t in still]
    averaged = np.array([f.total_normal for f in fields])
    assert np.std(averaged[10:]) < 0.6 * np.std(single[10:])
    assert fields[-1].totals_covariance[0, 0] < fields[0].totals_covariance[0, 0]
    moved = specimen.tracks(second, 1.0, 99)
    a, b = steady.update(moved).total_normal, alone.update(moved).total_normal
    assert a == pytest.approx(b, rel=0.03)


def test_an_unloaded_sensor_touches_nothing(learned: Learned, specimen: Specimen) -> None:
    field = learned.update(specimen.tracks(np.zeros((TIP.nodes, 2)), 1.0, 7))
    assert field.total_normal < 0.06
    assert field.friction_reading is not None
    assert not field.friction_reading.observable


@pytest.mark.parametrize("mu", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("curvature", [0.0, 60.0])
def test_a_pure_press_does_not_show_friction(
    learned: Learned, specimen: Specimen, curvature: float, mu: float
) -> None:
    """Every ratio is ν = 0.4 there at most, whatever µ is (E7); under a load µ is seen."""
    obj = ContactObject(stiffness=300.0, friction=mu, curvature=curvature)
    pressed = equilibrium(TIP, obj, 2.0)
    loaded = equilibrium(TIP, obj, 2.0, 1.4 * mu)
    for state, shown in ((pressed, False), (loaded, True)):
        field = learned.update(specimen.tracks(state.deformation.seen, 1.0, 5))
        assert field.friction_reading is not None
        assert field.friction_reading.observable == shown
    assert field.friction_reading.value == pytest.approx(mu, abs=0.12)


@pytest.mark.parametrize("azimuth", [-70.0, -15.0, 40.0, 89.0])
def test_a_load_is_read_in_whatever_direction_it_acts(
    learned: Learned, specimen: Specimen, unseen: Snapshots, azimuth: float
) -> None:
    """The layout turned back and the picture turned on show the same load from another side."""
    turn = np.deg2rad(azimuth)
    other = Specimen(turned_by=turn)
    reader = Learned(KNOWN, other.rest)
    loaded = np.flatnonzero(abs(unseen.totals[:, 1]) > 0.3)[:8]
    errors_, directions = [], []
    for k in loaded:
        field = reader.update(other.tracks(unseen.displacement[k], 1.0, int(k)))
        assert field.plane is not None
        side = np.pi if field.friction[field.contact].sum() < 0.0 else 0.0
        true = turn + (np.pi if unseen.totals[k, 1] < 0.0 else 0.0)
        directions.append(np.angle(np.exp(1j * (field.plane.azimuth + side - true))))
        errors_.append(field.total_normal / unseen.totals[k, 0] - 1.0)
        errors_.append(field.total_friction / abs(unseen.totals[k, 1]) - 1.0)
        assert field.plane.out_of_plane < 0.1
    assert abs(np.rad2deg(directions)).max() < 3.0
    assert np.sqrt(np.mean(np.square(errors_))) < 0.15


def test_a_twist_is_noticed_and_is_no_friction(
    learned: Learned, specimen: Specimen, unseen: Snapshots
) -> None:
    k = int(np.flatnonzero(abs(unseen.totals[:, 1]) > 0.3)[0])
    straight = specimen.tracks(unseen.displacement[k], 1.0, 3)
    turn = np.deg2rad(3.0)
    off = specimen.rest.position - CENTRE
    # The skin turns about the axis, the yellow layer by half as much; the rim is held.
    share = np.exp(-((np.linalg.norm(off, axis=-1) / 90.0) ** 2)) * np.array([1.0, 0.5])[:, None]
    across = turn * share[..., None] * np.stack([-off[..., 1], off[..., 0]], axis=-1)
    twisted = learned.update(replace(straight, position=straight.position + across))
    before = learned.update(straight)
    assert before.plane is not None
    assert twisted.plane is not None
    assert abs(before.plane.twist) < np.deg2rad(0.1)
    assert twisted.plane.twist == pytest.approx(turn, rel=0.5)
    deviation = np.sqrt(twisted.totals_covariance[1, 1])
    assert abs(twisted.total_friction - before.total_friction) < max(3.0 * deviation, 0.05)


def test_slope_of_a_network_is_its_derivative() -> None:
    network = load_readout(KNOWN.readout).totals  # type: ignore[arg-type]
    rng = np.random.default_rng(1)
    x = rng.standard_normal(len(network[0][0]))
    step = 1e-7 * rng.standard_normal(len(x))
    change = (forward(network, x + step) - forward(network, x - step)) / 2
    assert linearised(network, x)[1] @ step == pytest.approx(change, rel=1e-4, abs=1e-12)


def test_a_read_out_survives_its_file_and_nonsense_does_not(tmp_path: Path) -> None:
    before = load_readout(KNOWN.readout)  # type: ignore[arg-type]
    save_readout(before, tmp_path / "again.npz")
    after = load_readout(tmp_path / "again.npz")
    assert after.ranges == before.ranges
    assert after.fields == pytest.approx(before.fields)
    assert after.totals[0][0] == pytest.approx(before.totals[0][0])
    (tmp_path / "no.npz").write_text("nothing")
    with pytest.raises(UserError, match=r"no\.npz is not a trained read-out"):
        load_readout(tmp_path / "no.npz")
    with pytest.raises(UserError, match="train one"):
        Learned(SensorCalibration(sensor=SENSOR, fingertip=TIP), Specimen().rest)


def test_many_presses_show_what_each_shows() -> None:
    response = MarkerResponse(SENSOR, np.stack([SENSOR.places] * 2), TIP.angles())
    presses = 1e-4 * np.random.default_rng(3).standard_normal((3, TIP.nodes, 2))
    each = [response.measured(press) for press in presses]
    np.testing.assert_allclose(response.measured(presses), each, rtol=1e-12)
