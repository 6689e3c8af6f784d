"""Links of the documents lead somewhere, and nothing names where packages come from; the rest is in tests/documents."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def test_every_phony_target_is_described_or_internal() -> None:
    makefile = (ROOT / "Makefile").read_text()
    helped = re.findall(r"^([a-z-]+):.*## .", makefile, re.MULTILINE)

    assert {"venv", "demo", "test", "check", "help"} <= set(helped)


OURS = ("docs", "firmware_protocol", "gateway", "mapper", "simulator", "studies", "docker")


@pytest.mark.parametrize(
    "path", [*ROOT.glob("*.md"), *(one for name in OURS for one in sorted((ROOT / name).rglob("*.md")))], ids=lambda p: p.name
)
def test_links_between_documents_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)", path.read_text()):
        if "://" not in target:
            assert (path.parent / target).exists(), target


def test_no_document_names_a_registry_host() -> None:
    hosts = re.compile(r"(pypi|pythonhosted|npmjs|deb\.debian)\.(org|com)")
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.splitlines()
    for name in tracked:
        if name != "tests/test_docs.py" and (ROOT / name).suffix in {".md", ".txt", ".toml", ".sh", ".yaml", ".py", ""}:
            assert not hosts.search((ROOT / name).read_text(errors="replace")), name
