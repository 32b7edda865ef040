"""Our docstrings as griffe reads them: sections of `name: text`, and `#:` above a constant.

Griffe's NumPy parser takes what follows `name:` for a type. Its Google parser takes it for the
text, so that sections are written as that one expects them.
"""

import ast
import re
from typing import Any

import griffe

SECTIONS = {"Parameters": "Args:", "Attributes": "Attributes:", "Returns": "Returns:",
            "Yields": "Yields:", "Raises": "Raises:"}  # fmt: skip
SECTION = re.compile(r"^(\w+)\n-{3,}\n(.*?)(?=\n\w+\n-{3,}\n|\Z)", re.DOTALL | re.MULTILINE)


def google(text: str) -> str:
    """A docstring with its sections in Google's style."""

    def each(found: re.Match[str]) -> str:
        return "\n".join(f"{name}: {found[2]}" for name in found[1].split(", "))

    def section(found: re.Match[str]) -> str:
        name, body = found[1], found[2].strip()
        if name == "Raises":  # the type and its reason stand on one line
            body = re.sub(r"^(\S+)\n\s+", r"\1: ", body, flags=re.MULTILINE)
        else:  # names that share a text get it each
            body = re.sub(r"^(\w+(?:, \w+)+): (.*(?:\n .*)*)", each, body, flags=re.MULTILINE)
        lines = "\n".join(f"    {line}" if line else "" for line in body.split("\n"))
        return f"{SECTIONS[name]}\n{lines}\n"

    return SECTION.sub(section, text)


def comment_above(lines: list[str], line: int) -> str:
    """Text of the `#:` comments that end above a line, counted from 1."""
    found = []
    for above in reversed(lines[: line - 1]):
        if not above.lstrip().startswith("#:"):
            break
        found.append(above.strip().removeprefix("#:").strip())
    return "\n".join(reversed(found))


class Docstrings(griffe.Extension):
    """Applied to every object that has a docstring or should have one."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the sections of a docstring."""
        if obj.docstring is not None:
            obj.docstring.value = google(obj.docstring.value)

    def on_attribute_instance(
        self, *, node: ast.AST | griffe.ObjectNode, attr: griffe.Attribute, **_: Any
    ) -> None:
        """Take the comment above a constant as its docstring."""
        if attr.docstring is None and isinstance(node, ast.AST) and attr.lineno is not None:
            text = comment_above(list(attr.lines_collection[attr.filepath]), attr.lineno)
            if text:
                attr.docstring = griffe.Docstring(text, parent=attr, lineno=attr.lineno)
