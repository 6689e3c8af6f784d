"""docs/reference.md has every command, flag, key, variable, request, refusal and metric that the code has, with its meaning."""

import re

import pytest

from firmware_protocol.contract.keys import Stream
from firmware_protocol.envelope import RadioStatus
from firmware_protocol.messages import ConfigurationResult, MessageFault, StimulationResult
from mapper.__main__ import main
from mapper.alert_book import AlertKind
from mapper.kernels import KERNELS_VARIABLE
from mapper.types import KernelsKind
from studies.reference import COMMANDS, KERNELS, VARIABLES, configuration_tables, help_text, list_commands
from studies.reference_tables import code_tables, operations
from tests.documents.commands import ROOT

REFERENCE = (ROOT / "docs" / "reference.md").read_text()
MAKE_IT = "run: python -m studies.reference > docs/reference.md"


@pytest.mark.parametrize("program", COMMANDS)
def test_every_command_and_flag_is_in_the_reference(program: str) -> None:
    """Help is laid out by the interpreter, and each version has its own ways: flags are looked for, not the text."""
    module, commands = COMMANDS[program]
    assert sorted(commands) == sorted(list_commands(module))
    for command in (None, *commands):
        section = REFERENCE.split(f"## {program}{' ' + command if command else ''}\n")[1].split("\n## ")[0]
        flags = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", help_text(module, command)))
        assert flags
        assert flags <= set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", section)), MAKE_IT


def test_every_key_and_variable_is_in_the_reference_with_its_meaning() -> None:
    assert "\n".join(configuration_tables()) in REFERENCE, MAKE_IT


def test_every_request_error_refusal_and_metric_is_in_the_reference_with_its_meaning() -> None:
    assert "\n".join(code_tables()) in REFERENCE, MAKE_IT


def test_no_row_of_the_reference_is_without_a_meaning() -> None:
    rows = re.findall(r"^\| `.*\|$", REFERENCE, re.MULTILINE)

    assert len(rows) > 300
    assert not [row for row in rows if row.endswith("|  |")]


def test_every_variable_that_the_code_reads_is_in_the_reference() -> None:
    named = set()
    for package in ("firmware_protocol", "gateway", "mapper", "simulator"):
        for path in (ROOT / package).rglob("*.py"):
            named |= set(re.findall(r"environ(?:ment)?(?:\.get\(|\[)\"(\w+)\"", path.read_text()))
    named |= set(re.findall(r"environ\.get\(\"(\w+)\"", (ROOT / "hatch_build.py").read_text()))

    assert named
    assert named <= set(VARIABLES)


@pytest.mark.parametrize("value", KERNELS[0])
def test_every_value_of_the_kernels_variable_is_taken(value: KernelsKind, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KERNELS_VARIABLE, str(value))

    assert main(["--check-config"]) == 0


def test_every_request_is_on_the_page_about_rest_or_those_it_leads_to() -> None:
    pages = "".join(
        (ROOT / "docs" / f"{name}.md").read_text() for name in ("rest", "access", "commands", "past", "map-on-the-page", "live")
    )
    for _, path, _ in operations():
        short = path.removeprefix("/api/v1/")
        names = {short, path, short.split("/")[0], re.sub(r".*\.", ".", short)}
        assert any(f"`{name}" in pages or f" {name}" in pages for name in names), path


def test_every_kind_of_alert_has_a_row() -> None:
    table = (ROOT / "docs" / "past.md").read_text()
    for kind in AlertKind:
        assert f"\n| `{kind.value}` |" in table


def test_the_contract_has_every_stream() -> None:
    contract = (ROOT / "firmware_protocol" / "contract" / "CONTRACT.md").read_text()
    for stream in Stream:
        assert stream.value in contract


def test_the_wire_format_has_every_outcome_and_fault() -> None:
    text = (ROOT / "firmware_protocol" / "WIRE_FORMAT.md").read_text().lower()
    for kind in (RadioStatus, StimulationResult, ConfigurationResult):
        for one in kind:
            assert re.search(rf"\b{one.value}\b[ |]+(\*\*|`)?{one.name.lower().split('_')[0]}", text), one
    for fault in MessageFault:
        assert f"`{fault.value}`" in text
