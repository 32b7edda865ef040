"""What the site has beside docs/: a page for each public name, and pages that lie outside docs/."""

import ast
import os
import re
import sys
from pathlib import Path
from typing import Any

import griffe
import nbformat
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))
from notebook import notebook

ROOT = Path(__file__).parents[2]
#: Packages whose public names have a page each, in this order.
PACKAGES = ("", "model", "render", "tracking", "control", "loop", "dataset")
#: Pages outside docs/, and where they stand in the site.
OUTSIDE = {
    "CONTRIBUTING.md": "CONTRIBUTING.md",
    "CHANGELOG.md": "CHANGELOG.md",
    "fixtures/README.md": "fixtures.md",
    "README.md": "overview.md",
}
#: Weights of pages in the search, by the beginning of their places.
BOOSTS = {
    "reference": 0.3,
    "appendix": 0.3,
    "CHANGELOG.md": 0.1,
    "symbols.md": 3,
    "tutorials": 2,
    "overview.md": 2,
}


def public_names(package: str) -> list[str]:
    """Names in `__all__` of a package of chromagrip; "" is chromagrip itself."""
    source = (ROOT / "src/chromagrip" / package / "__init__.py").read_text(encoding="utf-8")
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return list(ast.literal_eval(node.value))
    raise ValueError(f"chromagrip.{package} has no __all__")


def place_of(package: str, name: str) -> str:
    """Page of a public name."""
    return "/".join(filter(None, ["reference", package, f"{name.strip('_')}.md"]))


def site_place(path: str) -> str | None:
    """Place in the site of a file of the repository, None where it has none."""
    if path in OUTSIDE:
        return OUTSIDE[path]
    return path.removeprefix("docs/") if path.startswith("docs/") else None


def rewritten(text: str, path: str, place: str) -> str:
    """Markdown of a file of the repository, with links that hold in the site.

    Parameters
    ----------
    path: of the file in the repository
    place: of the page in the site
    """

    def link(found: re.Match[str]) -> str:
        target, _, part = found[1].partition("#")
        if "://" in target or not target:
            return found[0]
        leads_to = site_place(os.path.normpath(os.path.join(os.path.dirname(path), target)))
        if leads_to is None:
            return found[0]  # and mkdocs refuses it
        relative = os.path.relpath(leads_to, os.path.dirname(place) or ".")
        return f"]({relative}{'#' * bool(part)}{part})"

    return re.sub(r"\]\(([^)\s]+)\)", link, text)


def first_lines() -> dict[str, dict[str, str]]:
    """First line of the docstring of every public name, by package and name."""
    extensions = griffe.load_extensions(str(ROOT / "docs/website/docstrings.py"))
    loaded = griffe.load("chromagrip", search_paths=[ROOT / "src"], extensions=extensions)
    found: dict[str, dict[str, str]] = {}
    for package in PACKAGES:
        found[package] = {}
        for name in public_names(package):
            if name != "__version__":
                target = loaded[f"{package}.{name}".strip(".")]
                text = target.docstring.value if target.docstring else ""
                if not text:
                    raise PluginError(f"{target.path} has no docstring: write one")
                found[package][name] = text.split("\n")[0]
    return found


def index_of(package: str, lines: dict[str, str]) -> str:
    """Page that lists the public names of a package with the first lines of their docstrings."""
    title = f"chromagrip.{package}".rstrip(".")
    rows = [
        f"| [`{name}`]({Path(place_of(package, name)).name}) | {line} |"
        for name, line in lines.items()
    ]
    packages = [f"[chromagrip.{p}]({p}/index.md)" for p in PACKAGES if p]
    return "\n".join(
        [f"# {title}", "", f"::: {title}", "    options:", "      members: false"]
        + ["      show_root_heading: false", "      show_source: false", ""]
        + ["## Public names", "", "| name | what it is |", "|---|---|", *rows, ""]
        + ([] if package else ["## Packages", "", *(f"- {link}" for link in packages), ""])
    )


def on_config(config: Any, **_: Any) -> Any:
    """List the made pages in the navigation: the public names, and the appendix."""
    python: list[Any] = []
    for package in PACKAGES:
        home = "/".join(filter(None, ["reference", package, "index.md"]))
        names = [
            {name: place_of(package, name)}
            for name in public_names(package)
            if name != "__version__"
        ]
        python.append({f"chromagrip.{package}".rstrip("."): [home, *names]})
    appendix = sorted((ROOT / "docs/appendix").glob("*.md"))
    config.nav += [
        {"Appendix": [f"appendix/{page.name}" for page in appendix]},
        {"Project": [*OUTSIDE.values()]},
    ]
    for section in config.nav:
        if "Reference" in section:
            section["Reference"].append({"Python": python})
    return config


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add the pages that are made."""

    def add(place: str, text: str) -> None:
        files.append(File.generated(config, place, content=text))

    for path, place in OUTSIDE.items():
        add(place, rewritten((ROOT / path).read_text(encoding="utf-8"), path, place))
    for page in sorted((ROOT / "docs/tutorials").glob("*.md")):
        add(
            f"tutorials/{page.stem}.ipynb",
            nbformat.writes(notebook(page.read_text(encoding="utf-8"))),
        )
    for name in ("extra.css", "iframe-worker.js"):
        add(f"assets/{name}", (ROOT / "docs/website" / name).read_text(encoding="utf-8"))
    for package, lines in first_lines().items():
        add("/".join(filter(None, ["reference", package, "index.md"])), index_of(package, lines))
        for name in lines:
            dotted = ".".join(filter(None, ["chromagrip", package, name]))
            add(place_of(package, name), f"::: {dotted}\n")
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links of docs/ to pages outside it lead to these."""
    place = page.file.src_uri
    # Pages that explain come before those that list.
    page.meta.setdefault("search", {"boost": BOOSTS.get(place.split("/")[0], 1)})
    if page.file.generated_by:
        return markdown
    if place.startswith("tutorials/"):
        link = f"[This page as a notebook]({Path(place).stem}.ipynb)"
        markdown = markdown.replace("\n## ", f"\n{link}\n\n## ", 1)
    return rewritten(markdown, f"docs/{place}", place)
