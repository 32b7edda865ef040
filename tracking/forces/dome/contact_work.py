"""Fits of a grasp's object beside the contact that is followed, spread over frames by a count."""

from dataclasses import dataclass, replace

from ....errors import UserError
from .contact_fit import ContactFit
from .contact_solution import Held, Solution
from .contact_starts import Start, other_objects
from .fitting import Fitting
from .key_shifts import Key, Shifts
from .keys import thinned
from .settings import ContactSettings


@dataclass(frozen=True, kw_only=True)
class Work:
    """Fits that are under way; the best solution is taken when it has caught up with the present.

    Attributes
    ----------
    held: solution when they began
    rival: whether they began from a rival of that solution, rather than from it
    doubtful: misfit of a solution above which other objects are tried
    fitting: present fit; None when all are over
    todo: starts of the next ones
    best: best solution so far
    since: shifts of the key frames since they began, which the best solution has not seen
    leap: last of these that it has seen, if its object is to be corrected next
    """

    held: Solution
    rival: bool
    doubtful: float
    fitting: Fitting | None = None
    todo: tuple[Start, ...] = ()
    best: Solution | None = None
    since: tuple[Shifts, ...] = ()
    leap: Held | None = None


def refit(fit: ContactFit, held: Solution, doubtful: float, settings: ContactSettings) -> Work:
    """Begin to refit the object of a solution along its whole way."""
    fitting = fit.begun(held.object_, held.keys, settings.refit_rounds)
    return Work(held=held, rival=False, doubtful=doubtful, fitting=fitting)


def rival(
    fit: ContactFit, held: Solution, start: Start, doubtful: float, settings: ContactSettings
) -> Work:
    """Begin to fit from a rival of a solution."""
    fitting = fit.begun(*start, settings.rival_rounds, rival_of=held)
    return Work(held=held, rival=True, doubtful=doubtful, fitting=fitting)


def others(fit: ContactFit, held: Solution, doubtful: float, settings: ContactSettings) -> Work:
    """Begin to fit other objects in place of a first solution that is doubtful."""
    todo = tuple(other_objects(fit.dome, held.object_, held.keys, settings.starts))
    work = Work(held=held, rival=False, doubtful=doubtful, todo=todo, best=held)
    return _next(fit, work, settings)


def advanced(fit: ContactFit, work: Work, calls: int, settings: ContactSettings) -> Work:
    """Work after about that number of solver calls."""
    while calls > 0 and work.fitting is not None:
        calls -= work.fitting.calls
        solution = None
        try:
            fitting = fit.advanced(work.fitting)
            if not fitting.done:
                work = replace(work, fitting=fitting)
                continue
            solution = fit.solution_of(fitting)
        except UserError:  # no solution from this start
            pass
        work = _over(fit, work, solution, settings)
    return work


def caught_up(fit: ContactFit, work: Work, settings: ContactSettings) -> Work:
    """Add the next key frame that the best solution has not seen to it, or correct its object.

    Raises
    ------
    UserError
        When the contact does not converge.
    """
    if work.leap is not None:
        leapt = fit.leap(work.leap)
        return replace(work, best=work.best if leapt is None else leapt, leap=None)
    best, shifts = work.best, work.since[0]
    assert best is not None
    now, _ = fit.follow(best.object_, fit.last_of(best), shifts)
    keys = thinned(fit.dome, (*best.keys, Key(shifts=shifts, pose=now.pose)), settings.keys)
    held = fit.hold(best, keys, now)
    leap = held if held.telling else None
    return replace(work, best=held.solution, since=work.since[1:], leap=leap)


def _over(
    fit: ContactFit, work: Work, solution: Solution | None, settings: ContactSettings
) -> Work:
    """Work after one of its fits, with that fit's solution, if it has one."""
    best, first = work.best, work.best is None
    if solution is not None and _is_better(work, solution):
        best = solution
    work = replace(work, best=best)
    poor = (work.held if best is None else best).misfit > work.doubtful
    if first and poor and not work.rival and not work.todo:
        todo = other_objects(fit.dome, work.held.object_, work.held.keys, settings.starts)
        work = replace(work, todo=tuple(todo), best=work.held if best is None else best)
    return _next(fit, work, settings)


def _is_better(work: Work, solution: Solution) -> bool:
    """Whether a solution is better than the best one so far, or the one that is held."""
    if work.best is not None or work.rival or work.held.misfit > work.doubtful:
        known = work.held.misfit if work.best is None else work.best.misfit
        return solution.misfit < known
    return solution.cost <= work.held.cost


def _next(fit: ContactFit, work: Work, settings: ContactSettings) -> Work:
    """Work with its next fit, or at its end."""
    if not work.todo:
        return replace(work, fitting=None)
    start, *todo = work.todo
    return replace(work, fitting=fit.begun(*start, settings.rounds), todo=tuple(todo))
