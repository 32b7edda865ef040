"""A tutorial as a notebook: its blocks of `python` and `bash` are the cells."""

import re
from pathlib import Path

import jupytext
from nbformat import NotebookNode

KERNEL = "{display_name: Python 3, language: python, name: python3}"
HEADER = f"---\njupyter:\n  kernelspec: {KERNEL}\n---\n\n"
#: A cell of a page, and the block of text below it that shows what it prints.
CELL = re.compile(
    r"(^```(?:bash|python)\n.*?^```\n)(?:\n```text\n.*?^```\n)?", re.DOTALL | re.MULTILINE
)
_LINES = 30  # of an output that a page shows


def notebook(text: str) -> NotebookNode:
    """Notebook of a page of Markdown, without what the page shows of its output."""
    return jupytext.reads(HEADER + CELL.sub(r"\1", text), fmt="md")


def executed(page: Path, folder: Path) -> NotebookNode:
    """Notebook of a page after it was run in a folder.

    Raises
    ------
    nbclient.exceptions.CellExecutionError
        When a cell fails.
    """
    from nbclient import NotebookClient

    book = notebook(page.read_text(encoding="utf-8"))
    where = {"metadata": {"path": str(folder)}}
    NotebookClient(book, timeout=600, kernel_name="python3", resources=where).execute()
    return book


def printed(cell: NotebookNode) -> str:
    """What a cell prints, without its bars of progress."""
    streams = [one for one in cell.outputs if one.output_type == "stream" and one.name == "stdout"]
    lines = "".join(one.text for one in streams).strip("\n").split("\n")
    dots = ["…"] * (len(lines) > _LINES)
    return "\n".join([line.rstrip() for line in lines[:_LINES]] + dots)


def with_outputs(text: str, book: NotebookNode) -> str:
    """Page of Markdown with what each cell of its executed notebook prints."""
    outputs = iter([printed(cell) for cell in book.cells if cell.cell_type == "code"])

    def filled(found: re.Match[str]) -> str:
        output = next(outputs)
        return found[1] + (f"\n```text\n{output}\n```\n" if output else "")

    return CELL.sub(filled, text)
