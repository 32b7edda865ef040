"""Pages hold everything that they show, and text of any kind is text on them."""

import re
from pathlib import Path
from xml.etree import ElementTree

from markupsafe import Markup

import chromagrip
from chromagrip.output.page import POLICY, PageSection, filled, inline_png, write_page
from chromagrip.output.report import Table


def test_a_page_holds_its_sections_and_escapes_their_text(tmp_path: Path) -> None:
    odd = '<b> & "quotes"'
    table = Table(("a", odd), (("1", odd), ("2", "µ")), title=odd)
    section = PageSection(
        anchor="one", name=f"name {odd}", title=f"title {odd}", picture=inline_png(b"picture", odd),
        verdict="differs", sentence=f"sentence {odd}", tables=[table], notes=[odd],
    )  # fmt: skip
    introduction = [odd, Markup("<i>emphasis</i>")]
    write_page(tmp_path / "page.html", odd, introduction, [section])
    page = ElementTree.parse(tmp_path / "page.html").getroot()
    assert page.findtext("head/title") == odd
    paragraphs = page.findall("body/p")
    assert paragraphs[0].text == odd
    assert paragraphs[1].findtext("i") == "emphasis"
    (one,) = page.findall("body/section")
    links = [link.get("href") for link in page.findall("body/table/tr/td/a")]
    assert links == ["#one"] == [f"#{one.get('id')}"]
    assert one.findtext("h2/em") == "differs"
    assert one.findtext("p") == f"sentence {odd}"
    assert (one.findtext("h2") or "").startswith(f"title {odd}")
    assert [cell.text for cell in one.findall(".//td")] == ["1", odd, "2", "µ"]
    assert [cell.text for cell in one.findall(".//th")] == ["a", odd]
    assert one.findtext("p[@class='note']") == odd
    image = one.find("img")
    assert image is not None
    assert image.get("alt") == odd
    assert image.get("src") == "data:image/png;base64,cGljdHVyZQ=="


HOME = Path(chromagrip.__file__).parent
TEMPLATES = sorted(path.relative_to(HOME).as_posix() for path in HOME.rglob("*.html"))


def test_every_page_loads_nothing_and_is_of_a_template() -> None:
    """A browser keeps the policy from the element on that holds it: it comes before all others."""
    assert TEMPLATES == ["output/page.html", "output/run_page.html"]
    assert POLICY.startswith("default-src 'none'; base-uri 'none'; form-action 'none'; ")
    policy = f'<meta http-equiv="Content-Security-Policy" content="{POLICY}"/>'
    for template in TEMPLATES:
        text = filled(template.rpartition("/")[2], title="</title><script>1</script>")
        before, found, after = text.partition(policy)
        assert found
        assert set(re.findall(r"<(\w+)", before)) <= {"html", "head", "meta"}
        assert "<title>&lt;/title&gt;&lt;script&gt;1" in after
        assert not re.search(r"(src|href)=[\"']?(https?:|//)", text)
    for path in HOME.rglob("*.py"):
        assert not re.search("<!doctype|<html", path.read_text(encoding="utf-8"), re.IGNORECASE)
