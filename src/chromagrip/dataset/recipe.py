"""Recipes of datasets: values that all sequences share, and how others are drawn for each."""

import copy
import math
import os
from collections.abc import Callable
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal
from zlib import crc32

import msgspec
import numpy as np
import tomli_w
from msgspec import Meta
from msgspec.structs import replace

from ..errors import UserError
from ..loop.poses.dome_poses import DomePose
from ..scene.scene import Body, Scene, parse_scene, relative
from ..strict_toml import Table, convert, parse_toml, read_toml
from .labels import DOME_TRUTH

Truth = Literal["depth", "flow", "masks", "traction", "contact"]

#: Kinds of motion: all are driven by forces, but a `move` goes to a pose, on a dome alone.
MOTIONS = ("press", "grasp", "slip", "move")
#: Keys of a pose with the least and the largest value: depth over the thickness of the silicone,
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
#: Keys that are drawn beside those of a scene: kind of motion, grip [N], the load over µ·grip of a
#: grasp and of a slip, and the pose of a move.
OWN = ("motion", "grip_n", "share", "slip_share", *POSE)
#: Numbers that each way of drawing takes; None is any.
_DRAWS = {"uniform": 2, "log_uniform": 2, "normal": 4, "choice": None}
#: Start and end of the growth of the load, as shares of a sequence's duration.
_GROWS: dict[str, tuple[float, float]] = {"grasp": (0.25, 0.6), "slip": (0.25, 0.9)}


#: Ends of the names of files of meshes.
MESHES = (".stl", ".obj", ".ply", ".off", ".glb")
#: Values of TOML tables: of a scene, or drawn ones by key of a scene or of OWN.
Values = dict[str, Any]
#: Folder of the shipped recipes.
_SHIPPED = files(__package__) / "recipes"


class Recipe(Table, frozen=True):
    """Contents of a dataset.

    Attributes
    ----------
    description: one line
    sequences: number of them, unless the command line gives another
    seed: of everything that is drawn; sequence k depends on it and k alone
    truth: labels of every pixel that are kept beside those of markers and forces
    scene: tables of a scene, the same in every sequence
    draw: key of a scene, with dots, or one of OWN → how it is drawn: `{ uniform = [low, high] }`,
        `{ log_uniform = [low, high] }`, `{ normal = [mean, deviation, low, high] }` (outside of the
        bounds it is drawn again) or `{ choice = [...] }`
    """

    description: str = ""
    sequences: Annotated[int, Meta(ge=1, le=10_000_000)] = 100
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 0
    truth: tuple[Truth, ...] = ()
    scene: Values = msgspec.field(default_factory=dict)
    draw: dict[str, dict[str, list[Any]]] = msgspec.field(default_factory=dict)


def recipe_names() -> list[str]:
    """Names of the shipped recipes."""
    return sorted(
        f.name.removesuffix(".toml") for f in _SHIPPED.iterdir() if f.name[-5:] == ".toml"
    )


def load_recipe(name: str | PathLike[str], meshes: str | PathLike[str] | None = None) -> Recipe:
    """Recipe of that name, or of a TOML file.

    Parameters
    ----------
    name: shipped, or a file
    meshes: folder of the objects that are drawn, instead of the recipe's

    Raises
    ------
    UserError
        With the key, the value and what is allowed.
    """
    name = os.fspath(name)
    title = f"recipe {name}"
    if name.endswith(".toml"):
        values = read_toml(Path(name), title)
    elif name in recipe_names():
        values = parse_toml((_SHIPPED / f"{name}.toml").read_text(encoding="utf-8"), title)
    else:
        raise UserError(
            f"no recipe {name!r}; there is {', '.join(recipe_names())}, or a .toml file"
        )
    recipe = convert(values, Recipe, title)
    if name.endswith(".toml"):  # what it names lies beside it
        folder = Path(name).absolute().parent
        recipe = with_files(recipe, lambda file: str(folder / file))
    if meshes is not None:
        recipe = with_meshes(recipe, Path(meshes))
    _check(recipe, name)
    return recipe


def with_files(recipe: Recipe, rename: Callable[[str], str]) -> Recipe:
    """The recipe with the user's own files renamed: sensors and meshes."""

    def changed(key: str, value: Any) -> Any:
        if key == "object" and isinstance(value, dict) and value.get("mesh"):
            return {**value, "mesh": changed("object.mesh", value["mesh"])}
        own = key == "object.mesh" or (key == "sensor" and str(value).endswith(".toml"))
        return rename(value) if own and isinstance(value, str) and value else value

    draw = {
        key: {kind: [changed(key, value) for value in values] for kind, values in how.items()}
        for key, how in recipe.draw.items()
    }
    scene = {key: changed(key, value) for key, value in recipe.scene.items()}
    return replace(recipe, scene=scene, draw=draw)


def portable(recipe: Recipe, folder: Path) -> Recipe:
    """The recipe with files named relative to the folder."""
    return with_files(recipe, lambda name: relative(name, folder))


def with_meshes(recipe: Recipe, folder: Path) -> Recipe:
    """The recipe with its objects drawn from a folder of meshes.

    Raises
    ------
    UserError
        For a folder without meshes, and a recipe of another body.
    """
    if body_of(recipe) != "dome":
        raise UserError('meshes are for a recipe with scene.body = "dome"')
    found = sorted(str(p.absolute()) for p in folder.glob("*") if p.suffix.lower() in MESHES)
    if not found:
        raise UserError(f"folder {folder} has no mesh: no file that ends in {', '.join(MESHES)}")
    return replace(recipe, draw={**recipe.draw, "object.mesh": {"choice": found}})


def dump_recipe(recipe: Recipe) -> str:
    """TOML text of a recipe, every default written out."""
    return tomli_w.dumps(msgspec.to_builtins(recipe))


def body_of(recipe: Recipe) -> Body:
    """Body of every sequence of a recipe."""
    return "dome" if recipe.scene.get("body") == "dome" else "chain"


def drawn(recipe: Recipe, number: int, attempt: int = 0) -> Values:
    """Values of a sequence, by key; each key has its own random stream."""
    return {
        key: _draw(how, np.random.default_rng([recipe.seed, number, attempt, crc32(key.encode())]))
        for key, how in sorted(recipe.draw.items())
    }


def scene_of(recipe: Recipe, number: int, values: Values) -> Scene:
    """Scene of a sequence with drawn values.

    A press has a constant grip and no load. In a grasp the load grows to a share of µ·grip, less
    than 1, and stays. In a slip it grows to a share above 1. A move has neither, see `pose_of`.
    """
    tables = copy.deepcopy(recipe.scene)
    for key, value in values.items():
        if key not in OWN:
            _put(tables, key, value)
    tables |= {"path": "truth", "controller": "conservative"}
    tables["seed"] = crc32(f"{recipe.seed} {number}".encode())
    name = f"recipe, sequence {number}"
    plain = parse_scene(tables, name)
    motion, grip = str(values.get("motion", "press")), float(values.get("grip_n", 2.0))
    tables["conservative"] = {"force_n": grip}
    held = plain.object.friction * grip
    times: list[float] = []
    forces: list[float] = []
    if motion in _GROWS:
        share = float(values.get("slip_share", 1.2) if motion == "slip" else values["share"])
        times = [plain.duration_s * part for part in _GROWS[motion]]
        forces = [0.0, share * held]
    tables["load"] = {"times_s": times, "forces_n": forces, "interpolation": "linear"}
    return parse_scene(tables, name)


def pose_of(values: Values, scene: Scene) -> DomePose:
    """Pose that a move goes to, for drawn values."""
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


def _draw(how: dict[str, list[Any]], rng: np.random.Generator) -> Any:
    ((kind, numbers),) = how.items()
    if kind == "choice":
        return numbers[int(rng.integers(len(numbers)))]
    if kind == "uniform":
        return float(rng.uniform(*numbers))
    if kind == "log_uniform":
        return float(np.exp(rng.uniform(*np.log(numbers))))
    mean, deviation, low, high = numbers
    while True:
        value = float(rng.normal(mean, deviation))
        if low <= value <= high:
            return value


def _check(recipe: Recipe, name: str) -> None:
    """Refuse values that no scene can have: the ends of each key's range are tried in turn."""
    for key, how in recipe.draw.items():
        _check_how(how, f"recipe {name}: draw.{key}")
    if "calibration" in {**recipe.scene, **recipe.draw}:
        raise UserError(f"recipe {name}: calibration: nothing is estimated in a dataset")
    motions = _ends(recipe.draw.get("motion", {"choice": ["press"]}))
    _check_body(recipe, name, motions)
    if "grasp" in motions and "share" not in recipe.draw:
        raise UserError(f"recipe {name}: draw.share is needed where draw.motion has grasp")
    bounds = {"grip_n": (0.05, 30.0), "share": (0.0, 1.0), "slip_share": (1.0, 3.0), **POSE}
    for key, (low, high) in bounds.items():
        for end in _ends(recipe.draw.get(key, {"choice": []})):
            if not (isinstance(end, int | float) and low <= end <= high):
                raise UserError(
                    f"recipe {name}: draw.{key} reaches {end}; {low:g} to {high:g} is allowed"
                )
    middle = {key: _ends(how)[0] for key, how in recipe.draw.items()}
    tried = [(key, end) for key, how in recipe.draw.items() for end in _ends(how)]
    for values in [{key: end} for key, end in tried] or [{}]:
        try:
            scene_of(recipe, 0, middle | values)
        except UserError as error:
            reason = str(error).removeprefix("scene recipe, sequence 0: ")
            at = "".join(f"draw.{key} reaches {end}: " for key, end in values.items())
            raise UserError(f"recipe {name}: {at}{reason}") from None


def check_truth(recipe: Recipe) -> None:
    """Refuse labels of pixels that the recipe's body does not have.

    Raises
    ------
    UserError
        With the label.
    """
    for label in recipe.truth:
        if label in DOME_TRUTH and body_of(recipe) != "dome":
            raise UserError(f'truth {label!r} needs a recipe with scene.body = "dome"')


def _check_body(recipe: Recipe, name: str, motions: list[Any]) -> None:
    """Refuse motions and labels that the recipe's body does not have."""
    dome = body_of(recipe) == "dome"
    allowed = MOTIONS if dome else MOTIONS[:-1]
    if set(motions) - set(allowed):
        raise UserError(f"recipe {name}: draw.motion: allowed are {', '.join(allowed)}")
    if "body" in recipe.draw:
        raise UserError(f"recipe {name}: draw.body: a dataset has one body, set it in scene.body")
    check_truth(recipe)
    poses = [key for key in recipe.draw if key in POSE]
    if poses and "move" not in motions:
        raise UserError(f'recipe {name}: draw.{poses[0]} needs draw.motion to have "move"')


def _check_how(how: dict[str, list[Any]], name: str) -> None:
    if len(how) != 1 or next(iter(how)) not in _DRAWS:
        raise UserError(f"{name}: expected one of {', '.join(_DRAWS)}")
    ((kind, numbers),) = how.items()
    wanted = _DRAWS[kind]
    if wanted is None:
        if not numbers:
            advice = ": give --meshes FOLDER" if name.endswith("object.mesh") else ""
            raise UserError(f"{name}: choice needs something to choose from{advice}")
        return
    if len(numbers) != wanted or not all(isinstance(v, int | float) for v in numbers):
        raise UserError(f"{name}: {kind} takes {wanted} numbers, got {numbers}")
    low, high = numbers[-2:]
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise UserError(f"{name}: from {low} to {high} there is nothing to draw")
    if kind == "log_uniform" and not low > 0.0:
        raise UserError(f"{name}: log_uniform starts above 0, got {low}")
    if kind == "normal" and not (numbers[1] > 0.0 and low <= numbers[0] <= high):
        raise UserError(f"{name}: normal needs a deviation above 0 and its mean within bounds")


def _ends(how: dict[str, list[Any]]) -> list[Any]:
    """Bounds of the drawn values, or all choices."""
    ((kind, numbers),) = how.items()
    return list(numbers) if kind == "choice" else list(numbers[-2:])


def _put(tables: Values, key: str, value: Any) -> None:
    *path, last = key.split(".")
    for part in path:
        tables = tables.setdefault(part, {})
    # A table is drawn as a whole: a shape with its lengths.
    tables[last] = {**tables.get(last, {}), **value} if isinstance(value, dict) else value
