"""What can go wrong in a run of the model, each naming where and with which values."""


class ModelError(RuntimeError):
    """A run of the model that cannot go on."""


class ConvergenceError(ModelError):
    """An implicit step did not converge even after halving it."""


class LostContactError(ModelError):
    """A load on an object that nothing touches."""


class PiercedError(ModelError):
    """A fingertip that went through its object: penalty contact holds only so much."""


class NoEquilibriumError(ModelError):
    """A load that friction cannot hold: the object slides for ever."""


class DivergedError(ModelError):
    """An explicit run grew without bound.

    Attributes
    ----------
    step: index of the step after which the state was lost
    limit: largest stable step predicted by linear theory [s]
    """

    def __init__(self, method: str, step: int, dt: float, limit: float) -> None:
        super().__init__(
            f"{method} diverged at step {step} with dt = {dt:.3g} s; linear theory predicts "
            f"stability up to {limit:.3g} s"
        )
        self.step = step
        self.limit = limit
