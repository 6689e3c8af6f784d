"""What the documents say is true: commands run, flags and keys are listed, links lead somewhere."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from firmware_protocol.configuration_text import configuration_keys
from gateway.journal_file import open_journal_file
from studies.reference import COMMANDS, CONFIGURATIONS, VARIABLES, help_text

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
REFERENCE = (ROOT / "docs" / "reference.md").read_text()
MODULES = {program: module for program, (module, _) in COMMANDS.items()}


def readme_commands() -> list[str]:
    lines = [line.split("#")[0].strip() for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL) for line in block.splitlines()]
    return [line for line in lines if line]


def run(command: str, *more: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command, _, target = command.partition(" > ")
    program, *arguments = shlex.split(command)
    module = MODULES[Path(program).name]
    result = subprocess.run(
        [sys.executable, "-m", module, *arguments, *more], cwd=cwd, capture_output=True, text=True, timeout=120, check=False
    )
    if target:
        (cwd / target).write_text(result.stdout)
    return result


@pytest.mark.e2e
def test_the_commands_of_the_readme_run(tmp_path: Path) -> None:
    """Those that wait for hardware or a signal are checked as far as their configuration."""
    ran = 0
    open_journal_file(tmp_path / "gateway.sqlite", now_wall_ns=10**18, now_ns=0, machine_boot="").close()
    for command in readme_commands():
        if not command.startswith(".venv/bin/"):
            continue
        more = ["--check-config"] if " serve " in command or "--port" in command else []
        result = run(command.replace("by-id/usb-...", "by-id/usb-x"), *more, cwd=tmp_path)
        if " probe " in command:  # there is nothing to be asked here, and it says so
            assert result.returncode == 1, (command, result.stderr)
            assert "there is no /dev/serial/by-id/usb-x" in result.stdout
        elif re.search(r" (status|command|steer|stop|mission)\b", command):  # nor is anybody there who could tell or obey
            assert result.returncode == 1, (command, result.stderr)
            assert "nobody listens there" in result.stderr
        else:
            assert result.returncode == 0, (command, result.stderr)
        ran += 1
    assert ran >= 5
    assert (tmp_path / "map.svg").read_text().lstrip().startswith("<?xml")


def test_every_make_target_of_the_readme_exists() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {shlex.split(command)[1] for command in readme_commands() if command.startswith("make ")}

    assert named
    assert named <= targets


def test_every_phony_target_is_described_or_internal() -> None:
    makefile = (ROOT / "Makefile").read_text()
    helped = re.findall(r"^([a-z-]+):.*## .", makefile, re.MULTILINE)

    assert {"venv", "demo", "test", "check", "help"} <= set(helped)


@pytest.mark.parametrize(("program", "command"), [(p, c) for p, (_, commands) in COMMANDS.items() for c in (None, *commands)])
def test_every_flag_is_in_the_reference(program: str, command: str | None) -> None:
    title = f"## {program}{' ' + command if command else ''}\n"
    section = REFERENCE.split(title)[1].split("\n## ")[0]
    flags = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", help_text(MODULES[program], command)))

    assert flags
    assert flags <= set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", section)), "run: python -m studies.reference > docs/reference.md"


@pytest.mark.parametrize("title", CONFIGURATIONS)
def test_every_configuration_key_is_in_the_reference(title: str) -> None:
    section = REFERENCE.split(f"### {title}\n")[1].split("\n### ")[0]

    for key, kind, default in configuration_keys(CONFIGURATIONS[title]):
        assert f"| `{key}` | {kind} | {default} |" in section, "run: python -m studies.reference > docs/reference.md"


def test_every_further_variable_is_in_the_reference_and_its_values_are_taken() -> None:
    section = REFERENCE.split("## Further environment variables\n")[1]
    for name, (kind, meaning) in VARIABLES.items():
        assert f"| `{name}` | {' or '.join(f'`{one.value}`' for one in kind)} | {meaning} |" in section
        for value in kind:
            environment = os.environ | {name: str(value.value)}
            subprocess.run([sys.executable, "-m", "mapper", "--check-config"], env=environment, check=True, timeout=60)


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
