"""Response of markers to a displacement of the chain, against differences and the renderer."""

import numpy as np
import pytest
from msgspec.structs import replace

from chromagrip.errors import UserError
from chromagrip.model import ContactObject, Fingertip, equilibrium
from chromagrip.render import Membrane, MembraneMap, load_sensor
from chromagrip.render.outlines import areas, centroids, outlines
from chromagrip.tracking.forces.chain.sensitivity import MarkerResponse

SENSOR = load_sensor("thesis")
TIP = Fingertip()
MAP = MembraneMap(SENSOR, TIP.nodes)


def test_response_is_the_derivative_of_the_prediction() -> None:
    places = np.stack([SENSOR.places[::7]] * 2)
    response = MarkerResponse(SENSOR, places, TIP.nodes)
    waves = np.stack([np.sin(k * (TIP.angles() + np.pi / 2)) for k in range(1, 6)], axis=1)
    rng = np.random.default_rng(8)
    seen = 1e-4 * waves @ rng.standard_normal((5, 2))
    case = 1e-4 * waves @ rng.standard_normal((5, 2))
    _, derivative = response(seen, case[:, :, None])
    none = np.empty((TIP.nodes, 2, 0))
    h = 1e-3
    slope = (response(seen + h * case, none)[0] - response(seen - h * case, none)[0]) / (2 * h)
    scale = np.abs(slope).max(axis=0)
    np.testing.assert_allclose(derivative[:, :, 0] / scale, slope / scale, atol=1e-5)


def test_prediction_is_what_the_renderer_was_given() -> None:
    """The response of the markers against the membrane: same pixels, same tilt of the discs."""
    places = np.stack([SENSOR.places] * 2)
    response = MarkerResponse(SENSOR, places, TIP.nodes)
    seen = equilibrium(TIP, ContactObject(), 3.0, 0.6).deformation.seen
    predicted, _ = response(seen, np.empty((TIP.nodes, 2, 0)))
    whole = response.measured(seen)
    np.testing.assert_allclose(response.measured(np.stack([0 * seen, seen]))[1], whole, rtol=1e-12)
    membrane = MAP(seen)
    view = SENSOR.view
    for layer in (0, 1):
        pixels = view.project(membrane.centres[layer])
        np.testing.assert_allclose(predicted[:, 3 * layer : 3 * layer + 2], pixels, atol=1e-9)
        shapes = view.jacobian(membrane.centres[layer]) @ membrane.axes[layer]
        middle = centroids(outlines(membrane, view), square=False)[layer]
        np.testing.assert_allclose(whole[:, 3 * layer : 3 * layer + 2], middle, atol=1e-5)
        area = np.linalg.det(shapes) / SENSOR.half_sizes[layer] ** 2
        np.testing.assert_allclose(predicted[:, 3 * layer + 2], 0.5 * np.log(area), atol=1e-9)


def test_ink_is_measured_as_it_is_drawn() -> None:
    """Of a load in any plane: against the membrane of the layout turned back, which is turned."""
    azimuth = 2.0
    ink = replace(SENSOR, markers=replace(SENSOR.markers, stretch=0.6, swell_mm=1.5))
    places = np.stack([SENSOR.places] * 2)
    seen = equilibrium(TIP, ContactObject(curvature=60.0), 3.0, 0.6).deformation.seen
    response = MarkerResponse(ink, places, TIP.nodes, azimuth)
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    drawn = MembraneMap(ink, TIP.nodes, places - [0.0, azimuth])(seen)
    turned = Membrane(centres=drawn.centres @ turn.T, axes=turn @ drawn.axes)
    image = outlines(turned, ink.view)
    log_size = 0.5 * np.log(areas(image, False))[..., None]
    expected = np.concatenate([centroids(image, False), log_size], axis=-1)
    whole = response.measured(seen)
    np.testing.assert_allclose(whole, np.concatenate(list(expected), axis=-1), atol=1e-4)
    with pytest.raises(UserError, match="stiff discs only"):
        response(seen, np.empty((TIP.nodes, 2, 0)))
