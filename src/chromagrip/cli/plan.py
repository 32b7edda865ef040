"""The command `plan`: how much of the chain a scene needs."""

import json
from typing import Annotated

import tyro

from .options import JsonOnly, option


def plan(
    scene: Annotated[
        str,
        tyro.conf.Positional,
        option("shipped scene, see `chromagrip scenes`, or a .toml file", "NAME|FILE.toml"),
    ],
    *,
    tolerance: Annotated[float, option("of the safety margin Γ, RMS", "SHARE")] = 0.05,
    changes: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("change one scene value, such as object.friction=0.3", "KEY=VALUE", "set"),
    ] = (),
    json_only: JsonOnly = False,
) -> int:
    """Choose the cheapest methods and steps that keep Γ of a scene within a tolerance, and say why.

    The choice rests on what `chromagrip chart --update` measured, in situations like the scene's.
    """
    from ..loop.fidelity import Fidelity
    from ..scene.scene import grasp_command, load_scene, parse_change

    told = load_scene(scene, dict(parse_change(text) for text in changes))
    choice = Fidelity.auto(tolerance, told)
    if json_only:
        report = {
            "changes": choice.fidelity.changes,
            "milliseconds": choice.milliseconds,
            "margin_error": choice.error,
            "why": list(choice.lines),
        }
        print(json.dumps(report, ensure_ascii=False))
        return 0
    print(*choice.lines, sep="\n")
    kept = dict(text.split("=", 1) for text in changes)
    print(grasp_command(scene, kept | choice.fidelity.changes))
    return 0
