"""Tables that are wrong as a whole, which is said, and good ones, about which nothing is said."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.measure.score.points import Points, read_points
from chromagrip.measure.score.scores import Truth, score

WIDTH, HEIGHT, FRAMES = 640, 480, 20

Draw = np.random.Generator
#: What must be said, the axes that give x and y, and by what they are multiplied and moved.
Wrong = tuple[str, str, tuple[float, float], tuple[float, float]]
#: A term of the change that is said: factor, axis, sign, and what is added.
TERM = r"(-?|-?[\d.e+-]+ )([xy])(?: ([+-]) ([\d.]+))?"


def recording(draw: Draw, pressed: float) -> Points:
    """Crooked rows of points in two layers that a contact moves by so many pixels."""
    x, y = np.meshgrid(np.arange(60.0, 600.0, 60.0), np.arange(50.0, 440.0, 60.0))
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
    order = draw.permutation(len(true.names))
    mine = true.part(order)
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


def scaled(draw: Draw) -> Wrong:
    factor = draw.choice([draw.uniform(0.2, 0.8), 0.5, 2.0, draw.uniform(1.3, 4.0)])
    middle = draw.choice([0.0, 0.5])
    return "scaled", "xy", (factor, factor), (middle * factor - middle,) * 2


def millimetres(draw: Draw) -> Wrong:
    scale = draw.uniform(0.02, 0.08)
    return "scaled", "xy", (scale, scale), (-0.5 * WIDTH * scale, -0.5 * HEIGHT * scale)


def mirrored_y(draw: Draw) -> Wrong:
    return "mirrored in y", "xy", (1.0, -1.0), (0.0, draw.choice([0.0, HEIGHT - 1.0]))


def offset(draw: Draw) -> Wrong:
    by = draw.choice([-1.0, -0.5, 0.5, 1.0, draw.uniform(5.0, 80.0)])
    return "offset", "xy", (1.0, 1.0), (by, by)


RIGHT, BOTTOM = WIDTH - 1.0, HEIGHT - 1.0
#: Changes by a draw, and those that are always the same.
CHANGES = (
    scaled, millimetres, mirrored_y, offset,
    ("scaled", "xy", (256.0 / WIDTH, 256.0 / HEIGHT), (0.0, 0.0)),  # squeezed to TAP-Vid's size
    ("scaled", "xy", (1.0 / WIDTH, 1.0 / HEIGHT), (0.0, 0.0)),  # parts of the picture
    ("mirrored in x", "xy", (-1.0, 1.0), (RIGHT, 0.0)),
    ("mirrored in x and mirrored in y", "xy", (-1.0, -1.0), (RIGHT, BOTTOM)),
    ("exchanged", "yx", (1.0, 1.0), (0.0, 0.0)),
    ("exchanged and mirrored in x", "yx", (1.0, -1.0), (0.0, RIGHT)),
)  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("lost", [0.0, 0.1])
@pytest.mark.parametrize("change", CHANGES)
def test_places_that_are_wrong_as_a_whole_are_named(
    change: Callable[[Draw], Wrong] | Wrong, lost: float, seed: int
) -> None:
    """With the change that gives the true places again, which is the inverse of what was done."""
    draw = np.random.default_rng([seed, int(10 * lost)])
    true = recording(draw, draw.uniform(4.0, 20.0))
    mine = tracked(draw, true, draw.uniform(0.01, 0.07), lost)
    kind, order, factor, more = change(draw) if callable(change) else change
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


def later(points: Points, by: float = 0.0) -> Points:
    """Points with numbers of frames larger by one, and places larger by so many pixels."""
    nothing = np.zeros_like(points.visible[:1])
    return replace(
        points,
        position=np.concatenate([points.position[:1], points.position]) + by,
        visible=np.concatenate([nothing, points.visible]),
    )


def exchanged(points: Points) -> Points:
    """Points of the layer magenta as frames, and frames as points."""
    one = points.part(points.layers == "magenta")
    names = [("magenta", k) for k in range(FRAMES)]
    return Points(names=names, position=np.swapaxes(one.position, 0, 1), visible=one.visible.T)


def renumbered(points: Points, when: int) -> Points:
    """Points that have other numbers from a frame on."""
    before, after = points.visible.copy(), points.visible.copy()
    before[when:], after[:when] = False, False
    names = [*points.names, *((layer, 5000 + k) for layer, k in points.names)]
    position = np.concatenate([points.position] * 2, axis=1)
    return Points(names=names, position=position, visible=np.concatenate([before, after], axis=1))


@pytest.mark.parametrize("lost", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: replace(p, position=p.position - p.position[0]), "^most places are within .*"
         r" of \(0, 0\): displacements, or not .*$"),
        (later, "counted from one less"),
        (lambda p: replace(p, position=p.position[1:], visible=p.visible[1:]), "from one more"),
        (lambda p: later(p, 1.0), r"counted from one less.*\(x - 1, y - 1\)"),  # as MATLAB counts
        (exchanged, "points and frames seem to be exchanged"),
        (lambda p: renumbered(p, 5), "numbers change"),
        (lambda p: renumbered(p, 12), "numbers change"),
    ],
    ids=["displacements", "late", "early", "MATLAB", "exchanged", "renumbered", "renumbered late"],
)  # fmt: skip
def test_other_mistakes_of_a_whole_table_are_named(
    change: Callable[[Points], Points], words: str, seed: int, lost: float
) -> None:
    draw = np.random.default_rng([seed, int(10 * lost), 5])
    true = recording(draw, draw.uniform(8.0, 20.0))
    if change is exchanged:
        true = true.part(true.layers == "magenta")
    doubt = said(change(tracked(draw, true, 0.05, lost)), true)
    assert re.search(words, doubt), doubt


@pytest.mark.parametrize("seed", range(60))
def test_nothing_is_said_about_good_tables(seed: int) -> None:
    """With noise, bias, losses and hidden points, where much, little or nothing moves."""
    draw = np.random.default_rng([seed, 11])
    pressed = draw.choice([0.0, 1.0, 10.0, 40.0])
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


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_places_of_lost_points_are_named_and_scored_as_they_are(value: float) -> None:
    draw = np.random.default_rng(12)
    true = recording(draw, 10.0)
    mine = tracked(draw, true, 0.05, 0.0)
    gone = draw.random(mine.visible.shape) < 0.1
    filled = replace(mine, position=np.where(gone[..., None], value, mine.position))
    scored = score(filled, Truth(points=true))
    told = f"{gone.sum()} rows are at ({value:g}, {value:g}): leave the places of lost points empty"
    assert scored.doubt == told
    assert scored.scores["rms"] > 50.0
    halved = replace(filled, position=np.where(gone[..., None], value, 0.5 * mine.position))
    doubt = said(halved, true)
    assert "be scaled: as (2 x, 2 y)" in doubt
    assert doubt.endswith(told)


def test_a_table_of_other_wrong_places_is_not_explained() -> None:
    draw = np.random.default_rng(13)
    true = recording(draw, 10.0)
    mine = tracked(draw, true, 0.05, 0.0)
    assert said(replace(mine, position=draw.uniform(0, 480, mine.position.shape)), true) == ""
    far = replace(mine, position=mine.position + draw.uniform(3e3, 9e3, mine.position.shape))
    assert said(far, true) == "are the frames the same?"
    one_column = replace(mine, position=mine.position * (0.0, 1.0) + (60.0, 0.0))
    assert said(one_column, true) == ""
    still = replace(true, position=np.repeat(true.position[:1], FRAMES, axis=0))
    row = replace(still, position=still.position * (1.0, 0.0) + (0.0, 50.0)).part(np.arange(9))
    for noise in (0.0, 0.1):
        off = tracked(draw, row, noise, 0.0)
        assert said(replace(off, position=off.position + 0.7), row) == ""
    nothing = replace(mine, visible=np.zeros_like(mine.visible))
    assert said(nothing, true) == "are the frames the same?"
    few = [mine.part(np.arange(k)) for k in (1, 2, 3)]
    assert [said(replace(part, position=part.position + 0.5), true) for part in few] == [""] * 3


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_tables_in_utf_16_are_read(tmp_path: Path, encoding: str) -> None:
    mark = "" if encoding == "utf-16" else "\ufeff"
    path = tmp_path / "wide.csv"
    path.write_text(f"{mark}frame,id,x,y\n0,1,2.5,3\n1,1,4,5\n", encoding=encoding)
    assert read_points(path).position.tolist() == [[[2.5, 3.0]], [[4.0, 5.0]]]
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(UserError, match=r"wide.csv: it cannot be read: "):
        read_points(path)
