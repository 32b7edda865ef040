"""Comparison of a sequence's columns with physical laws, and the laws that hold for any body."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...loop.sample import Sample
from ...model import GROSS_SLIP, ForceField, SoftBody
from ...render import Defects, Flaws, Membrane, load_sensor, marker_truth
from ...scene.scene import Scene
from ...sensing.camera import map_of
from .columns import Column
from .shot import marker_labels

Array = NDArray[np.float64]
#: Columns by name: values of every frame, shape (T,), (T, 2M), (T, M) or (T, N).
Table = dict[str, NDArray[Any]]


@dataclass(frozen=True, kw_only=True)
class Stored:
    """Stored labels of a sequence.

    Attributes
    ----------
    scene: scene of the sequence
    frames, markers: columns of `frames.parquet` and of `markers.parquet`
    again: samples of the scene simulated again
    """

    scene: Scene
    frames: Table
    markers: Table
    again: list[Sample]

    @property
    def times(self) -> Array:
        """Times of the frames by the frame rate [s], shape (T,)."""
        return np.asarray(np.arange(self.scene.frames) * self.scene.period, np.float64)

    @property
    def drive(self) -> Array:
        """Load and grip of the scene simulated again [N], shape (T, 2)."""
        return np.array([(sample.load, sample.applied) for sample in self.again])

    def vectors(self, name: str) -> Array:
        """Stack the columns of x, y and z, from a name with {} for the axis, shape (T, …, 3)."""
        table = self.markers if name.format("x") in self.markers else self.frames
        return np.stack([table[name.format(axis)].astype(float) for axis in "xyz"], axis=-1)


def missing(columns: dict[str, Column], stored: Table) -> Iterator[str]:
    """Yield messages on columns with NaN or infinite values that must be finite."""
    for name, column in columns.items():
        if stored[name].dtype.kind == "f" and not column.missing:
            for at in np.argwhere(~np.isfinite(stored[name]))[:1]:
                yield f"{_cell(name, at)} is {stored[name][tuple(at)]}, and must be a finite number"


def differences(columns: dict[str, Column], stored: Table, lawful: Table) -> Iterator[str]:
    """Yield a message on each column that violates its law, with the first such cell.

    Parameters
    ----------
    columns: columns to compare
    stored: stored values
    lawful: values by the laws
    """
    # Words, flags and counts follow from numbers, which are named first.
    for name in sorted(columns, key=lambda name: stored[name].dtype.kind != "f"):
        column, values, law = columns[name], stored[name], lawful[name]
        if values.dtype.kind == "f":
            sizes = abs(law[np.isfinite(law)])
            slack = column.tolerance + column.share * float(sizes.max(initial=0.0))
            near = abs(values.astype(float) - law) <= slack
            off = ~(near | (np.isnan(values) & np.isnan(law)))
        else:
            off = values != law
        for at in np.argwhere(off)[:1]:
            one, other = (_shown(array[tuple(at)]) for array in (values, law))
            yield f"{_cell(name, at)} is {one}, and {other} by {column.law}"


def _cell(name: str, at: NDArray[np.intp]) -> str:
    """Name of a cell: frame, column, and index in a list if it is in one."""
    return f"frame {at[0]}: {name}" + "".join(f"[{number}]" for number in at[1:])


def _shown(value: Any) -> str:
    """Format a value for a message."""
    return f"{value:.6g}" if isinstance(value, float | np.floating) else str(value)


def lawful_frames(stored: Stored, fields: list[ForceField], slips: NDArray[np.bool_]) -> Table:
    """Compute the values that the laws demand of the frame columns of any body.

    `lateral_displacement_mm` needs every step of the simulation, and a dataset stores one per
    frame. So it is compared with the scene simulated again, as are the drive and the motion of the
    object. That takes 2 to 20 ms per frame, less than rendering. Everything else follows from the
    scene and other columns.

    Parameters
    ----------
    fields: contact forces of each frame, from the columns of its nodes
    slips: whether each node is in contact and slips, shape (T, N)
    """
    frames, again = stored.frames, stored.again
    mu = np.array([sample.contact.friction for sample in again])
    touching = np.array([field.contact for field in fields])
    count = touching.sum(axis=1)
    share = slips.sum(axis=1) / np.maximum(count, 1)
    moved = frames["lateral_displacement_mm"] > 1e3 * GROSS_SLIP * (1.0 - 1e-12)
    state = np.where(
        count == 0, "none", np.where(frames["slipped_share"] > 0, "incipient", "stick")
    )
    values = {
        "frame": np.arange(len(again)),
        "time_s": stored.times,
        "grip_n": np.array([sample.applied for sample in again]),
        "load_n": np.array([sample.load for sample in again]),
        "normal_n": np.array([field.total_normal for field in fields]),
        "friction_n": np.array([field.total_friction for field in fields]),
        "mu": mu,
        "margin": np.where(
            count > 0, 1.0 - frames["friction_n"] / (frames["mu"] * frames["normal_n"]), np.nan
        ),
        "slip_state": np.where(moved, "gross", state).astype(object),
        "slipped_share": share,
        "lateral_displacement_mm": 1e3
        * np.array([sample.contact.slip.lateral_displacement for sample in again]),
        "object_mm": 1e3 * np.array([sample.contact.place[0] for sample in again]),
        "rigid_part_mm": 1e3 * np.array([sample.contact.indentation for sample in again]),
        "contact_nodes": count,
    }
    return values


def impossible(frames: Table) -> Iterator[str]:
    """Yield a message on the first frame whose margin Γ is negative."""
    over = 1e-3  # Γ may be below 0 by this much in gross slip, where friction is found by iteration
    for k in np.flatnonzero(frames["margin"] < -over)[:1]:
        yield f"frame {k}: margin is {frames['margin'][k]:.3g}: friction holds more than it can"


def lawful_markers(stored: Stored, body: int | SoftBody, carried: list[Array]) -> Table:
    """Compute the values that the laws demand of the marker columns, from the motion of the skin.

    Parameters
    ----------
    body: number of nodes of a chain, or silicone body
    carried: input of the membrane map in each frame: displacements of a chain's nodes [m], (N, 2),
        or forces on the silicone [N], (N, 3)
    """
    scene, design = stored.scene, stored.scene.build_sensor()
    membrane = _specimen(scene.sensor, body, scene.defects, scene.seed)
    unloaded = marker_truth(design, membrane(np.zeros_like(carried[0])))
    # Rounding of what carries the skin: of places [m], and of forces that make them [N].
    rounded = 2e-9
    turn = np.random.default_rng(0).choice([-rounded, rounded], carried[0].shape)

    def labels(of: Array) -> list[dict[str, NDArray[Any]]]:
        truths = [
            marker_truth(design, membrane(of + by * (of != 0.0))) for by in (0.0, turn, -turn)
        ]
        return [marker_labels(truth, unloaded) for truth in truths]

    rows = []
    times = 4.0  # it may be so much further than this moves a marker
    for k, one in enumerate(carried):
        exact, *near = labels(one)
        for name, values in exact.items():
            told = stored.markers[name][k]
            # A marker seen from its side, or at the border, is where rounding puts it.
            open_to = times * np.ptp([one[name].astype(float) for one in (exact, *near)], axis=0)
            within = np.clip(told, values - open_to, values + open_to)
            exact[name] = np.where((open_to > 0.0) & np.isfinite(told), within, values)
            exact[name] = exact[name].astype(values.dtype)
        rows.append(exact)
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


@lru_cache(maxsize=1)
def _specimen(
    sensor: str, body: int | SoftBody, defects: Defects, seed: int
) -> Callable[[Array], Membrane]:
    """Membrane map of a specimen: the sensor with its manufacturing defects."""
    design = load_sensor(sensor)
    flaws = Flaws(design, defects, seed)
    mapped = map_of(design, body, flaws.places)
    return lambda carried: flaws(mapped(carried))
