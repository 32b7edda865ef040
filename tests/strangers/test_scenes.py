"""Scenes, recipes, sensors and calibrations of strangers, all of them TOML."""

from importlib.resources import files
from random import Random

import pytest

from chromagrip.loop.run_files import scene_text
from chromagrip.render import load_sensor
from chromagrip.scene.scene import load_scene
from chromagrip.tracking import load_calibration

from .damages import harmed
from .judged import Judge, few_and_many, repeated

CALIBRATION = """format = 'chromagrip calibration 1'
sensor = 'thesis'
stiffness_deviation = 0.02
[silicone]
shear_kpa = 30.0
"""
#: Texts of good files by their names.
GOOD = {
    **{
        f"scene-{name}.toml": scene_text(load_scene(name, {}), "")
        for name in ("camera-100hz", "dome-1", "pinch-lift", "worn-1")
    },
    **{
        f"recipe-{name}.toml": (files("chromagrip.dataset") / f"recipes/{name}.toml").read_text()
        for name in ("tiny", "edges")
    },
    "sensor-dome.toml": (files("chromagrip.render") / "designs/dome-2020.toml").read_text(),
    "calibration.toml": CALIBRATION,
}
#: Commands that judge a file and are then refused for another reason, before anything is made.
ENDING = {
    "scene": ("grasp", "--renderer", "nosuch", "--json", "--scene"),
    "recipe": ("dataset", "make", "--n", "0", "--out", "made"),
}


def read(judged: Judge, name: str) -> None:
    kind, place = name.partition("-")[0].removesuffix(".toml"), f"given/{name}"
    if kind in ENDING:
        assert judged.command(*ENDING[kind], place).returncode == 2
    else:
        load = load_sensor if kind == "sensor" else load_calibration
        judged.call(lambda: load(place), names=name)


@few_and_many(20, 1500)
def test_damaged_files_are_read_or_refused_in_a_sentence(judged: Judge, count: int) -> None:
    def check(draw: Random) -> None:
        name = draw.choice(list(GOOD))
        with judged.files() as folder:
            (folder / name).write_text(GOOD[name], encoding="utf-8")
            harmed(folder / name, draw)
            if not (folder / name).is_fifo():  # a pipe that a user names is read until it ends
                read(judged, name)

    repeated(check, count)
    assert judged.refused > count // 2


@pytest.mark.parametrize("kind", ["scene", "recipe", "sensor", "calibration"])
def test_each_kind_of_attack_is_a_sentence(judged: Judge, kind: str) -> None:
    for attack in (
        b"a = " + b"[" * 5000 + b"]" * 5000, b"a = 1\n" + b"#" * 11_000_000, bytes(range(256)), b"",
        b"a.b = " + b"{c = " * 3000,
    ):  # fmt: skip
        with judged.files() as folder:
            (folder / f"{kind}-x.toml").write_bytes(attack)
            before = judged.refused
            read(judged, f"{kind}-x.toml")
            assert judged.refused == before + 1
