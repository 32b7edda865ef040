"""Recipes of datasets: values that all sequences share, and random draws of the others."""

import copy
import math
import os
from collections.abc import Callable, Collection
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar
from zlib import crc32

import msgspec
import numpy as np
import tomli_w
from msgspec import Meta
from msgspec.structs import replace

from ..by_name import as_in_file, with_allowed
from ..errors import UserError, meant
from ..loop.methods import reconstructor_for
from ..loop.poses.dome_poses import DomePose
from ..scene.scene import Body, Scene, parse_scene, relative
from ..strict_toml import Table, convert, parse_toml, read_toml
from ..tracking import DEFAULT_RECONSTRUCTOR, METHODS
from .draws import How, check_draw, draw, ends
from .labels import DOME_TRUTH

Truth = Literal["depth", "flow", "masks", "traction", "contact"]

#: Kinds of motion: forces drive all except a `move`, which goes to a pose, only on a dome.
MOTIONS = ("press", "grasp", "slip", "move")
#: Keys of a pose with the smallest and the largest value: depth over the silicone's thickness,
#: shear and its direction, turn, tilt and its direction, and turn before the press.
POSE = {
    "pose.press_share": (0.0, 0.8),
    "pose.shear_mm": (0.0, 20.0),
    "pose.shear_towards_deg": (-360.0, 360.0),
    "pose.twist_deg": (-360.0, 360.0),
    "pose.tilt_deg": (0.0, 90.0),
    "pose.tilt_towards_deg": (-360.0, 360.0),
    "pose.azimuth_deg": (-360.0, 360.0),
}
#: Key of the name of a sequence's case, among its drawn values.
CASE = "case"
#: Keys that no scene has: the case, kind of motion, grip [N], the load over µ·grip of a grasp and
#: of a slip, and the pose of a move.
OWN = (CASE, "motion", "grip_n", "share", "slip_share", *POSE)


#: Values of TOML tables: those of a scene, or drawn ones by key of a scene or in OWN.
Values = dict[str, Any]
#: Table with tables of a scene and draws.
Part = TypeVar("Part", "Case", "Recipe")
#: Folder of the shipped recipes.
SHIPPED = files(__package__) / "recipes"


class Case(Table, frozen=True):
    """Group of a dataset's sequences that share further values.

    Attributes
    ----------
    name: name of the case
    scene, draw: as in a recipe, whose values they extend and replace
    """

    name: Annotated[str, Meta(min_length=1)]
    scene: Values = msgspec.field(default_factory=dict)
    draw: dict[str, How] = msgspec.field(default_factory=dict)


class Recipe(Table, frozen=True):
    """Contents of a dataset.

    Attributes
    ----------
    description: one line of text
    sequences: number of sequences, unless the command line gives another
    seed: seed of all draws; sequence k depends only on it and k
    truth: labels of every pixel, kept in addition to those of markers and forces
    reading: reconstructor whose estimates from the pictures are kept with the labels; `auto` is the
        one for a sequence's body; empty: no estimates
    scene: tables of a scene, the same in every sequence
    draw: key of a scene, with dots, or in OWN → its draw: `{ uniform = [low, high] }`,
        `{ log_uniform = [low, high] }`, `{ normal = [mean, deviation, low, high] }` (drawn again
        outside of the bounds), `{ choice = [...] }`, or `{ each = [...] }`, in turn
    cases: groups of sequences; sequence k belongs to case k mod their number (default: no groups)
    """

    description: str = ""
    sequences: Annotated[int, Meta(ge=1, le=10_000_000)] = 100
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 0
    truth: tuple[Truth, ...] = ()
    reading: str = ""
    scene: Values = msgspec.field(default_factory=dict)
    draw: dict[str, How] = msgspec.field(default_factory=dict)
    cases: tuple[Case, ...] = ()


def recipe_names() -> list[str]:
    """Names of the shipped recipes."""
    return sorted(f.name.removesuffix(".toml") for f in SHIPPED.iterdir() if f.name[-5:] == ".toml")


def load_recipe(
    name: str | PathLike[str],
    meshes: str | PathLike[str] | None = None,
    *,
    allow: Collection[str] = (),
) -> Recipe:
    """Load a recipe by name or from a TOML file.

    Parameters
    ----------
    name: name of a shipped recipe, or path of a file that ends in `.toml`
    meshes: folder of meshes from which objects are drawn, instead of the recipe's
    allow: modules from which a `module:Class` in the file may be imported, see `load_scene`

    Raises
    ------
    UserError
        For a value that is not allowed, with the key, the value and what is allowed.
    """
    name = os.fspath(name)
    title = f"recipe {name}"
    if name.endswith(".toml"):
        values = read_toml(Path(name), title)
        if values.get("store") == "noisy":  # written into every recipe before 29 November 2026
            del values["store"]
    elif name in recipe_names():
        values = parse_toml((SHIPPED / f"{name}.toml").read_text(encoding="utf-8"), title)
    else:
        raise UserError(
            f"no recipe {name!r}{meant(name, recipe_names())}; there is "
            f"{', '.join(recipe_names())}, or a .toml file"
        )
    if not values:
        raise UserError(f"{title} has no keys: give at least one, such as sequences = 10")
    recipe = convert(with_allowed(values, allow), Recipe, title)
    if name.endswith(".toml"):  # its files are relative to it
        folder = Path(name).absolute().parent
        recipe = with_files(recipe, lambda file: str(folder / file))
    if meshes is not None:
        recipe = with_meshes(recipe, Path(meshes))
    _check(recipe, name)
    return recipe


def with_files(recipe: Recipe, rename: Callable[[str], str]) -> Recipe:
    """Rename the user's own files in a recipe: sensors and meshes."""

    def changed(key: str, value: Any) -> Any:
        if key == "object" and isinstance(value, dict) and value.get("mesh"):
            return {**value, "mesh": changed("object.mesh", value["mesh"])}
        own = key == "object.mesh" or (key == "sensor" and str(value).endswith(".toml"))
        return rename(value) if own and isinstance(value, str) and value else value

    def moved(part: Part) -> Part:
        draw = {
            key: {kind: [changed(key, value) for value in values] for kind, values in how.items()}
            for key, how in part.draw.items()
        }
        scene = {key: changed(key, value) for key, value in part.scene.items()}
        return replace(part, scene=scene, draw=draw)

    return replace(moved(recipe), cases=tuple(moved(case) for case in recipe.cases))


def portable(recipe: Recipe, folder: Path) -> Recipe:
    """Name the files of a recipe relative to a folder."""
    return with_files(recipe, lambda name: relative(name, folder))


def with_meshes(recipe: Recipe, folder: Path) -> Recipe:
    """Draw the objects of a recipe from a folder of meshes.

    Raises
    ------
    UserError
        For a folder without meshes, and for a recipe with another body.
    """
    if set(bodies_of(recipe)) != {"dome"}:
        raise UserError('meshes are for a recipe with scene.body = "dome"')
    ends = (".stl", ".obj", ".ply", ".off", ".glb")  # ends of the names of files of meshes
    if not folder.is_dir():
        raise UserError(f"there is no folder {folder}; give a folder of {', '.join(ends)} files")
    found = sorted(str(p.absolute()) for p in folder.glob("*") if p.suffix.lower() in ends)
    if not found:
        raise UserError(f"folder {folder} has no mesh: no file that ends in {', '.join(ends)}")
    return replace(recipe, draw={**recipe.draw, "object.mesh": {"choice": found}})


def dump_recipe(recipe: Recipe) -> str:
    """Write a recipe as TOML with all defaults."""
    values = msgspec.to_builtins(recipe)
    if not recipe.cases:
        del values["cases"]
    return tomli_w.dumps(as_in_file(values))


def difference(recipe: Recipe, other: Recipe) -> str:
    """First key in which two recipes differ, with both values."""
    one, two = (dotted(msgspec.to_builtins(each)) for each in (recipe, other))
    key = next((key for key in {**one, **two} if one.get(key) != two.get(key)), "")
    if key in ("", "cases"):
        return "their cases differ" if key else "the order of their keys differs"
    return f"{key} is {one.get(key, 'not given')}, and there {two.get(key, 'not given')}"


def cases_of(recipe: Recipe) -> list[Recipe]:
    """Split a recipe into one for each case, which draws the case's name."""
    return [
        replace(
            recipe,
            scene=_merged(recipe.scene, case.scene),
            draw={**recipe.draw, **case.draw, CASE: {"choice": [case.name]}},
            cases=(),
        )
        for case in recipe.cases
    ] or [recipe]


def _case_of(recipe: Recipe, number: int) -> Recipe:
    """Recipe of a sequence's case."""
    cases = cases_of(recipe)
    return cases[number % len(cases)]


def bodies_of(recipe: Recipe) -> list[Body]:
    """Bodies of a recipe's sequences, each once."""
    return list(dict.fromkeys(case.scene.get("body", "chain") for case in cases_of(recipe)))


def drawn(recipe: Recipe, number: int, attempt: int = 0) -> Values:
    """Draw the values of a sequence, by key; each key has its own random stream."""
    turn = number // max(len(recipe.cases), 1)
    return {
        key: draw(
            how, np.random.default_rng([recipe.seed, number, attempt, crc32(key.encode())]), turn
        )
        for key, how in sorted(_case_of(recipe, number).draw.items())
    }


def scene_of(recipe: Recipe, number: int, values: Values) -> Scene:
    """Make the scene of a sequence from its drawn values.

    A press has a constant grip and no load. In a grasp the load grows to a share of µ·grip below 1,
    and stays. In a slip it grows to a share above 1. A move has neither, see `pose_of`.
    """
    tables = copy.deepcopy(_case_of(recipe, number).scene)
    for key, value in values.items():
        if key not in OWN:
            _put(tables, key, value)
    tables |= {"path": "truth", "controller": "conservative"}
    tables["seed"] = crc32(f"{recipe.seed} {number}".encode())
    name = f"recipe, sequence {number}"
    plain = parse_scene(tables, name)
    motion, grip = str(values.get("motion", "press")), float(values.get("grip_n", 2.0))
    tables["conservative"] = {"force_n": grip}
    largest = plain.object.friction * grip
    times: list[float] = []
    forces: list[float] = []
    # Start and end of the growth of the load, as shares of a sequence's duration.
    grows = {"grasp": (0.25, 0.6), "slip": (0.25, 0.9)}
    if motion in grows:
        share = float(values.get("slip_share", 1.2) if motion == "slip" else values["share"])
        times = [plain.duration_s * part for part in grows[motion]]
        forces = [0.0, share * largest]
    tables["load"] = {"times_s": times, "forces_n": forces, "interpolation": "linear"}
    return parse_scene(tables, name)


def pose_of(values: Values, scene: Scene) -> DomePose:
    """Pose at the end of a move, from its drawn values."""
    number = {key: float(values.get(key, 0.0)) for key in POSE}
    turn = {key: math.radians(value) for key, value in number.items() if key.endswith("_deg")}
    towards, leans = turn["pose.shear_towards_deg"], turn["pose.tilt_towards_deg"]
    shear, tilt = 1e-3 * number["pose.shear_mm"], turn["pose.tilt_deg"]
    return DomePose(
        press=number["pose.press_share"] * scene.build_dome().thickness,
        shear=(shear * math.cos(towards), shear * math.sin(towards)),
        twist=turn["pose.twist_deg"],
        # The upper side leans towards x by a turn about y, towards −y by one about x.
        tilt=(-tilt * math.sin(leans), tilt * math.cos(leans)),
        azimuth=turn["pose.azimuth_deg"],
    )


def _check(recipe: Recipe, name: str) -> None:
    """Refuse cases with the same name, and values that no scene can have."""
    names = [case.name for case in recipe.cases]
    if twice := [one for one in names if names.count(one) > 1]:
        raise UserError(f"recipe {name}: two cases have the name {twice[0]!r}")
    if CASE in {**recipe.draw, **{key: 0 for case in recipe.cases for key in case.draw}}:
        raise UserError(f"recipe {name}: draw.{CASE}: cases are not drawn, they take turns")
    for case in recipe.cases:
        twice = [key for key in dotted(case.scene) if key in {**recipe.draw, **case.draw}]
        if twice:
            raise UserError(f"recipe {name}, case {case.name}: {twice[0]} is set and drawn")
    for one, title in zip(cases_of(recipe), names or [""], strict=True):
        _check_case(one, f"{name}, case {title}" if title else name)


def _check_case(recipe: Recipe, name: str) -> None:
    """Refuse values that no scene can have: the ends of each key's range are tried in turn."""
    for key, how in recipe.draw.items():
        check_draw(how, f"recipe {name}: draw.{key}")
    if "calibration" in {**recipe.scene, **recipe.draw}:
        raise UserError(f"recipe {name}: calibration: sensors of a dataset are read as designed")
    motions = ends(recipe.draw.get("motion", {"choice": ["press"]}))
    _check_body(recipe, name, motions)
    if "grasp" in motions and "share" not in recipe.draw:
        raise UserError(f"recipe {name}: draw.share is needed where draw.motion has grasp")
    bounds = {"grip_n": (0.05, 30.0), "share": (0.0, 1.0), "slip_share": (1.0, 3.0), **POSE}
    for key, (low, high) in bounds.items():
        for end in ends(recipe.draw.get(key, {"choice": []})):
            if not (isinstance(end, int | float) and low <= end <= high):
                raise UserError(
                    f"recipe {name}: draw.{key} reaches {end}; {low:g} to {high:g} is allowed"
                )
    first = {key: ends(how)[0] for key, how in recipe.draw.items()}
    own = {key: how for key, how in recipe.draw.items() if key != CASE}
    tried = [(key, end) for key, how in own.items() for end in ends(how)]
    if reason := _refusal(recipe, first):
        # Of a drawn value if it names the key or another value is allowed, else of the scene.
        near = (
            key
            for key, end in tried
            if reason.startswith(f"{key} ") or not _refusal(recipe, first | {key: end})
        )
        at = next((f"draw.{key} reaches {first[key]}: " for key in near), "")
        raise UserError(f"recipe {name}: {at}{reason}")
    for key, end in tried:
        if reason := _refusal(recipe, first | {key: end}):
            raise UserError(f"recipe {name}: draw.{key} reaches {end}: {reason}")


def _refusal(recipe: Recipe, values: Values) -> str:
    """Why no scene can have these drawn values; "" if one can."""
    try:
        scene_of(recipe, 0, values)
    except UserError as error:
        return str(error).removeprefix("scene recipe, sequence 0: ")
    return ""


def check_asked(recipe: Recipe) -> None:
    """Refuse labels of pixels and readings that the bodies do not have.

    Raises
    ------
    UserError
        For such a label or reconstructor, with its name.
    """
    if recipe.reading:
        if recipe.reading not in (DEFAULT_RECONSTRUCTOR, *METHODS):
            allowed = ", ".join((DEFAULT_RECONSTRUCTOR, *METHODS))
            question = meant(recipe.reading, (DEFAULT_RECONSTRUCTOR, *METHODS))
            raise UserError(f"no reading {recipe.reading!r}{question}; there is {allowed}")
        for body in bodies_of(recipe):
            reconstructor_for(body, recipe.reading)
    for label in recipe.truth:
        if label in DOME_TRUTH and set(bodies_of(recipe)) != {"dome"}:
            raise UserError(f'truth {label!r} needs a recipe with scene.body = "dome"')


def _check_body(recipe: Recipe, name: str, motions: list[Any]) -> None:
    """Refuse motions and labels that the body of a case does not have."""
    dome = bodies_of(recipe) == ["dome"]
    allowed = MOTIONS if dome else MOTIONS[:-1]
    if set(motions) - set(allowed):
        raise UserError(f"recipe {name}: draw.motion: allowed are {', '.join(allowed)}")
    if "body" in recipe.draw:
        raise UserError(f"recipe {name}: draw.body: a body is not drawn, set it in scene.body")
    check_asked(recipe)
    poses = [key for key in recipe.draw if key in POSE]
    if poses and "move" not in motions:
        raise UserError(f'recipe {name}: draw.{poses[0]} needs draw.motion to have "move"')


def _merged(shared: Values, own: Values) -> Values:
    """Merge tables of a scene; keys of `own` replace the shared ones."""
    merged = dict(shared)
    for key, value in own.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merged(merged[key], value) if both else value
    return merged


def dotted(tables: Values) -> Values:
    """Flatten tables: values by their keys with dots."""
    flat: Values = {}
    for key, value in tables.items():
        inner = dotted(value) if isinstance(value, dict) else {"": value}
        flat |= {f"{key}.{name}".rstrip("."): one for name, one in inner.items()}
    return flat


def _put(tables: Values, key: str, value: Any) -> None:
    *path, last = key.split(".")
    for part in path:
        tables = tables.setdefault(part, {})
    # A table is drawn as a whole: a shape with its lengths.
    tables[last] = {**tables.get(last, {}), **value} if isinstance(value, dict) else value
