"""Response of markers to a displacement of the chain, against differences and the renderer."""

import numpy as np

from chromagrip.model import ContactObject, Fingertip, rest_state, step
from chromagrip.render import MembraneMap, load_sensor
from chromagrip.render.outlines import centroids, outlines
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
    obj, state = ContactObject(), rest_state(TIP)
    for _ in range(40):
        state = step(TIP, obj, state, 5e-3, 3.0, 0.6)
    predicted, _ = response(state.deformation.seen, np.empty((TIP.nodes, 2, 0)))
    whole = response.measured(state.deformation.seen)
    membrane = MAP(state.deformation.seen)
    view = SENSOR.view
    for layer in (0, 1):
        pixels = view.project(membrane.centres[layer])
        np.testing.assert_allclose(predicted[:, 3 * layer : 3 * layer + 2], pixels, atol=1e-9)
        shapes = view.jacobian(membrane.centres[layer]) @ membrane.axes[layer]
        middle = centroids(outlines(membrane, view), square=False)[layer]
        np.testing.assert_allclose(whole[:, 3 * layer : 3 * layer + 2], middle, atol=1e-5)
        area = np.linalg.det(shapes) / SENSOR.half_sizes[layer] ** 2
        np.testing.assert_allclose(predicted[:, 3 * layer + 2], 0.5 * np.log(area), atol=1e-9)
