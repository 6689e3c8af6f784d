"""What docker/ promises, as far as it can be seen without an engine; `make containers` builds and runs all of it."""

import http.server
import os
import re
import socket
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from gateway.__main__ import main as gateway_main
from mapper.__main__ import main as mapper_main
from scripts.containers.podman import PROGRAMS

ROOT = Path(__file__).parents[1]
DOCKER = ROOT / "docker"
DOCKERFILE = (DOCKER / "Dockerfile").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
SERVICES = ("gateway", "router", "mapper", "simulator")
TARGETS = dict(re.findall(r"^FROM \S+ AS (\S+)\n(.*?)(?=^FROM |\Z)", DOCKERFILE, re.MULTILINE | re.DOTALL))


def compose_services(name: str) -> dict[str, Any]:
    services: dict[str, Any] = YAML(typ="safe").load(DOCKER / name)["services"]
    return {service: what for service, what in services.items() if "profiles" not in what}


def ask_health(what: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-I", str(DOCKER / "health.py"), what], capture_output=True, text=True, check=False)


def test_every_image_has_a_health_check_and_another_user_than_root() -> None:
    for service in SERVICES:
        own = TARGETS[service] + (TARGETS["gateway"] if service == "router" else "")
        assert "USER 10001\n" in own, service
        assert re.search(r"^HEALTHCHECK .*(\n\s.*)*CMD \[", TARGETS[service], re.MULTILINE), service


def test_every_image_says_what_it_is_and_takes_version_and_commit_from_whoever_builds() -> None:
    """Annotations of the OCI image specification; `make containers` reads them from the images."""
    for service in SERVICES:
        labels = dict(re.findall(r'org\.opencontainers\.image\.(\w+)=("[^"]+"|\S+)', TARGETS[service]))
        assert labels["title"] == f'"biobot {service}"'
        assert len(labels["description"]) > 40, service
        own = labels if service != "router" else dict(re.findall(r"org\.opencontainers\.image\.(\w+)=(\S+)", TARGETS["gateway"]))
        assert (own["version"], own["revision"], own["licenses"]) == ("$VERSION", "$REVISION", PROJECT["license"]), service
    assert not re.search(rf"\b{re.escape(PROJECT['version'])}\b", DOCKERFILE), "the version is written once, in pyproject.toml"


@pytest.mark.parametrize("name", ["compose.yaml", "compose.site.yaml"])
def test_compose_hands_version_and_commit_to_every_image_that_it_builds(name: str) -> None:
    services = YAML(typ="safe").load(DOCKER / name)["services"]
    builds = [what["build"] for what in services.values() if "build" in what]
    assert len(builds) >= 3
    for build in builds:
        assert build["args"] == {"VERSION": "${BIOBOT_VERSION:-unknown}", "REVISION": "${BIOBOT_REVISION:-unknown}"}
        assert build["target"] in SERVICES


def test_no_secret_and_nothing_superfluous_goes_into_an_image() -> None:
    ignored = (ROOT / ".dockerignore").read_text().splitlines()
    assert ignored[1] == "*"
    assert ignored.index("docker/site") > ignored.index("!docker")


@pytest.mark.parametrize("name", ["compose.yaml", "compose.site.yaml"])
def test_every_service_is_shut_in_and_comes_up_again(name: str) -> None:
    services = compose_services(name)
    assert len(services) == 3
    for service, what in services.items():
        assert what["read_only"] is True, service
        assert what["cap_drop"] == ["ALL"], service
        assert what["security_opt"] == ["no-new-privileges:true"], service
        assert what["restart"] == "unless-stopped", service
        assert not {"privileged", "cap_add", "user"} & set(what), service


def test_a_sites_services_have_limits_and_their_logs_end() -> None:
    for service, what in compose_services("compose.site.yaml").items():
        assert what["mem_limit"], service
        assert what["pids_limit"], service
        assert set(what["logging"]["options"]) == {"max-size", "max-file"}, service
        assert what["volumes"][-1].endswith(f"/{service}:/etc/biobot:ro"), service


def run_make_site(place: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    programs = place / "bin"
    programs.mkdir(exist_ok=True)
    (programs / "biobot-gateway").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m gateway "$@"\n')
    (programs / "biobot-gateway").chmod(0o755)
    environment = os.environ | {"PATH": f"{programs}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    environment |= {"SITE_FOLDER": str(place / "site"), "BIOBOT_UID": str(os.getuid())}
    command = ["sh", str(DOCKER / "make_site.sh"), *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_a_sites_certificates_and_configuration_fit_each_other_and_are_for_their_owner_alone(tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    made = run_make_site(tmp_path, "demo", "base.local", "192.168.1.2")
    assert made.returncode == 0, made.stderr
    for service, main, command in (("router", gateway_main, "router"), ("gateway", gateway_main, "run"), ("mapper", mapper_main, "serve")):
        folder = tmp_path / "site" / service
        config = folder / f"{service}.toml"
        config.write_text(config.read_text().replace("/etc/biobot", str(folder)).replace("/var/lib/biobot", str(tmp_path)))
        assert main([command, "--config", str(config), "--check-config"]) == 0, service
        assert (folder / "key.pem").stat().st_mode & 0o777 == 0o600
    assert tomllib.loads((tmp_path / "site" / "mapper" / "mapper.toml").read_text())["serve"]["allow_remote"] is True
    assert not list((tmp_path / "site" / "gateway").glob("*ca.key"))


def test_a_site_without_a_host_is_refused_with_the_usage(tmp_path: Path) -> None:
    refused = run_make_site(tmp_path, "demo")
    assert refused.returncode == 2
    assert "usage: make_site.sh SITE HOST..." in refused.stderr
    assert not (tmp_path / "site").exists()


class Answers(http.server.BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(HTTPStatus.OK if self.path == "/readyz" else HTTPStatus.SERVICE_UNAVAILABLE)
        self.end_headers()
        self.wfile.write(b'{"missing": ["no radio is up"]}')

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  # as the standard library calls it
        del format, args


@pytest.fixture(scope="module")
def service() -> Iterator[str]:
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answers) as server:
        threading.Thread(target=server.serve_forever).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


def test_a_service_is_healthy_when_it_answers_that_it_is(service: str) -> None:
    assert ask_health(f"{service}/readyz").returncode == 0
    ill = ask_health(f"{service}/healthz")
    assert (ill.returncode, ill.stdout) == (1, '503 {"missing": ["no radio is up"]}\n')


def test_a_service_that_does_not_answer_is_not_healthy() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    gone = ask_health(f"http://127.0.0.1:{port}/readyz")
    assert gone.returncode == 1
    assert "does not answer" in gone.stdout


def test_a_simulator_is_healthy_while_its_lines_are_listened_on(tmp_path: Path) -> None:
    ready = tmp_path / "simulator.ready"
    assert ask_health(str(ready)).returncode == 1
    with socket.create_server(("127.0.0.1", 0)) as line:
        port = line.getsockname()[1]
        ready.write_text(f"tcp:0.0.0.0:{port}\n")
        assert ask_health(str(ready)).returncode == 0
    closed = ask_health(str(ready))
    assert (closed.returncode, closed.stdout) == (1, f"nobody listens on tcp:0.0.0.0:{port}\n")


def test_where_programs_are_missing_it_says_which_and_how_to_get_them(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "scripts.containers", "--home", str(tmp_path / "home")]
    environment = {"PATH": str(tmp_path), "PYTHONPATH": str(ROOT)}
    refused = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    skipped = subprocess.run([*command, "--skip"], cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert (refused.returncode, skipped.returncode) == (2, 0)
    for told in (refused.stderr, skipped.stderr):
        assert all(f"{program} is missing: " in told for program in PROGRAMS)
    assert skipped.stdout == "skipped: make containers\n"
    assert not (tmp_path / "home").exists()
