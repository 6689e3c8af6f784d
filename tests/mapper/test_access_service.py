"""Access to `biobot-mapper serve` as a process: the first token, TLS, tokens that others change, and a log that holds no secret."""

import json
import ssl
from datetime import UTC, datetime
from http import HTTPStatus
from pathlib import Path

import httpx
import pytest
from cryptography.hazmat.primitives import serialization

from firmware_protocol.contract.access import Identity
from firmware_protocol.contract.access import Role as BusRole
from gateway.certificates import Authority
from mapper.__main__ import main
from mapper.access import Role, add_token, contains_token, read_tokens
from studies.ports import free_port
from tests.mapper.serving import serving, token_of, until


def certificate(directory: Path, *, host: str) -> tuple[Path, Path]:
    """Make an authority and the certificate of a mapper, as `biobot-gateway certs` does; return its folder and the authority's own."""
    now = datetime.now(UTC)
    authority = Authority.init(directory / "pki", name="test", days=30, now=now)
    folder = authority.issue(Identity(site="local", role=BusRole.MAPPER, name="map1"), hosts=[host], days=10, now=now)
    return folder, directory / "pki" / "ca.pem"


def test_no_secret_leaves_the_service_but_to_its_holder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A whole life by https: every kind of wrong request, at the most talkative log level, and each answer and each line is searched."""
    folder, authority = certificate(tmp_path, host="127.0.0.1")
    monkeypatch.setenv("BIOBOT_MAPPER__SERVE__CERTIFICATE", str(folder / "certificate.pem"))
    monkeypatch.setenv("BIOBOT_MAPPER__SERVE__KEY", str(folder / "key.pem"))
    first, tokens = tmp_path / "first", tmp_path / "own.json"
    arguments = ["--log-level", "DEBUG", "--tokens", str(tokens), "--token-file", str(first)]
    context = ssl.create_default_context(cafile=str(authority))
    said: list[httpx.Response] = []
    secrets = []
    with (
        serving(tmp_path, connect=free_port(), arguments=arguments) as (url, _process),
        httpx.Client(base_url=url, verify=context, timeout=60) as client,
    ):
        assert url.startswith("https://")
        admin = first.read_text().strip()
        shown = {"Authorization": f"Bearer {admin}"}
        made = client.post("api/v1/tokens", json={"name": "bert", "role": "operator"}, headers=shown)
        assert made.status_code == HTTPStatus.CREATED
        bert = made.json()["token"]
        secrets = [token.rpartition("_")[2] for token in (admin, bert, token_of(tmp_path))]
        for token in (admin, bert, bert[:-1], f"{bert}0", token_of(tmp_path)):
            for how in ({"Authorization": f"Bearer {token}"}, {"Authorization": f"Basic {token}"}, {"X-Token": token}):
                said += [
                    client.get("api/v1/me", headers=how),
                    client.get("api/v1/tokens", headers=how),
                    client.get(f"api/v1/commands/{token}", headers=how),
                    client.get("api/v1/map", params={"x": token}, headers=how),
                    client.post("api/v1/stop", content=b"{", headers=how),
                    client.get("healthz", headers={**how, "Host": "127.0.0.1"}),
                ]
        assert {answer.status_code for answer in said} >= {200, 400, 401, 403, 422, 429}
        assert all("strict-transport-security" in answer.headers for answer in said)
        # Another process changes the tokens, and the service heeds it.
        assert main(["tokens", "revoke", bert.split("_")[1], "--tokens", str(tokens)]) == 0
        until(lambda: client.get("api/v1/me", headers={"Authorization": f"Bearer {bert}"}).status_code in {401, 429})
        assert client.get("api/v1/me", headers=shown).json()["role"] == "admin"
        # One that is made is known to the very next request, though the file is looked at once a second.
        made_by_hand = [add_token(tokens, name=f"new {n}", role=Role.VIEWER).text for n in range(5)]
        assert [client.get("api/v1/me", headers={"Authorization": f"Bearer {token}"}).status_code for token in made_by_hand] == [200] * 5
        secrets += [token.rpartition("_")[2] for token in made_by_hand]
    log = (tmp_path / "mapper.log").read_text()
    assert "access.first_token" in log
    assert "access.wrong_token" in log
    assert not contains_token(log)
    for secret in secrets:
        assert secret[:16] not in log
        assert all(secret[:16] not in answer.text for answer in said)
        assert secret[:16] not in tokens.read_text()
    uses = {record.name: record.last_used_wall_ns for record in read_tokens(tokens) or ()}
    assert uses["admin"] is not None  # noted when it ended
    with pytest.raises(httpx.HTTPError), httpx.Client() as plain:
        plain.get(url.replace("https", "http"))


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ({"CERTIFICATE": "certificate.pem"}, "serve.certificate is given without serve.key"),
        ({"CERTIFICATE": "none.pem", "KEY": "key.pem"}, "none.pem: cannot be read"),
        ({"CERTIFICATE": "certificate.pem", "KEY": "other.pem"}, "are not of each other"),
        ({"CERTIFICATE": "certificate.pem", "KEY": "certificate.pem"}, "cannot be used"),
        ({"CERTIFICATE": "certificate.pem", "KEY": "locked.pem"}, "is locked by a passphrase"),
        ({"TOKENS": "open.json"}, "others than its owner may use it"),
        ({"TOKENS": "broken.json"}, "is damaged"),
    ],
)
def test_files_that_do_not_fit_are_told_before_anything_is_opened(
    tmp_path: Path, environment: dict[str, str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _ = certificate(tmp_path, host="127.0.0.1")
    now = datetime.now(UTC)
    other = Authority.open(tmp_path / "pki").issue(Identity(site="local", role=BusRole.MAPPER, name="map2"), hosts=[], days=10, now=now)
    (folder / "other.pem").write_bytes((other / "key.pem").read_bytes())
    locking = serialization.BestAvailableEncryption(b"a phrase")
    key = serialization.load_pem_private_key((folder / "key.pem").read_bytes(), password=None)
    pem = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, locking)
    (folder / "locked.pem").write_bytes(pem)
    (folder / "open.json").write_text("{}")
    (folder / "broken.json").write_text("{")
    (folder / "broken.json").chmod(0o600)
    for name, file in environment.items():
        monkeypatch.setenv(f"BIOBOT_MAPPER__SERVE__{name}", str(folder / file))
    assert main(["serve", "--port", "0", "--check-config"]) == 2
    assert message in capsys.readouterr().err


def test_whoever_lets_others_in_without_tls_is_warned(tmp_path: Path) -> None:
    with serving(tmp_path, connect=free_port(), arguments=["--allow-remote"]) as (url, _process):
        assert httpx.get(url + "api/v1/biobots", timeout=60).status_code == HTTPStatus.UNAUTHORIZED
        assert httpx.get(url + "healthz", timeout=60).status_code == HTTPStatus.OK
    events = [json.loads(line) for line in (tmp_path / "mapper.log").read_text().splitlines() if line.startswith("{")]
    told = {event["event"]: event for event in events}
    assert told["access.readable"]["level"] == "WARNING"
    assert told["access.no_admin"]["level"] == "WARNING"
