"""Four pages are the doors to all others, and each reader comes from the README to theirs."""

import re
from pathlib import Path

from studies.architecture import draw_architecture
from tests.documents.commands import ROOT

DOCS = ROOT / "docs"
DOORS = [DOCS / f"{name}.md" for name in ("operator", "integrator", "firmware-engineer", "developer")]


def links(page: Path) -> set[Path]:
    """Return the documents that a page leads to."""
    targets = re.findall(r"\]\(([^)#]+\.md)", page.read_text())
    found = {(page.parent / target).resolve() for target in targets if "://" not in target}
    return {one for one in found if one.exists()}  # tests/test_docs.py names those that do not


def test_every_page_is_reached_from_a_door() -> None:
    reached: set[Path] = set()
    ahead = {*DOORS, DOCS / "README.md"}
    while ahead:
        page = ahead.pop()
        reached.add(page)
        ahead |= links(page) - reached

    pages = {*DOCS.rglob("*.md"), *(ROOT / "firmware_protocol").rglob("*.md"), *(ROOT / "mapper").rglob("*.md")}
    lost = sorted(str(page.relative_to(ROOT)) for page in pages - reached)
    assert not lost, (
        f"link them from docs/operator.md, integrator.md, firmware-engineer.md or developer.md, or a page that these lead to: {lost}"
    )


def test_the_readme_leads_to_every_door() -> None:
    assert {*DOORS, DOCS / "README.md"} <= links(ROOT / "README.md")


def test_every_decision_is_in_their_list() -> None:
    assert {*(DOCS / "adr").glob("0*.md")} <= links(DOCS / "adr" / "README.md")


def test_pictures_are_shown_small_and_as_the_command_makes_them() -> None:
    """They are in every clone. Those of the page differ from run to run: which instant they caught is chance."""
    pictures = {*(DOCS / "pictures").iterdir()}
    shown = {
        (page.parent / target).resolve()
        for page in (ROOT / "README.md", *DOCS.rglob("*.md"))
        for target in re.findall(r"!\[[^]]*\]\(([^)#]+)", page.read_text())
    }

    assert pictures
    assert pictures <= shown
    assert sum(one.stat().st_size for one in pictures) <= 1_000_000
    assert (DOCS / "pictures" / "architecture.svg").read_text() == draw_architecture(), "run: make pictures ARGS=--only-drawn"
