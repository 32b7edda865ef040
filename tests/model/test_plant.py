import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromagrip import model

TIP = model.Fingertip()


def settle(
    obj: model.ContactObject, grip: float, load: float
) -> tuple[model.State, model.ForceField]:
    """Press for 0.12 s, the first 20 ms in small steps, as friction remembers how contact grew.

    Then load for 1.5 s.
    """
    early = model.steps(
        TIP, obj, model.rest_state(TIP), 2e-5, np.tile([grip, 0.0], (1000, 1))
    ).state(-1)
    forces = np.array([[grip, 0.0]] * 20 + [[grip, load]] * 300)
    state = model.steps(TIP, obj, early, 5e-3, forces).state(-1)
    return state, model.contact_forces(TIP, obj, state)


@pytest.mark.parametrize(("mu", "first"), [(0.3, 0.298), (0.5, 0.388), (0.7, 0.398)])
def test_friction_estimate_before_and_after_a_load(mu: float, first: float) -> None:
    """Fig. 10 of the thesis: on first contact at most ν, exact after a load of 0.1 N."""
    obj = model.ContactObject(friction=mu)

    def largest_ratio(load: float) -> float:
        _, field = settle(obj, 1.0, load)
        return float(
            (np.abs(field.friction) / np.maximum(field.normal, 1e-12))[field.contact].max()
        )

    assert largest_ratio(0.0) == pytest.approx(first, abs=0.015)
    assert largest_ratio(0.1) == pytest.approx(mu, abs=0.002)


def test_steps_in_one_go_are_the_steps_one_by_one() -> None:
    """Bit by bit, sliding too; and so are the nodes that touch, and slip."""
    tip, obj = model.Fingertip(nodes=101), model.ContactObject(friction=0.3, curvature=100.0)
    forces = np.column_stack([np.linspace(0.2, 1.0, 40), np.linspace(-0.1, 3.0, 40)])
    state, slip = model.rest_state(tip), model.no_slip(tip.nodes)
    run = model.steps(tip, obj, state, 2e-3, forces)
    slips = model.follow_slip(slip, run, model.touching(tip, obj, run), 2e-3)
    for k, (grip, load) in enumerate(forces.tolist()):
        state = model.step(tip, obj, state, 2e-3, grip, load)
        alone = run.state(k + 1)
        assert (state.deformation.nodes == alone.deformation.nodes).all()
        assert state.deformation.object_position == alone.deformation.object_position
        assert (state.friction == alone.friction).all()
        field = model.contact_forces(tip, obj, state)
        assert (model.touching(tip, obj, run)[k + 1] == field.contact).all()
        # Slip by its definition: the node of the contact that moved least against the object.
        rates = abs(state.slip_rate[field.contact])
        moved = slips[k].rigid_slip - (slips[k - 1].rigid_slip if k else 0.0)
        assert moved == pytest.approx(rates.min() * 2e-3 if rates.size else 0.0, abs=1e-15)
    assert slips[-1].rigid_slip > 1e-4


@settings(max_examples=12)
@given(
    st.lists(
        st.tuples(st.floats(0.0, 10.0), st.floats(-3.0, 3.0), st.sampled_from([1e-4, 1e-3, 1e-2])),
        min_size=5,
        max_size=15,
    ),
    st.sampled_from([80.0, 160.0, 1000.0]),
    st.sampled_from([0.0, 50.0, 200.0]),
    st.floats(0.2, 0.9),
)
def test_any_history_stays_finite_and_in_the_cone(
    history: list[tuple[float, float, float]], stiffness: float, curvature: float, mu: float
) -> None:
    tip = model.Fingertip(nodes=101)
    obj = model.ContactObject(stiffness=stiffness, curvature=curvature, friction=mu)
    state = model.rest_state(tip)
    for grip, load, dt in history:
        try:
            state = model.step(tip, obj, state, dt, grip, load)
        except (model.LostContactError, model.PiercedError):
            return  # let go, or too much for a soft and sharp object: said, not computed
        field = model.contact_forces(tip, obj, state)
        assert np.isfinite(state.deformation.nodes).all()
        assert (np.abs(field.friction) <= mu * field.normal + 1e-9).all()


@pytest.mark.parametrize(
    ("grip", "kpa", "load", "margin"), [(5.0, 200, 0.25, 0.90), (5.0, 200, 0.65, 0.74)]
)
def test_conservative_margins(grip: float, kpa: float, load: float, margin: float) -> None:
    obj = model.ContactObject(stiffness=model.stiffness_from_young(kpa * 1e3))
    _, field = settle(obj, grip, load)
    assert field.safety_margin(0.5) == pytest.approx(margin, abs=0.005)
