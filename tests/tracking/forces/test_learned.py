from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.model import ContactObject, equilibrium
from chromagrip.tracking import NoEstimateError, SensorCalibration, Tracks
from chromagrip.tracking.forces.chain.learned import Learned
from chromagrip.tracking.forces.chain.readout import forward, linearised, load_readout

from .drawn import KNOWN, SENSOR, TIP, Specimen

SPECIMEN = Specimen(scatter=80e-6)


def shown(normal: float, lateral: float = 0.0, seed: int = 5, friction: float = 0.9) -> Tracks:
    return SPECIMEN.tracks(pressed(normal, lateral, friction), 1.0, seed)


@cache
def pressed(normal: float, lateral: float, friction: float) -> np.ndarray:
    obj = ContactObject(stiffness=300.0, friction=friction)
    return equilibrium(TIP, obj, normal, lateral).deformation.seen


def test_springs_that_are_stiffer_need_more_force_and_the_same_friction() -> None:
    stiff = replace(
        TIP,
        tissue_stiffness=1.1 * TIP.tissue_stiffness,
        membrane_stiffness=1.1 * TIP.membrane_stiffness,
    )
    readers = [Learned(replace(KNOWN, fingertip=tip), SPECIMEN.rest) for tip in (TIP, stiff)]
    a, b = (reader.update(shown(2.0, 1.3)) for reader in readers)
    for field, factor in ((a, 1.0), (b, 1.1)):
        assert field.total_normal == pytest.approx(2.0 * factor, rel=0.08)
        assert field.total_friction == pytest.approx(1.3 * factor, abs=0.1)
        assert field.friction_reading is not None
        assert field.friction_reading.observable
        assert field.friction_reading.value == pytest.approx(0.9, abs=0.12)
    assert b.total_normal == pytest.approx(1.1 * a.total_normal, rel=1e-6)


def test_a_pure_press_shows_no_friction_and_a_slipped_camera_and_few_pairs_are_refused() -> None:
    learned, press = Learned(KNOWN, SPECIMEN.rest, averaged=False), shown(2.0, friction=0.3)
    whole = learned.update(press)
    assert whole.friction_reading is not None
    assert not whole.friction_reading.observable
    lost = press.visible & (np.arange(SPECIMEN.pairs) % 2 == 0)
    part = learned.update(replace(press, visible=lost))
    assert part.totals_covariance[0, 0] > 1.2 * whole.totals_covariance[0, 0]
    lost[:, 118:] = False
    with pytest.raises(NoEstimateError, match=r"^59 .* at least 60 "):
        learned.update(replace(press, visible=lost))
    turned = SPECIMEN.tracks(np.zeros((TIP.nodes, 2)), 1.0, 4)
    turned.position[..., 1] += 0.02 * (turned.position[..., 0] - 320.0)
    with pytest.raises(NoEstimateError, match=r"χ² is \d+ a measurement, 9 at most"):
        learned.update(turned)
    with pytest.raises(UserError, match="train one"):
        Learned(SensorCalibration(sensor=SENSOR, fingertip=TIP), SPECIMEN.rest)


def test_slope_of_a_network_is_its_derivative() -> None:
    network = load_readout(KNOWN.readout).totals  # type: ignore[arg-type]
    rng = np.random.default_rng(1)
    x = rng.standard_normal(len(network[0][0]))
    step = 1e-7 * rng.standard_normal(len(x))
    change = (forward(network, x + step) - forward(network, x - step)) / 2
    assert linearised(network, x)[1] @ step == pytest.approx(change, rel=1e-4, abs=1e-12)
