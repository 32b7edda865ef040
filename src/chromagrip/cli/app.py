"""The command line: its commands, how it is read, and its first page."""

import io
import re
import shlex
import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr
from functools import partial, wraps
from pathlib import Path
from textwrap import dedent
from typing import Any, get_args, get_origin, get_type_hints

import tyro
from tyro.extras import SubcommandApp

from ..by_name import method_meant
from ..errors import UserError, meant
from ..folders import make_scratch, remove_empty
from ..strict_toml import all_keys
from . import (
    calibrate,
    dataset,
    grasp,
    limit,
    lists,
    measure,
    pictures,
    render,
)
from .ending import NAME, finish
from .options import Overwrite, take_signals

Command = Callable[..., int]

#: Words for the types that tyro names in an error.
KINDS = {"FLOAT": "a number", "INT": "a whole number"}

#: Commands by name; the commands of a group have names of two words.
COMMANDS: dict[str, Command] = {
    "score": measure.score,
    "dataset make": dataset.make,
    "dataset check": dataset.check,
    "dataset info": dataset.info,
    "dataset export": dataset.export,
    "dataset split": dataset.split,
    "dataset merge": dataset.merge,
    "grasp": grasp.grasp,
    "sweep": measure.sweep,
    "report": grasp.report,
    "live": grasp.live,
    "render": render.render,
    "detect": pictures.detect,
    "track": pictures.track,
    "estimate": pictures.estimate,
    "calibrate camera": calibrate.calibrate_camera,
    "calibrate sensor": calibrate.calibrate_sensor,
    "calibrate readout": calibrate.calibrate_readout,
    "limit": limit.limit,
    "plan": grasp.plan,
    "reproduce": measure.reproduce,
    **{f"list {kind}": command for kind, command in lists.LISTS.items()},
    "doctor": lists.doctor,
}
#: Groups whose commands come from the table of studies.
STUDIES = ("bench", "chart", "stability")
#: Commands that have another name now.
MOVED = {
    **{kind: f"list {kind}" for kind in lists.LISTS},
    "train": "calibrate readout",
    "readout": "list readouts",
}
#: First words of the command line by what they are for, each with some words about it.
PURPOSES = {
    "test a tracker": {"score": "tracks of any tracker against the truth of a dataset"},
    "make training data": {"dataset": "make, check, info, split, merge, export"},
    "validate a controller": {
        "grasp": "one run: figure, video, trace, report",
        "sweep": "many settings, scenes and seeds",
        "report": "finished runs side by side",
    },
    "look at a grasp": {"live": "page with sliders, a finished run, or a camera"},
    "pictures": {
        "render": "pictures of poses, with their true values",
        "detect": "markers of a single picture",
        "track": "markers through pictures, a video or a camera",
        "estimate": "forces, friction and margin of pictures or a video",
    },
    "calibrate": {"calibrate": "camera, sensor, readout"},
    "measure": {
        "bench": "scores next to targets: control, force, loop, track",
        "chart": "speed against error: force, loop, track",
        "stability": "maps of failures: force, loop, track",
        "limit": "smallest errors that a picture of a sensor allows",
        "plan": "cheapest methods and steps for an error of margin Γ",
        "reproduce": "results of the thesis next to ours",
    },
    "look up": {
        "list": "scenes, sensors, palettes, controllers, trackers, …",
        "doctor": "missing parts of the installation",
    },
}
#: Parts of this project that `./run bench` measures, in a checkout.
OF_CHECKOUT = (
    "chart-dome",
    "chart-model",
    "chart-render",
    "dataset",
    "fidelity",
    "model",
    "render",
    "speed",
    "stability-dome",
    "stability-model",
)
#: Options by the names that they have elsewhere.
OTHER_NAMES = {
    "count": "--n",
    "depth": "--press-mm",
    "destination": "--out",
    "error": "--tolerance",
    "format": "--to",
    "num": "--n",
    "rate": "--fps",
    "repeats": "--seeds",
    "sequences": "--n",
    "test": "--shares",
    "threads": "--workers",
    "train": "--shares",
    "within": "--tolerance",
    "jobs": "--workers",
}
#: Placeholders of words without an option by options for which they are taken.
OTHER_PLACES = {
    "--data": "--truth",
    "--dataset": "--truth",
    "--image": "--source",
    "--images": "--source",
    "--tracker": "--tracks",
    "--trackers": "--tracks",
    "--video": "--source",
}
#: The same words without their purposes.
FIRST = {name: words for names in PURPOSES.values() for name, words in names.items()}


def main() -> None:
    """Entry point of the command line."""
    finish(lambda: run(sys.argv[1:]))


def run(words: list[str]) -> int:
    """Run a command line; its exit code.

    Raises
    ------
    UserError
        When it cannot be done, in one sentence.
    """
    known: Mapping[str, Command] = COMMANDS
    if words in ([], ["--help"], ["-h"]):
        print(front_page())
        return 0 if words else 2
    if words and words[0] in MOVED:
        raise UserError(f"`{NAME} {words[0]}` is `{NAME} {MOVED[words[0]]}` now")
    if words and words[0] in STUDIES:
        if ":" in "".join(words[1:2]):
            words = [*_own_study(words[1]), *words[2:]]
        known = commands_of(words[0])
    return _run(words, known, NAME)


def front_page() -> str:
    """Page of all first words, by what they are for."""
    lines = ["A colour-marker tactile fingertip, simulated from mechanics to grip.", ""]
    for purpose, names in PURPOSES.items():
        headings = [purpose, *[""] * (len(names) - 1)]
        lines += [
            f"  {heading:<23}{NAME} {name:<11}{words}"
            for heading, (name, words) in zip(headings, names.items(), strict=True)
        ]
    lines += [
        "",
        f"{NAME} COMMAND --help shows the options of a command, and an example.",
        f"{NAME} --version shows the version.",
        f"{NAME} --tyro-write-completion bash FILE writes the completion of a shell.",
        "Exit codes: 0 done, 1 an error in code or a missing part (doctor), 2 invalid input,",
        "130 interrupted, 141 output closed, 143 terminated.",
    ]
    return "\n".join(lines)


def run_study(verb: str, words: list[str], prog: str) -> int:
    """Run a command line that names a study of a verb alone; its exit code.

    Parameters
    ----------
    verb: of studies that `chromagrip` itself does not offer
    words: part and options
    prog: start of the command line, for pages of help
    """
    known = {name.removeprefix(f"{verb} "): each for name, each in commands_of(verb).items()}
    if not words or (words[0] not in known and not words[0].startswith("-")):
        raise UserError(f"{prog}: give one of {', '.join(known)}")
    return _run(words, known, prog)


def _run(words: list[str], known: Mapping[str, Command], prog: str) -> int:
    take_signals()
    for word in words:
        if not word.isprintable() and any("\ud800" <= c <= "\udfff" for c in word):
            encoding = sys.getfilesystemencoding()
            raise UserError(f"{word} is not {encoding} text; with PYTHONUTF8=1 words are UTF-8")
        if not word.strip() or re.fullmatch(r"--[\w-]+=\s*", word):
            which = f"the value of {word.strip('= ')}" if word.strip() else "a word"
            raise UserError(f"{which} is empty: give a value in `{shlex.join([prog, *words])}`")
    command = _parse(words, known, prog)
    if isinstance(command, int):
        return command
    out = command.keywords.get("out")
    of_out = command.func.__annotations__.get("overwrite") is Overwrite
    if of_out and out is None and command.keywords["overwrite"]:
        raise UserError("--overwrite is for the folder of --out: give --out, or leave it out")
    if isinstance(out, Path):
        make_scratch(out)
    done = False
    try:
        code = command()
        done = True
        return code
    except SystemExit as ended:  # commands return their code: a plug-in ended the program
        raise UserError(f"a plug-in ended the program: SystemExit: {ended.code}") from ended
    finally:
        if not done:
            remove_empty()


def _parse(words: list[str], known: Mapping[str, Command], prog: str) -> partial[int] | int:
    """Command line as a function that runs it, or the exit code of a page that was printed.

    Parameters
    ----------
    known: commands by name
    prog: start of the command line

    Raises
    ------
    UserError
        For a command or an option that does not exist, or a value that cannot be read.
    """
    name = next((n for n in (" ".join(words[:2]), " ".join(words[:1])) if n in known), None)
    if name is None:
        _check_group(words, known)
        if words[0] in FIRST:
            words = [words[0], "--help"]
    else:
        _refuse_repeated(words, known[name])
        _refuse_bare(words, known[name])
        _refuse_places(words, known[name], f"{prog} {name}")
    messages = io.StringIO()
    try:
        with redirect_stderr(messages):
            if name is None:
                return _all_commands(words).cli(prog=prog, args=words)
            rest = words[len(name.split()) :]
            return tyro.cli(_bound(known[name]), prog=f"{prog} {name}", args=rest)
    except SystemExit as ended:
        if ended.code in (0, None):  # a page of help
            return 0
        page = f"{prog} {name} --help" if name else f"{prog} --help"
        sentence = _sentence(messages.getvalue())
        left = sentence.removeprefix("unrecognized options: ")
        if left != sentence:
            flags = list(_flags(known[name])) if name else []
            sentence = _too_many(left.split(", "), words, name or NAME, flags)
        elif name and (bare := re.fullmatch(r"(\w+): its value is missing", sentence)):
            sentence = f"missing: {bare[1].upper()}{_in_order(f'{prog} {name}', known[name])}"
        elif name and (unknown := _unknown_option(words, known[name])):
            sentence = _too_many([unknown], words, name, list(_flags(known[name])))
        elif name and sentence.startswith("missing: "):
            sentence += _in_order(f"{prog} {name}", known[name])
        raise UserError(f"{sentence}; see `{page}`") from None


def _bound(command: Command) -> Callable[..., partial[int]]:
    """Function with the command's options that returns the call instead of making it.

    Parsing is thus over before the command runs, and no error of a command is taken for one of
    parsing.
    """

    @wraps(command)
    def bind(*values: object, **options: object) -> partial[int]:
        return partial(command, *values, **options)

    return bind


def commands_of(verb: str) -> dict[str, Command]:
    """Commands of the studies of a verb; their modules are loaded only here."""
    from .studies import commands

    return commands(verb)


def _own_study(name: str) -> tuple[str, str]:
    """Words of the command of a `module:function`, which enters the table of studies."""
    from ..measure.study import own_study

    entry = own_study(name)
    return entry.verb, entry.part


def _all_commands(words: list[str]) -> SubcommandApp:
    """Every command, for the list in `chromagrip --help` and for shell completion.

    Parameters
    ----------
    words: command line; only completion needs the parts of every group of studies
    """
    app, groups = SubcommandApp(), dict[str, SubcommandApp]()
    every = dict(COMMANDS)
    for verb in STUDIES:
        if any(word.startswith("--tyro") or word == verb for word in words):
            every |= commands_of(verb)
        else:
            app.command(name=verb, help=FIRST[verb])(_bound(_no_part))
    for name, command in every.items():
        first, _, second = name.partition(" ")
        line = (command.__doc__ or "").splitlines()[0]
        if not second:
            app.command(name=first, help=line)(_bound(command))
            continue
        if first not in groups:
            groups[first] = SubcommandApp()
            app.command(groups[first], name=first, help=FIRST[first])
        groups[first].command(name=second, help=line)(_bound(command))
    return app


def _no_part() -> int:
    """Stands for a group of studies in the list of all commands."""
    return 0


def _check_group(words: list[str], known: Mapping[str, Command]) -> None:
    """Refuse a first word that names no command, and a group without one of its commands."""
    if words[0].startswith("-"):
        own = ("--version", "--help", "-h")
        if words[0] in own or words[0].startswith("--tyro-"):
            return
        there = f"without a command; there is {', '.join(_first_words())}"
        raise UserError(f"no option {words[0]}{meant(words[0], own)} {there}")
    members = [name.split()[1] for name in known if name.startswith(f"{words[0]} ")]
    if words[0] not in _first_words():
        question = meant(words[0], (*_first_words(), *MOVED))
        raise UserError(f"no command {words[0]!r}{question}; there is {', '.join(_first_words())}")
    if members and words[1:2] not in ([], ["-h"], ["--help"]):
        question = meant(words[1], members)
        if words[0] in STUDIES:
            question = method_meant(words[1], members, "function")
        part = words[1] if words[0] == "bench" else f"{words[0]}-{words[1]}"
        if not question and words[1] in _first_words():
            question = f" (did you mean `{NAME} {words[1]}`?)"
        if part in OF_CHECKOUT:
            question = f" (in a checkout it is `./run bench {part}`)"
        raise UserError(f"{words[0]} {words[1]}{question}: there is {', '.join(members)}")


def _flags(command: Command) -> dict[str, Any]:
    """Types of the options of a command, by their names as they are typed."""
    flags = {}
    for name, hint in _hints(command).items():
        marks = get_args(hint)[1:]
        if tyro.conf.Positional not in marks:
            given = next((one.name for one in marks if getattr(one, "name", None)), None)
            flags[f"--{given or name.replace('_', '-')}"] = hint
    return flags


def _hints(command: Command) -> dict[str, Any]:
    """Annotated types of the parameters of a command."""
    hints = get_type_hints(command, include_extras=True)
    return {name: hint for name, hint in hints.items() if name != "return"}


def _refuse_repeated(words: list[str], command: Command) -> None:
    """Refuse an option that is given twice, unless it collects its values."""
    lists = (
        flag
        for flag, hint in _flags(command).items()
        if tyro.conf.UseAppendAction in get_args(hint)[1:]
    )
    several = set(lists)
    given = [word.partition("=")[0].replace("_", "-") for word in words if word.startswith("--")]
    for flag in dict.fromkeys(given):
        if given.count(flag) > 1 and flag in _flags(command) and flag not in several:
            more = "; `sweep` runs several" if flag == "--controller" else ""
            raise UserError(f"{flag} is given {given.count(flag)} times; give it once{more}")


def _unknown_option(words: list[str], command: Command) -> str | None:
    """First option that a command does not have."""
    flags = _flags(command)
    typed = (word.partition("=")[0] for word in words if re.match(r"--[A-Za-z]", word))
    return next((flag for flag in typed if flag not in flags), None)


def _refuse_bare(words: list[str], command: Command) -> None:
    """Refuse an option of several values that has none."""
    for flag, hint in _flags(command).items():
        kind, *marks = get_args(hint) or (None,)
        if get_origin(kind) is not tuple or tyro.conf.UseAppendAction in marks:
            continue
        following = [
            after for word, after in zip(words, [*words[1:], ""], strict=True) if word == flag
        ]
        if following and (not following[0] or following[0].startswith("--")):
            raise UserError(f"{flag}: its value is missing")


def _refuse_places(words: list[str], command: Command, start: str) -> None:
    """Refuse an option for a value that the command takes as a word.

    Parameters
    ----------
    start: start of the command line
    """
    places, flags = " ".join(_places(command)).split(), _flags(command)
    plain = [f"--{place.partition('|')[0].strip('.').lower()}" for place in places]
    for word, after in zip(words, [*words[1:], ""], strict=True):
        flag, _, value = word.partition("=")
        if not flag.startswith("--") or flag in flags:
            continue
        asked = flag if flag in plain or meant(flag, flags) else OTHER_PLACES.get(flag)
        if asked in plain:
            found = plain.index(asked)
            places[found] = value or after or places[found]
            raise UserError(
                f"no option {flag}: its value is a word without an option, as in "
                f"`{start} {' '.join(places)}`; see `{start} --help`"
            )


def _too_many(left: list[str], words: list[str], name: str, flags: list[str]) -> str:
    """What is wrong with words that a command does not take, the first of them at least.

    Parameters
    ----------
    left: words that are not taken
    words: command line
    name: of the command
    flags: its options
    """
    unknown = [word.partition("=")[0] for word in left if re.match(r"--?[A-Za-z]", word)]
    if unknown:
        questions = (
            _other_name(w, flags)
            or meant(f"--{w.lstrip('-')}", flags)
            or _key_meant(w, flags)
            or _elsewhere(w)
            for w in unknown
        )
        return f"no option {', '.join(map(''.join, zip(unknown, questions, strict=True)))}"
    word = left[0]
    at = len(words) - 1 - words[::-1].index(word) if word in words else 0
    before = words[max(0, at - 2) : at]
    if not before:
        flag = next((each.partition("=")[0] for each in words if each.endswith(f"={word}")), name)
        return f"{flag} takes no value, got {word}"
    if before[0] == "--set" and "=" not in before[1]:
        return f"--set {before[1]} {word}: expected key=value, as {before[1]}={word}"
    if "=" in word and "--set" in flags:
        return f"{word} has no option before it: write --set {word}"
    if before[-1] in flags:
        return f"{before[-1]} takes no value, got {word}"
    question = ""
    option = next((flag for flag in ("--scene", "--sensor") if flag in flags), "")
    if option and (before[-1] == name or name == "sweep"):  # which takes several scenes
        question = f" (did you mean {option} {word}?)"
        if Path(word).suffix not in ("", ".toml"):
            question = f" ({option} takes a name or a .toml file)"
    return f"one word too many: {word} after {before[-1]}{question}"


def _other_name(flag: str, flags: list[str]) -> str:
    """Question that names the option that other programs call so; "" if there is none."""
    word = flag.lstrip("-")
    options = [OTHER_NAMES.get(word), *(each for each in flags if word in each.split("-"))]
    option = next((each for each in options if each in flags), None)
    if word in ("target", "margin") and "--controller" in flags:
        option = "--set margin_inversion.desired_margin, or --arg desired_margin of your controller"
    return f" (did you mean {option}?)" if option else ""


def _places(command: Command) -> list[str]:
    """Placeholders of the words that a command takes without an option, in their order."""
    marks = [get_args(hint)[1:] for hint in _hints(command).values()]
    own = [each for each in marks if tyro.conf.Positional in each]
    return [next(one.metavar for one in each if getattr(one, "metavar", None)) for each in own]


def _in_order(start: str, command: Command) -> str:
    """The order of a command's words, where one is missing and several are needed."""
    places = _places(command)
    if len(places) < 2:
        return ""
    rest = "; REST is the unloaded sensor, such as rest.png or first" if "REST" in places else ""
    return f" in `{start} {' '.join(places)}`{rest}"


def _elsewhere(flag: str) -> str:
    """The command that has an option which another lacks; "" if none or several have it."""
    having = [name for name, command in COMMANDS.items() if flag in _flags(command)]
    return f" (it is an option of `{NAME} {having[0]}`)" if len(having) == 1 else ""


def _key_meant(flag: str, flags: list[str]) -> str:
    """Question that names the key of a scene nearest to an option; "" if none is near."""
    if "--set" not in flags:
        return ""
    from ..scene.scene import Scene

    question = meant(flag.lstrip("-").replace("-", "_"), all_keys(Scene))
    return re.sub(r"[\w.]+(?=\?| or )", r"--set \g<0>=…", question)


def _first_words() -> list[str]:
    return list(FIRST)


def _sentence(box: str) -> str:
    """One sentence from the box of text that tyro draws around an error."""
    lines = box.replace("│", " ").splitlines()
    ruled = [not line.strip(" ─-╰╯") for line in lines]
    start = 2 if ruled[1:2] == [True] else 1  # below the title, and the rule that ASCII has
    end = ruled.index(True, start) if True in ruled[start:] else len(lines)
    lines = dedent("\n".join(lines[start:end])).splitlines()
    names = [line.strip() for line in lines if re.match(r" {4}\S", line)]
    text = re.sub(r"\s+", " ", " ".join(lines)).strip(" .")
    if text.startswith("Missing from"):
        return f"missing: {', '.join(names)}"
    unread = re.match(r"Error parsing (\S+): no type matching (.*) could be .* from \[(.*)\]", text)
    percent = " without %, such as 0.05 for 5 %" if "%" in text else ""
    if unread:
        kind = next((KINDS[k] for k in KINDS if k in unread[2]), "a valid value")
        return f"{unread[1]} {unread[3]}: expected {kind}{percent}"
    number = re.match(r"Error parsing (\S+): .*(float|int\(\)).*?: (.*)", text)
    if number:
        return f"{number[1]} {number[3]}: expected {KINDS[number[2].strip('()').upper()]}{percent}"
    numbers = re.match(r"Error parsing (\S+): .*valid parse for arguments: \[(.*)\]", text)
    if numbers:
        return f"{numbers[1]} {numbers[2]}: expected numbers with spaces between, such as 1 2"
    bare = re.match(r"Missing value for argument '(.*?)'", text)
    if bare:
        return f"{bare[1]}: its value is missing"
    choice = re.match(r"invalid choice (.*) for argument '(.*)'. Expected one of \((.*)\)", text)
    if choice:
        allowed = sorted(set(re.findall(r"[\w-]+", choice[3])) - {"None"})
        question = meant(choice[1].strip("'").lower(), allowed)
        return f"{choice[2]} {choice[1]}{question}: allowed are {', '.join(allowed)}"
    return text[:1].lower() + text[1:] if text else "invalid command line"
