"""Learn to grip with Gymnasium: a policy of four numbers, by the cross-entropy method.

    python examples/learn_to_grip.py [ROUNDS]   # 8 by default

It sees the safety margin and its own grip, and chooses the rate of the grip. It is compared with
the thesis's controllers and with constant grips, on friction that it never saw.
"""

import sys

import gymnasium
import numpy as np

import chromagrip
import chromagrip.rig  # registers the environment

SCENE = {"duration_s": 1.0, "load.times_s": [0.04, 0.5]}
UNSEEN = (0.35, 0.55, 0.8)
MOST = 5.0  # [N]
CANDIDATES, BEST = 12, 4


def grip(env: gymnasium.Env, policy: np.ndarray, friction: float) -> tuple[float, bool]:
    """Return of one grasp, and whether the object was dropped."""
    seen, info = env.reset(seed=0, options={"changes": {"object.friction": friction}})
    total, over = 0.0, False
    while not over:
        margin, low, _, force, known = seen
        rate = np.tanh(policy @ [margin, low, force / MOST, 1.0]) if known else 1.0
        seen, reward, terminated, truncated, info = env.step(np.array([rate], np.float32))
        total, over = total + reward, terminated or truncated
    return total, info["dropped"]


def learn(env: gymnasium.Env, rounds: int, rng: np.random.Generator) -> np.ndarray:
    """Policy whose neighbours grip best."""
    mean, spread = np.array([-1.0, 0.0, 0.0, 0.5]), np.full(4, 1.5)
    for _ in range(rounds):
        frictions = rng.uniform((0.3, 0.6), (0.6, 0.9))
        tried = mean + spread * rng.standard_normal((CANDIDATES, 4))
        returns = [sum(grip(env, one, mu)[0] for mu in frictions) for one in tried]
        best = tried[np.argsort(returns)[-BEST:]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.1
    return mean


def of_controller(friction: float, **changes: object) -> tuple[float, bool]:
    """The same of a controller of the thesis, counted from its trace."""
    changes = {"path": "truth", "object.friction": friction, **SCENE, **changes}
    trace = chromagrip.run(chromagrip.load_scene("camera-100hz", changes)).trace
    slid = np.diff(trace["rigid_slip_mm"])  # in each frame
    gentle = (slid < 1e-3) * (1.0 - trace["applied_n"][1:] / MOST)
    return float((gentle - 50.0 * slid).sum()), bool(slid.sum() >= 1.0)


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 8
    env = gymnasium.make("chromagrip/Grasp-v0", action="rate", changes=SCENE, most_n=MOST)
    policy = learn(env, rounds, np.random.default_rng(0))
    table = {"learned": [grip(env, policy, mu) for mu in UNSEEN]}
    for name in ("safety-margin", "margin-inversion", "react-to-slip"):
        table[name] = [of_controller(mu, controller=name) for mu in UNSEEN]
    for force in (1.5, 2.0, 2.5, 3.0):
        constant = {"controller": "conservative", "conservative.force_n": force}
        table[f"{force} N"] = [of_controller(mu, **constant) for mu in UNSEEN]
    for name, grasps in table.items():
        returns = "  ".join(f"{total:6.1f}{' dropped' * dropped}" for total, dropped in grasps)
        print(f"{name:18}{returns}")
    safe = [rows for name, rows in table.items() if "N" in name and not any(d for _, d in rows)]
    assert not any(dropped for _, dropped in table["learned"])
    assert sum(t for t, _ in table["learned"]) > max(sum(t for t, _ in rows) for rows in safe)


if __name__ == "__main__":
    main()
