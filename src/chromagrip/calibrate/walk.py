"""A walk from a camera on the table to a calibration, and to the errors to expect of it.

It takes frames of the unloaded sensor, of some presses and of a check press, fits the calibration,
reads the check press with it, and simulates grips at the camera's rate and noise. What was taken is
in the folder at once, and an interrupted walk goes on from there.
"""

import itertools
import json
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
import tomli_w
from numpy.typing import NDArray

from ..errors import UserError
from ..folders import LOCK, filling, make_folder, write_whole
from ..output.png import encode_png
from ..output.versions import versions
from ..pictures.still_frames import judge_press, judge_rest, judge_return
from ..render import Frame, SensorDesign, load_camera, load_sensor, save_camera
from ..sensing.reader import Reader
from ..sources import Source, open_source
from ..sources.picture_files import read_picture
from ..tracking import Z90, SensorCalibration
from ..tracking.forces import SILICONE_ERROR, body_read, nominal_calibration
from .expected_errors import expected_errors
from .presses import LIST, Press, read_list, write_list
from .sensor import calibrate_sensor, save_calibration

Use = TypeVar("Use")

#: Results of a walk in its folder.
CALIBRATION, SUMMARY = "calibration.toml", "summary.json"
_CHECK, _CHECKED = "check.png", "check.csv"
_LENS, _DESIGN = "lens.yml", "sensor.toml"
#: Frames of a step, and those before them that a camera may have kept since the last one.
_TAKEN, _OLD = 8, 8
#: Newtons of each unit of a scale.
_UNITS = {"n": 1.0, "kg": 9.81, "g": 9.81e-3}
_NUMBER = r"([-+]?\d+(?:[.,]\d+)?)\s*(kg|n|g)?"


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a walk takes, and how it is judged.

    Attributes
    ----------
    presses: number of presses for the fit
    forces: lowest and highest force that is asked for [N]
    scale_error: standard deviation of the scale, as a share of its reading
    """

    presses: int = 6
    forces: tuple[float, float] = (0.5, 5.0)
    scale_error: float = 0.02


def walk(
    source: Source | str,
    out: Path,
    *,
    sensor: str,
    ask: Callable[[str], str],
    tell: Callable[[str], None],
    lens: Path | None = None,
    camera_model: str | None = None,
    fps: float | None = None,
    plan: Plan = Plan(),
) -> dict[str, Any]:
    """Calibrate the dome of silicone before a camera, step by step.

    It is a go if a force lies both in the 90 % interval of ΣFn of the check press and within twice
    the scale's error of what the scale read. A factor by which the scale is always wrong is not
    noticed: all forces are then wrong by it.

    Parameters
    ----------
    source: live source of frames, open or by its name
    out: folder of all files; one of an unfinished walk is continued
    sensor: name or file of the design to start from
    ask: function called with a question, returns the answer; an `EOFError` ends the walk
    tell: function called with a sentence, on what is wrong or on the current step
    lens, camera_model: camera file in place of the design's lens; its model if it is open there
    fps: rate of a source that has none of its own [Hz]
    plan: presses to take

    Returns
    -------
    content of `summary.json`

    Raises
    ------
    UserError
        When a step cannot be done. What was taken before is kept.
    """
    source = _camera(source, fps)
    make_folder(out)
    with filling(out), _keeping(out, lens):
        name = sensor if lens is None else _with_lens(sensor, lens, camera_model, out)
        design = _silicone_design(name, sensor)
        bench = _Bench(source, design, ask, tell)
        bench.begin(out, plan.presses)
        forces = np.geomspace(*plan.forces, plan.presses).tolist()
        presses = _presses(bench, out / LIST, "press-{}.png", "Press {} of {}", forces)
        middle = [math.sqrt(math.prod(plan.forces))]
        check, *_ = _presses(bench, out / _CHECKED, _CHECK, "Check press", middle)
        calibration, report = calibrate_sensor(out, design, tell=tell)
        summary = _judged(bench, calibration, out / _CHECK, check, plan.scale_error)
        if summary["go"]:
            limits = presses[0].normal, presses[-1].normal
            summary["expected"] = expected_errors(
                calibration, rate=bench.rate, noise=bench.noise, forces=limits, tell=tell
            )
            summary["sentence"] += _to_expect(summary, limits)
            save_calibration(calibration, name, report, out / CALIBRATION, summary["sentence"])
        write_whole(out / SUMMARY, (json.dumps(summary, indent=2) + "\n").encode())
    return summary


def _camera(source: Source | str, fps: float | None) -> Source:
    """Open a source, and refuse one that was recorded."""
    source = open_source(source, fps) if isinstance(source, str) else source
    if source.count is not None:
        raise UserError(f"{source.name} was recorded; a walk needs a camera or a pipe")
    return source


def _silicone_design(name: str, sensor: str) -> SensorDesign:
    """Design of that name or file, which comes from `sensor`; refuse it if it is no such dome."""
    design = load_sensor(name)
    if body_read(nominal_calibration(design)) != "dome":
        raise UserError(
            f"sensor {sensor} is not read as a dome of silicone, as dome-2020 and dome-2022 are; "
            "for others there is `chromagrip calibrate sensor`"
        )
    return design


@contextmanager
def _keeping(out: Path, lens: Path | None) -> Iterator[None]:
    """Check a folder, and say in every later refusal how a walk goes on with it."""
    _check_folder(out, lens)
    try:
        yield
    except (UserError, EOFError) as error:
        why = "the answers ended" if isinstance(error, EOFError) else str(error)
        kept = f"; the same command goes on with what is in {out}; mend a wrong entry in its {LIST}"
        raise UserError(why + (kept if any(out.glob("*.png")) else "")) from None


def _check_folder(out: Path, lens: Path | None) -> None:
    """Refuse a folder that is no walk's, or of a finished one, or of one with a lens."""
    if (out / CALIBRATION).exists():
        raise UserError(f"folder {out} has a {CALIBRATION} already; choose another")
    there = {path.name for path in out.iterdir()} - {LOCK, _LENS, _DESIGN}
    rest = {name for name in there if name.startswith("rest")}
    if there and not (rest and rest <= {path.name for path in _rest_paths(out)}):
        raise UserError(f"folder {out} is not empty, and of no walk; choose another")
    if lens is None and (out / _LENS).exists():
        raise UserError(f"the walk of {out} began with a lens: give --lens {out / _LENS}")
    if (out / SUMMARY).exists():  # its check press was no go: another one is taken
        (out / _CHECKED).unlink(missing_ok=True)
        (out / SUMMARY).unlink()


def _rest_paths(out: Path) -> list[Path]:
    return [out / f"rest-{k}.png" for k in range(_TAKEN)]


def _with_lens(sensor: str, lens: Path, camera_model: str | None, out: Path) -> str:
    """File of the design with another lens, written beside our own file of the lens."""
    camera, design = load_camera(lens, model=camera_model), load_sensor(sensor)
    table = {k: v for k, v in msgspec.to_builtins(design).items() if v is not None}
    table["camera"] = {
        "calibration": _LENS,
        "width_px": camera.width,
        "height_px": camera.height,
        "position_mm": design.camera.position_mm,
        "blur_px": design.camera.blur_px,
    }
    if path := table["layout"].get("path"):
        table["layout"]["path"] = str(Path(path).resolve())
    save_camera(camera, out / _LENS)
    write_whole(out / _DESIGN, tomli_w.dumps(table).encode())
    return str(out / _DESIGN)


class _Bench:
    """A sensor before a camera, and somebody who answers questions.

    Attributes
    ----------
    rate: rate of the frames [Hz]
    still: frames of the unloaded sensor
    noise: standard deviation of a pixel [grey levels]
    """

    def __init__(
        self,
        source: Source,
        design: SensorDesign,
        ask: Callable[[str], str],
        tell: Callable[[str], None],
    ) -> None:
        self._source, self._frames, self._ask, self.tell = source, source.frames(), ask, tell
        self.design, self.rate = design, source.fps
        self.still, self.noise = list[Frame](), math.nan

    def asked(
        self, question: str, use: Callable[[str, list[Frame]], Use], count: int = _TAKEN
    ) -> Use:
        """Ask until an answer can be used with the frames after it, or there are none."""
        while True:
            answer, frames = self._ask(question).strip(), self._take(count)
            try:
                return use(answer, frames)
            except UserError as error:
                self.tell(str(error))

    def begin(self, out: Path, presses: int) -> None:
        """Take the frames of the unloaded sensor, or those of the folder."""
        paths = _rest_paths(out)

        def judged(_: str, frames: list[Frame]) -> None:
            self.still = frames
            self._markers, self.noise = judge_rest(frames, self.design)

        self._take(_TAKEN)  # a camera that cannot be used is refused before anybody has to act
        if all(path.is_file() for path in paths):
            self.tell(f"going on with what is in {out}")
            judged("", [Frame(image=read_picture(path), time=0.0) for path in paths])
            self.lifted()
        else:
            self.tell(
                f"have a scale, and a hard ball or a flat plate, for {presses} presses and a check "
                f"press; stop at any time: the same command goes on with what is in {out}"
            )
            self.asked("Let nothing touch the sensor, keep it still, and press Enter", judged)
            for path, frame in zip(paths, self.still, strict=True):
                write_whole(path, encode_png(frame.image))

    def lifted(self) -> None:
        """Wait until the markers are where they were at rest."""

        def judged(_: str, frames: list[Frame]) -> None:
            judge_return(self._markers, self.noise, frames)

        self.asked("Let nothing touch the sensor, and press Enter", judged)

    def pressed(self, question: str, force: float, last: float) -> tuple[Press, NDArray[np.uint8]]:
        """Take a press, and its picture; it has no name yet.

        Parameters
        ----------
        question: begin of the question
        force: force that is asked for [N]
        last: radius of the ball that pressed last [m]; 0 is a plate
        """
        usual, other = "a flat plate", "a ball in mm"
        if last:
            usual, other = f"the ball of {1e3 * last:g} mm", "another in mm, 0 for a flat plate"
        radius = self.asked(
            f"{question}. Press Enter for {usual}, or type the radius of {other}",
            lambda answer, _: _radius(answer) if answer else last,
            count=0,
        )

        def held(_: str, frames: list[Frame]) -> list[Frame]:
            judge_press(self._markers, self.noise, frames)
            return frames

        frames = self.asked(
            "Press, hold it still until the scale is asked for, and press Enter", held
        )
        normal, lateral = self.asked(
            "What does the scale read, in N, or as 50 g? With a pull: normal and lateral",
            lambda answer, _: _reading(answer, force),
            count=0,
        )
        mean = np.rint(np.mean([frame.image for frame in frames], axis=0)).astype(np.uint8)
        return Press(name="", normal=normal, lateral=lateral, radius=radius), mean

    def _take(self, count: int) -> list[Frame]:
        """Frames as they are now, of the size that the design's camera has."""
        frames = list(itertools.islice(self._frames, count and _OLD + count))[_OLD:]
        if len(frames) < count:
            raise UserError(f"{self._source.name} gives no more frames")
        wanted = self.design.camera.width_px, self.design.camera.height_px
        for frame in frames:
            if (size := frame.image.shape[1::-1]) != wanted:
                raise UserError(
                    f"{self._source.name} gives {size[0]}×{size[1]} pixels, the sensor's camera "
                    f"{wanted[0]}×{wanted[1]}: set that size, or give --lens"
                )
        period = np.median(np.diff([frame.time for frame in frames])) if frames else 0.0
        if period > 0.0:
            self.rate = float(1.0 / period)
        return frames


def _presses(bench: _Bench, path: Path, names: str, title: str, forces: list[float]) -> list[Press]:
    """Presses of a list, and as many more as forces are asked for; the lightest first."""
    presses = read_list(path)[0] if path.exists() else []
    for number, force in list(enumerate(forces, 1))[len(presses) :]:
        question = f"{title.format(number, len(forces))}: about {force:.2g} N"
        if number % 3 == 2:
            question += f", then pull it by {0.25 * force:.2g} N along the picture's x if you can"
        press, picture = bench.pressed(question, force, presses[-1].radius if presses else 0.0)
        used = {press.name for press in presses}
        name = next(n for k in itertools.count() if (n := names.format(k)) not in used)
        write_whole(path.parent / name, encode_png(picture))
        presses.append(replace(press, name=name))
        write_list(path, presses)
        bench.lifted()
    return sorted(presses, key=lambda press: press.normal)


def _radius(answer: str) -> float:
    """Radius of a ball that was typed in mm [m]."""
    found = re.fullmatch(r"(\d+(?:[.,]\d+)?)\s*(?:mm)?", answer)
    if not found:
        raise UserError(f"{answer!r} is no radius in mm; press Enter, or type one such as 8")
    return 1e-3 * float(found[1].replace(",", "."))


def _reading(answer: str, force: float) -> tuple[float, float]:
    """Normal and lateral force of a scale's reading [N]; `force` was asked for."""
    found = re.fullmatch(rf"{_NUMBER}(?:[\s,;]+{_NUMBER})?", answer, re.IGNORECASE)
    if found is None:
        raise UserError(f"{answer!r} is no reading; type a number, such as 2.1, or 2.1 0.4")
    number, unit, across, its_unit = found.groups()
    normal, lateral = (
        float((value or "0").replace(",", ".")) * _UNITS[(named or unit or "n").lower()]
        for value, named in ((number, unit), (across, its_unit))
    )
    if not normal > 0.0:
        raise UserError(f"{answer} is no press; zero the scale unloaded, and type what it reads")
    if unit is None and not 0.15 < normal / force < 8.0:  # grams and kilograms are beyond
        raise UserError(
            f"{answer} N is far from {force:.2g} N: type the reading with its unit, such as "
            f"{force:.2g} N or {force / _UNITS['g']:.0f} g"
        )
    if abs(lateral) > 0.9 * normal:
        raise UserError(f"a plate slips under {lateral:g} N with {normal:g} N; type normal first")
    return normal, lateral


def _judged(
    bench: _Bench, calibration: SensorCalibration, picture: Path, check: Press, scale_error: float
) -> dict[str, Any]:
    """Summary of a walk up to its check press: how it is read, and whether that is a go."""
    reader = Reader(calibration, bench.still, noise=bench.noise)
    reader.update(bench.still[0].image, 0.0)
    read = reader.update(read_picture(picture), 1.0).observation
    assert read is not None
    known, normal, off = check.normal, read.field.total_normal, 2.0 * scale_error
    ok, half = not read.no_estimate, Z90 * math.sqrt(read.field.totals_covariance[0, 0])
    low, high = max(normal - half, 0.0), normal + half
    go = ok and low <= (1.0 + off) * known and high >= (1.0 - off) * known
    words = f"as {normal:.2f} N ({low:.2f} to {high:.2f} N)" if ok else f"not: {read.no_estimate}"
    sentence = f"{'Go' if go else 'No go'}: the check press of {known:.2f} N is read {words}"
    if ok and not go:
        sentence += f"; an error of the scale of {off:.0%} does not explain it"
    if not go:
        sentence += (
            "; check scale and object, and give the same command for another check press, or "
            "another folder for other presses"
        )
    return {
        "format": "chromagrip walk 1",
        "go": go,
        "sentence": sentence,
        "rate_hz": bench.rate,
        "noise_levels": bench.noise,
        "check_n": known,
        "check_read_n": normal if ok else None,
        "check_interval_n": [low, high] if ok else None,
        "expected": None,
        "versions": versions(),
    }


def _to_expect(summary: dict[str, Any], forces: tuple[float, float]) -> str:
    """End of the sentence: the errors to expect of grips of these forces [N]."""
    errors = summary["expected"]
    if not errors["read"]:
        return "; no simulated grip could be read"
    return (
        f"; at {summary['rate_hz']:.3g} Hz and a noise of {summary['noise_levels']:.2g} levels "
        f"expect errors of {errors['normal_error']:.1%} of ΣFn and {errors['margin_error']:.2f} of "
        f"Γ (RMS of {errors['grips']} simulated grips of {forces[0]:.2g} to {forces[1]:.2g} N: "
        f"{errors['read']:.0%} of the frames are read, Γ of {errors['margin_inside']:.0%} of these "
        "is in its 90 % interval); real silicone is not quite as its model, which adds about "
        f"{SILICONE_ERROR:.0%} of ΣFn"
    )
