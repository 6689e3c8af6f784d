"""The configurations that documents show whole are what the programs take, with the certificates that the same page has issued."""

import contextlib
from pathlib import Path

import pytest

from firmware_protocol.contract.access import Role
from gateway.config_loading import load_gateway_config
from tests.documents.commands import ROOT, block_commands, blocks
from tests.documents.test_commands import run

CHECKS = {"router": ("biobot-gateway", "router"), "gateway": ("biobot-gateway", "run"), "mapper": ("biobot-mapper", "serve")}


@pytest.mark.parametrize("document", ["docs/zenoh.md", "docs/sites.md"])
def test_a_site_as_a_page_shows_it_is_one_that_the_programs_take(document: str, tmp_path: Path) -> None:
    whole = {text.split()[1]: text for language, text in blocks(ROOT / document) if language == "toml"}
    assert {f"{name}.toml" for name in CHECKS} <= whole.keys()
    with contextlib.chdir(tmp_path):
        for command in block_commands():
            if command.document == document and command.text.startswith("biobot-gateway certs i"):
                assert run(command.words).status == 0
        for name, text in whole.items():
            Path(name).write_text(text)
            service = CHECKS.get(name.removesuffix(".toml"))
            if service is None:  # of somebody who commands
                load_gateway_config(toml_path=Path(name), needs_radio=False, roles=(Role.OPERATOR,))
                continue
            ended = run([*service, "--config", name, "--check-config"])
            assert ended.status == 0, (name, ended.everything)
