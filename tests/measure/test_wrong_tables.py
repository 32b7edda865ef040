"""Tables that are wrong as a whole, which is said, and good ones, about which nothing is said."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.measure.score.points import Points
from chromagrip.measure.score.scores import Truth, score

WIDTH, HEIGHT, FRAMES = 640, 480, 5
RIGHT, BOTTOM = WIDTH - 1.0, HEIGHT - 1.0
Draw = np.random.Generator
#: A term of the change that is said: factor, axis, sign, and what is added.
TERM = r"(-?|-?[\d.e+-]+ )([xy])(?: ([+-]) ([\d.]+))?"


def recording(draw: Draw, pressed: float) -> Points:
    """Crooked rows of points in two layers that a contact moves by so many pixels."""
    x, y = np.meshgrid(np.arange(60.0, 600.0, 90.0), np.arange(50.0, 440.0, 90.0))
    rest = np.stack([x.ravel(), y.ravel()], axis=-1) + draw.uniform(-6.0, 6.0, (x.size, 2))
    rest = np.concatenate([rest, rest + draw.uniform(-1.0, 1.0, rest.shape)])
    middle, aside = draw.uniform((200, 150), (440, 330)), draw.normal(0.0, 1.0, 2)
    away = rest - middle
    bump = np.exp(-((np.linalg.norm(away, axis=1, keepdims=True) / 150.0) ** 2))
    grown = np.sin(np.linspace(0.0, 2.0, FRAMES))[:, None, None] ** 2
    position = rest + pressed * grown * bump * (away / 150.0 + aside)
    names = [(layer, k) for layer in ("magenta", "yellow") for k in range(x.size)]
    return Points(names=names, position=position, visible=np.ones(position.shape[:2], bool))


def tracked(draw: Draw, true: Points, noise: float, lost: float) -> Points:
    """What a good tracker gives, under numbers of its own."""
    mine = true.part(draw.permutation(len(true.names)))
    position = mine.position + draw.normal(0.0, noise, mine.position.shape)
    names = [(layer, 1000 + k) for k, (layer, _) in enumerate(mine.names)]
    visible = mine.visible & (draw.random(mine.visible.shape) >= lost)
    return Points(names=names, position=position, visible=visible)


def said(points: Points, true: Points) -> str:
    try:
        return score(points, Truth(points=true)).doubt
    except UserError as error:
        words = str(error).removeprefix("none of the tracked points is where a point of the truth ")
        return words.removeprefix("is: ")


@pytest.mark.parametrize(
    ("kind", "order", "factor", "more"),
    [
        ("scaled", "xy", (0.5, 0.5), (-0.25, -0.25)),
        ("scaled", "xy", (256.0 / WIDTH, 256.0 / HEIGHT), (0.0, 0.0)),  # TAP-Vid's size
        ("scaled", "xy", (1.0 / WIDTH, 1.0 / HEIGHT), (0.0, 0.0)),  # parts of the picture
        ("offset", "xy", (1.0, 1.0), (0.5, 0.5)),
        ("mirrored in x and mirrored in y", "xy", (-1.0, -1.0), (RIGHT, BOTTOM)),
        ("exchanged and mirrored in x", "yx", (1.0, -1.0), (0.0, RIGHT)),
    ],
)
def test_places_that_are_wrong_as_a_whole_are_named(
    kind: str, order: str, factor: tuple[float, float], more: tuple[float, float]
) -> None:
    """With the change that gives the true places again, which is the inverse of what was done."""
    draw = np.random.default_rng([1, len(kind)])
    true = recording(draw, draw.uniform(4.0, 20.0))
    mine = tracked(draw, true, draw.uniform(0.01, 0.07), 0.1)
    places = mine.position if order == "xy" else mine.position[..., ::-1]
    doubt = said(replace(mine, position=places * factor + more), true)
    found = re.fullmatch(
        rf"the places seem to be {kind}: as \({TERM}, {TERM}\), \d+ sampled places have a median "
        r"error of 0\.\d+ px, as they are \d+ places [\d.]+ px",
        doubt,
    )
    assert found, doubt
    terms = (found.groups()[:4], found.groups()[4:8])
    for (own, axis, sign, add), (k, wanted) in zip(terms, enumerate(order), strict=True):
        there = order.index("xy"[k])
        assert axis == wanted, doubt
        assert float({"": 1, "-": -1}.get(own.strip(), own)) == pytest.approx(
            1.0 / factor[there], rel=2e-3
        ), doubt
        value = float(f"{sign or '+'}{add or 0}".replace(" ", ""))
        assert value == pytest.approx(-more[there] / factor[there], abs=0.2), doubt


def later(points: Points) -> Points:
    """Points with numbers of frames larger by one, and places larger by a pixel."""
    nothing = np.zeros_like(points.visible[:1])
    position = np.concatenate([points.position[:1], points.position]) + 1.0
    visible = np.concatenate([nothing, points.visible])
    return replace(points, position=position, visible=visible)


def exchanged(points: Points) -> Points:
    """Points of one layer as frames, and frames as points."""
    names = [("magenta", k) for k in range(FRAMES)]
    return Points(names=names, position=points.position.swapaxes(0, 1), visible=points.visible.T)


def renumbered(points: Points) -> Points:
    """Points that have other numbers from a frame on."""
    before, after = points.visible.copy(), points.visible.copy()
    before[3:], after[:3] = False, False
    names = [*points.names, *((layer, 5000 + k) for layer, k in points.names)]
    position = np.concatenate([points.position] * 2, axis=1)
    return Points(names=names, position=position, visible=np.concatenate([before, after], axis=1))


def zeroed(points: Points) -> Points:
    gone = np.random.default_rng(3).random(points.visible.shape) < 0.1
    return replace(points, position=np.where(gone[..., None], 0.0, points.position))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: replace(p, position=p.position - p.position[0]), "^most places are within .*"
         r" of \(0, 0\): displacements, or not .*$"),
        (lambda p: replace(p, position=p.position[1:], visible=p.visible[1:]), "from one more"),
        (later, r"counted from one less.*\(x - 1, y - 1\)"),  # as MATLAB counts
        (exchanged, "points and frames seem to be exchanged"),
        (renumbered, "numbers change"),
        (zeroed, r"\d+ rows are at \(0, 0\): leave the places of lost points empty$"),
        (lambda p: replace(p, visible=p.visible & False), r"^are the frames the same\?$"),
        (lambda p: p.part(np.arange(3)), "^$"),  # too few to tell
    ],
)  # fmt: skip
def test_other_mistakes_of_a_whole_table_are_named(
    change: Callable[[Points], Points], words: str
) -> None:
    draw = np.random.default_rng(5)
    true = recording(draw, 12.0)
    if change is exchanged:
        true = true.part(true.layers == "magenta")
    doubt = said(change(tracked(draw, true, 0.05, 0.0)), true)
    assert re.search(words, doubt), doubt


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_said_about_good_tables(seed: int) -> None:
    """With noise, bias, losses and hidden points, where much, little or nothing moves."""
    draw = np.random.default_rng([seed, 11])
    pressed = (0.0, 1.0, 10.0, 40.0)[seed % 4]
    true = recording(draw, pressed)
    hidden = draw.random(true.visible.shape) < draw.choice([0.0, 0.1])
    hidden[-1] |= pressed >= 10.0
    true = replace(true, visible=~hidden)
    if seed % 2:
        true = true.part(true.layers == "yellow")
    mine = tracked(draw, true, draw.uniform(0.05, 0.3), draw.choice([0.0, 0.1]))
    mine.visible[0] &= pressed < 10.0  # a frame more is matched if they are shifted
    biased = replace(mine, position=mine.position + draw.uniform(-0.1, 0.1, 2))
    assert said(biased, true) == ""


def test_a_row_has_no_scale_across() -> None:
    draw = np.random.default_rng(13)
    true = recording(draw, 0.0)
    row = replace(true, position=true.position * (1.0, 0.0) + (0.0, 50.0)).part(np.arange(9))
    off = tracked(draw, row, 0.1, 0.0)
    assert said(replace(off, position=off.position + 0.7), row) == ""
