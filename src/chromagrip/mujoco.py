"""A tactile sensor on a site of a MuJoCo model; the extra `mujoco`.

    tip = chromagrip.mujoco.attach(model, data, site="tip", body="mug", sensor="dome-2020")
    mujoco.mj_step(model, data)
    tip.update().image

The sensor's frame is that of the site: its origin is the centre of the dome's sphere, or the middle
of a pad's face, and z points outwards. Coupled both ways, our contact takes the place of MuJoCo's.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import UserError
from .extras import need
from .model import Solid, shapes
from .model.shapes import Shape
from .render import SensorDesign, load_sensor
from .sensing.bodies import FARTHEST, Pose
from .sensing.given import number
from .sensing.sensor import SensorData, TactileSensor

Array = NDArray[np.float64]

#: Longest time constant of the skin of a sensor that is coupled both ways [s].
RELAXATION = 0.01
#: Stiffness of a contact of a few newtons, with which shorter ones are chosen [N/m].
_STIFFNESS = 1e4
#: Turn from the frame of a cylinder or a capsule of ours, along y, to MuJoCo's, along z.
_ALONG_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
#: Rounding of edges over the shortest half side: a sharp edge has no normal.
_ROUNDING = 0.05


def attach(
    model: Any,
    data: Any,
    *,
    site: str,
    body: str,
    sensor: SensorDesign | str = "dome-2020",
    geom: str | None = None,
    friction: float | None = None,
    stiffness: float = 1e9,
    two_way: bool = False,
    relaxation: float | None = None,
    noise: float = 0.0,
    seed: int = 0,
) -> "MujocoTip":
    """Attach a sensor to a site; it touches a body.

    Parameters
    ----------
    model, data: MuJoCo's `MjModel` and `MjData`
    site: name of the site whose frame is the sensor's
    body: name of the body that is touched
    sensor: name or file of a design with silicone, or a design
    geom: name of the body's geom that is touched (default: its only one)
    friction: µ (default: the geom's sliding friction)
    stiffness: stiffness per area of the object [N/m³]
    two_way: whether our contact takes the place of MuJoCo's contact of the geom with the body of
        the site, and of those welded to it: `update` adds to `data.xfrc_applied` of both bodies.
        The model is changed, for all of its data
    relaxation: time constant of the skin, both ways [s] (default: up to 10 ms, less for light
        objects and long steps): without it an object bounces for ever, with too much it flies away
    noise, seed: as of `TactileSensor`

    Raises
    ------
    UserError
        When MuJoCo is not installed, for a site, body or geom that is not there, and for a geom
        that the sensor cannot touch.
    """
    mujoco = need("mujoco", "mujoco")
    _check(mujoco, model, data)
    if not isinstance(two_way, bool):
        raise UserError(f"two_way = {two_way!r} must be True or False")
    at = _number(mujoco, model, "site", site)
    touched = _touched(mujoco, model, body, geom)
    owner = int(model.site_bodyid[at])
    if owner == int(model.geom_bodyid[touched]):
        raise UserError(f"the site {site!r} is on the body {body!r}, which it is to touch")
    shape, turn = _shape(mujoco, model, touched)
    mu = float(model.geom_friction[touched, 0]) if friction is None else friction
    design = load_sensor(sensor) if isinstance(sensor, str) else sensor
    if not isinstance(design, SensorDesign):
        raise UserError(f"sensor = {sensor!r} must be the name or file of a design, or a design")
    silicone = design.dome
    if two_way:
        if relaxation is None:
            relaxation = _relaxation(model, owner, touched)
        given = number(relaxation, "relaxation [s]", 0.0)
        silicone = replace(silicone, relaxation=max(silicone.relaxation, given))
    made = TactileSensor(design, body=silicone, noise=noise, seed=seed)
    solid = Solid(
        shape=shape, friction=number(mu, "friction"), stiffness=number(stiffness, "stiffness")
    )
    made.attach(solid)
    if two_way:
        _without_contact(model, owner, touched)
    return MujocoTip(mujoco, model, data, made, (at, touched), turn, two_way)


class MujocoTip:
    """A tactile sensor that follows a MuJoCo model; made by `attach`.

    Attributes
    ----------
    sensor: the sensor
    """

    def __init__(
        self,
        mujoco: Any,
        model: Any,
        data: Any,
        sensor: TactileSensor,
        numbers: tuple[int, int],
        turn: Array,
        two_way: bool,
    ) -> None:
        self.sensor = sensor
        self._mujoco, self._model, self._data = mujoco, model, data
        (self._site, self._geom), self._turn = numbers, turn
        self._bodies = int(model.site_bodyid[self._site]), int(model.geom_bodyid[self._geom])
        self._two_way, self._time = two_way, float(data.time)
        self._applied, self._placed = np.zeros((2, 6)), False

    @property
    def data(self) -> SensorData:
        """Values of the current frame, see `TactileSensor.data`."""
        return self.sensor.data

    def update(self) -> SensorData:
        """Follow the model after `mj_step`; both ways, also apply the contact's forces.

        Raises
        ------
        UserError
            For a pose that the silicone does not describe; forces then stay as they are.
        """
        data = self._data
        self._mujoco.mj_kinematics(self._model, data)
        if data.time < self._time:  # the simulation was reset
            self.reset()
        since = float(data.time) - self._time
        if since > 0.0:
            self.sensor.update(self._pose(), dt=since, placed=not self._placed)
            self._placed, self._time = True, float(data.time)
        if self._two_way:
            self._apply(self.sensor.data.wrench)
        return self.sensor.data

    def reset(self) -> None:
        """Begin again without contact, at the model's time."""
        self.sensor.reset()
        if self._data.time >= self._time:  # else MuJoCo's own reset has cleared all forces
            self._data.xfrc_applied[list(self._bodies)] -= self._applied
        self._time = float(self._data.time)
        self._applied[:], self._placed = 0.0, False

    def _frame(self) -> tuple[Array, Array]:
        """Turn (3, 3) and place (3,) [m] of the sensor in the world."""
        turn = self._data.site_xmat[self._site].reshape(3, 3)
        return turn, self._data.site_xpos[self._site]

    def _pose(self) -> Pose:
        """Pose of the object in the sensor's frame."""
        turn, place = self._frame()
        own = self._data.geom_xmat[self._geom].reshape(3, 3) @ self._turn
        quat = np.empty(4)
        self._mujoco.mju_mat2Quat(quat, (turn.T @ own).ravel())
        there = turn.T @ (self._data.geom_xpos[self._geom] - place)
        there = np.clip(there, -FARTHEST, FARTHEST)
        w, x, y, z = quat.tolist()
        return Pose(place=tuple(there.tolist()), turn=(w, x, y, z))

    def _apply(self, wrench: Array) -> None:
        """Apply the wrench to the sensor's body, and its opposite to the object's."""
        turn, place = self._frame()
        force, torque = turn @ wrench[:3], turn @ wrench[3:]
        for row, (body, sign) in enumerate(zip(self._bodies, (1.0, -1.0), strict=True)):
            arm = place - self._data.xipos[body]
            now = sign * np.concatenate([force, torque + np.cross(arm, force)])
            # Another sensor, or the user, may apply forces to the same body.
            self._data.xfrc_applied[body] += now - self._applied[row]
            self._applied[row] = now


def _check(mujoco: Any, model: Any, data: Any) -> None:
    """Refuse what is no model with its data."""
    if not (isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData)):
        raise UserError("attach() needs MuJoCo's MjModel and MjData, in this order")
    if data.xpos.shape != (model.nbody, 3) or data.qpos.shape != (model.nq,):
        raise UserError("the MjData is of another model")


def _relaxation(model: Any, owner: int, touched: int) -> float:
    """Time constant of the skin with which a contact settles, and is stable [s].

    Forces of a step are those of its start: damping by c = k·τ is stable up to c = 2·m/step, where
    m is the mass that the contact moves.
    """
    body = int(model.geom_bodyid[touched])
    arm = float(np.linalg.norm(model.geom_pos[touched] - model.body_ipos[body]))
    arm += float(model.geom_rbound[touched]) / math.sqrt(3.0)
    along, about = model.body_invweight0[body]
    light = along + arm**2 * about + model.body_invweight0[owner][0]  # 1/mass
    most = 1.0 / (2.0 * _STIFFNESS * model.opt.timestep * max(light, 1e-9))
    return float(min(RELAXATION, most))


def _number(mujoco: Any, model: Any, kind: str, name: str) -> int:
    """Number of a named site, body or geom."""
    if not isinstance(name, str):  # MuJoCo itself dies of one that is no text
        raise UserError(f"the {kind} is given by its name, not by {name!r}")
    found = mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name)
    if found < 0:
        count = getattr(model, f"n{kind}")
        names = [getattr(model, kind)(k).name for k in range(count)]
        there = ", ".join(sorted(filter(None, names))) or "none with a name"
        raise UserError(f"the model has no {kind} {name!r}; it has {there}")
    return int(found)


def _touched(mujoco: Any, model: Any, body: str, geom: str | None) -> int:
    """Number of the geom of a body that is touched."""
    owner = _number(mujoco, model, "body", body)
    own = np.flatnonzero(model.geom_bodyid == owner)
    if geom is not None:
        chosen = _number(mujoco, model, "geom", geom)
        if chosen not in own:
            raise UserError(f"geom {geom!r} is not of the body {body!r}")
        return chosen
    if len(own) != 1:
        if not len(own):
            raise UserError(f"body {body!r} has no geom to touch")
        names = ", ".join(model.geom(int(k)).name or f"number {k}" for k in own)
        raise UserError(f"body {body!r} has {len(own)} geoms ({names}); choose one: geom=NAME")
    return int(own[0])


def _shape(mujoco: Any, model: Any, geom: int) -> tuple[Shape, Array]:
    """Shape of a geom, and the turn (3, 3) from the shape's frame to the geom's."""
    kinds, kind = mujoco.mjtGeom, int(model.geom_type[geom])
    size = [float(value) for value in model.geom_size[geom]]
    straight = np.eye(3)
    if kind == kinds.mjGEOM_SPHERE:
        return shapes.ball(size[0]), straight
    if kind == kinds.mjGEOM_CAPSULE:
        return shapes.capsule(size[0], 2.0 * (size[0] + size[1])), _ALONG_Z
    if kind == kinds.mjGEOM_CYLINDER:
        rounding = _ROUNDING * min(size[:2])
        return shapes.cylinder(size[0], 2.0 * size[1], rounding), _ALONG_Z
    if kind == kinds.mjGEOM_BOX:
        edges = (2.0 * size[0], 2.0 * size[1], 2.0 * size[2])
        return shapes.box(edges, _ROUNDING * min(size)), straight
    if kind == kinds.mjGEOM_MESH:
        number = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
        face, faces = int(model.mesh_faceadr[number]), int(model.mesh_facenum[number])
        trimesh = need("trimesh", "mesh")
        vertices = np.array(model.mesh_vert[first : first + count], dtype=float)
        triangles = np.array(model.mesh_face[face : face + faces])
        return shapes.mesh(trimesh.Trimesh(vertices, triangles, process=False)), straight
    name = kinds(kind).name.removeprefix("mjGEOM_").lower()
    raise UserError(
        f"a geom of type {name} cannot be touched; allowed are sphere, capsule, cylinder, box and "
        "mesh"
    )


def _without_contact(model: Any, owner: int, touched: int) -> None:
    """Turn MuJoCo's contact of the geoms of a body with another geom off, and no other contact.

    Bodies that are welded to it count; what is fixed in the world does so by its body alone.
    """
    welded = model.body_weldid[model.geom_bodyid] == model.body_weldid[owner]
    same = model.geom_bodyid == owner
    own = np.flatnonzero(welded if model.body_weldid[owner] else same & (owner > 0))
    pairs = np.stack([model.pair_geom1, model.pair_geom2], axis=-1)
    listed = (np.isin(pairs, own) & (pairs[:, ::-1] == touched)).any(axis=1)
    model.pair_margin[listed] = -1.0  # a contact begins where the distance is below it [m]
    used = np.bitwise_or.reduce(model.geom_contype) | np.bitwise_or.reduce(model.geom_conaffinity)
    free = [bit for bit in range(31) if not int(used) >> bit & 1]
    for geom in own:
        kinds, with_ = model.geom_contype, model.geom_conaffinity
        meets = ((kinds[geom] & with_) | (kinds & with_[geom])) != 0
        if not meets[touched]:
            continue
        meets[touched] = False
        if meets.any() and not free:
            raise UserError("the model's geoms use all bits of contype and conaffinity")
        # The geom keeps its contacts with the others by a bit of its own.
        kinds[geom], with_[geom] = 0, 0
        if meets.any():
            bit = 1 << free.pop(0)
            with_[geom] = bit
            kinds[np.flatnonzero(meets)] |= bit
