"""Laws of the authority: nothing is overwritten, keys are private, and what is unfit is named."""

import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import pytest

from firmware_protocol.contract.access import Role, parse_identity, parse_roster
from gateway.__main__ import main
from gateway.certificates import Authority, folder_of, list_certificates
from gateway.errors import CertificateError
from gateway.tls_files import check_tls_files
from tests.gateway.certified import Certified

NOW = datetime.now(UTC)


def test_keys_are_for_their_owner_alone_and_nothing_is_overwritten(tmp_path: Path) -> None:
    certified = Certified(tmp_path / "ca")
    tls = certified.tls("demo/gateway/base1")
    assert tls.key is not None
    for path in (tmp_path / "ca" / "ca.key", Path(tls.key)):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    before = Path(tls.key).read_bytes()
    with pytest.raises(CertificateError, match="there already; renew it with --renew"):
        Authority.open(tmp_path / "ca").issue(parse_identity("demo/gateway/base1"), hosts=[], days=1, now=NOW)
    with pytest.raises(CertificateError, match="there is an authority already"):
        Authority.init(tmp_path / "ca", name="again", days=1, now=NOW)
    assert Path(tls.key).read_bytes() == before
    Authority.open(tmp_path / "ca").issue(parse_identity("demo/gateway/base1"), hosts=[], days=9, now=NOW, renew=True)
    assert Path(f"{tls.key}.old").read_bytes() == before
    found = {one.identity: one for one in list_certificates(tmp_path / "ca", now=NOW)}
    assert found["demo/gateway/base1"].hosts == ("127.0.0.1",)  # a renewal keeps the hosts
    assert parse_roster(certified.roster.read_text())[0] == [parse_identity("demo/gateway/base1")]
    assert check_tls_files(tls, roles=(Role.GATEWAY,), site="demo", name="base1").problems == ()


def test_a_fault_names_file_reason_and_next_step(tmp_path: Path) -> None:
    with pytest.raises(CertificateError, match=r"ca\.pem: no such file or directory; make an authority"):
        Authority.open(tmp_path / "none")
    certified = Certified(tmp_path / "ca")
    authority = Authority.open(tmp_path / "ca")
    with pytest.raises(CertificateError, match="'base 1' is no host name and no address"):
        authority.issue(parse_identity("demo/router/main"), hosts=["base 1"], days=1, now=NOW)
    with pytest.raises(CertificateError, match="the authority lasts 36"):
        authority.issue(parse_identity("demo/router/main"), hosts=[], days=9999, now=NOW)
    tls = certified.tls("demo/gateway/base1", days=20)
    key = folder_of(tmp_path / "ca", parse_identity("demo/gateway/base1")) / "key.pem"
    key.chmod(0o644)
    later = NOW + timedelta(days=30)
    problems = " ".join(problem for one in list_certificates(tmp_path / "ca", now=later) for problem in one.problems)
    assert "out of date" in problems
    assert "may be read by others" in problems
    report = check_tls_files(msgspec.structs.replace(tls, key=str(tmp_path / "ca" / "ca.key")), roles=(Role.GATEWAY,))
    assert "do not belong together" in report.problems[0]
    report = check_tls_files(msgspec.structs.replace(tls, ca=str(tmp_path / "gone"), key=str(tmp_path / "gone2")), roles=(Role.GATEWAY,))
    assert len(report.problems) == 2
    report = check_tls_files(msgspec.structs.replace(tls, ca=str(certified.roster)), roles=(Role.GATEWAY,))
    assert "holds no certificate" in report.problems[0]
    report = check_tls_files(tls, roles=(Role.GATEWAY,), site="demo", name="base2")
    assert "it is for demo/gateway/base1" in report.problems[0]


def test_the_command_line_makes_a_site_and_a_configuration_that_is_valid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pki = str(tmp_path / "pki")
    assert main(["certs", "init", pki]) == 0
    assert main(["certs", "issue", pki, "router", "main", "--host", "192.0.2.1"]) == 0
    capsys.readouterr()
    assert main(["certs", "issue", pki, "gateway", "base1", "--site", "demo"]) == 0
    (tmp_path / "gateway.toml").write_text(capsys.readouterr().out)
    assert main(["run", "--config", str(tmp_path / "gateway.toml"), "--port", "tcp:127.0.0.1:1", "--check-config"]) == 0
    assert main(["certs", "check", pki]) == 0
    assert main(["certs", "issue", pki, "viewer", "bob", "--days", "5"]) == 0
    capsys.readouterr()
    assert main(["certs", "check", pki]) == 1
    assert "local/viewer/bob: until" in capsys.readouterr().out


def test_a_certificate_that_would_be_of_no_use_is_refused_and_a_site_that_was_taken_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pki = str(tmp_path / "pki")
    assert main(["certs", "init", pki]) == 0
    assert main(["certs", "issue", pki, "router", "main"]) == 1
    assert "a router's certificate without a host lets nobody connect; issue it with --host ADDRESS" in capsys.readouterr().err
    assert main(["certs", "issue", pki, "router", "main", "--host", "192.0.2.1"]) == 0
    assert main(["certs", "issue", pki, "router", "main", "--renew"]) == 0, "the hosts of the one before are taken"
    assert main(["certs", "check", pki]) == 0
    capsys.readouterr()
    assert main(["certs", "issue", pki, "gateway", "base1", "--site", "demo"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["certs", "issue", pki, "mapper", "map1"]) == 0
    warned = capsys.readouterr().err
    assert "no --site: it is for site local" in warned
    assert "warning: the others of this authority are of site demo, and do not hear it: --site demo if it belongs there" in warned
    other = str(tmp_path / "other")
    assert main(["certs", "init", other]) == 0
    assert main(["certs", "issue", other, "gateway", "base1"]) == 0
    told = capsys.readouterr()
    assert told.err.splitlines() == [
        "biobot-gateway: no --site: it is for site local, which services are of where their configuration names none"
    ]
    assert 'site = "local"' in told.out
    # No router is known to that authority; the first one's host is, where there is one.
    assert 'connect = ["tls/ROUTER:7447"]' in told.out
    (tmp_path / "gateway.toml").write_text(told.out[told.out.index("# for") :])
    assert main(["run", "--config", str(tmp_path / "gateway.toml"), "--port", "tcp:127.0.0.1:1", "--check-config"]) == 0
    assert "connect: tls/ROUTER:7447: ROUTER stands for the router's address; put its name or address" in capsys.readouterr().err
    assert main(["certs", "issue", pki, "operator", "alice", "--site", "demo"]) == 0
    assert 'connect = ["tls/192.0.2.1:7447"]' in capsys.readouterr().out


def test_each_fault_of_a_routers_configuration_names_its_file_or_flag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "router.toml"
    file.write_text(f'listen = ["tls/0.0.0.0"]\nroster = "{tmp_path}/none"\n')
    assert main(["router", "--config", str(file), "--tls-ca", f"{tmp_path}/ca.pem", "--check-config"]) == 2
    told = capsys.readouterr().err.splitlines()
    assert sum(line.startswith(f"biobot-gateway: {file}: ") for line in told) == 3, told
    assert sum(line.startswith(f"biobot-gateway: --tls-ca: tls.ca {tmp_path}/ca.pem: cannot be read") for line in told) == 1, told
    assert any("roster is given, but tls is not" in line for line in told)
