"""Results as an HTML page that holds everything it shows: nothing is loaded from elsewhere."""

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment
from markupsafe import Markup

from .report import Table, machine

#: What a page may load: what it holds itself.
POLICY = (
    "default-src 'none'; base-uri 'none'; form-action 'none'; img-src data:; "
    "media-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
)


@dataclass(frozen=True, kw_only=True)
class PageSection:
    """Part of a page.

    Attributes
    ----------
    anchor: that links lead to, without spaces
    name: in the list at the top of the page
    title: of the heading
    picture: element that shows the figure, from `inline_png` or an SVG
    verdict: `reproduced` or `differs`; empty for none
    sentence: result in words
    tables: below the picture
    notes: paragraphs below the tables
    """

    anchor: str
    name: str
    title: str
    picture: Markup
    verdict: str = ""
    sentence: str = ""
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()


def inline_png(data: bytes, text: str) -> Markup:
    """Image element with the picture in it.

    Parameters
    ----------
    data: PNG file
    text: description of the picture
    """
    encoded = base64.b64encode(data).decode("ascii")
    return Markup('<img src="data:image/png;base64,{}" alt="{}"/>').format(encoded, text)


def machine_text() -> str:
    """System, processor, cores and versions in one line."""
    return ", ".join(f"{key} {value}" for key, value in machine().items())


def write_page(
    path: Path, title: str, introduction: Iterable[str | Markup], sections: Sequence[PageSection]
) -> None:
    """Write a page: title, paragraphs, a list of the sections, the sections, and the machine."""
    text = filled(
        "page.html",
        title=title,
        introduction=introduction,
        sections=sections,
        machine=machine_text(),
    )
    path.write_text(text, encoding="utf-8")


def filled(template: str, **values: Any) -> str:
    """Text of a page of that template, with the policy of all pages; values are escaped."""
    text = (files(__package__) / template).read_text(encoding="utf-8")
    page = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(text)
    return page.render(**values, policy=Markup(POLICY)) + "\n"
