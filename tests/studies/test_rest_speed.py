"""The client that speed is measured with: it counts what a server answers, and leaves nothing unread."""

import asyncio
from pathlib import Path

from studies.bare_server import PATH
from studies.parts import Parts
from studies.rest_client import Ask, ask_for


def test_the_client_counts_what_the_bare_server_answers(tmp_path: Path) -> None:
    body = b'{"x":1}' * 3000
    (tmp_path / "body").write_bytes(body)
    with Parts(out=tmp_path) as parts:
        parts.start("bare", "studies.bare_server", "--body", tmp_path / "body", "--url-file", tmp_path / "url")
        parts.wait((tmp_path / "url").exists, what="bare server ready")
        url = (tmp_path / "url").read_text().strip()
        found = asyncio.run(ask_for(Ask(name="bare", url=url, path=PATH), seconds=0.1, n_connections=2))
        missing = asyncio.run(ask_for(Ask(name="none", url=url, path="/none"), seconds=0.05, n_connections=1))
    n = len(found.waits_s)
    assert n >= 2
    assert found.statuses == {200: n}
    assert found.n_bytes == n * len(body)
    assert set(missing.statuses) == {404}
