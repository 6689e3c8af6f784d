"""What the two compose files promise, seen to on containers that run."""

import contextlib
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from scripts.containers.podman import CheckFailedError, Podman
from scripts.containers.project import UID, Project, fetch, until
from scripts.release.version import read_version

_DOCKER = Path(__file__).parents[2] / "docker"
_TOKEN = re.compile(r"biobot_[0-9a-f]+_[0-9a-f]+")
_OCI = "org.opencontainers.image."
_PAGE_TITLE = b"<title>biobot"
_DONGLE_GROUP = "20"
_BUS_PORT, _HTTP_PORT, _HTTPS_PORT = "17447", "18000", "18443"

Say = Callable[[str], None]


def check_labels(podman: Podman, target: str, *, tag: str, values: Mapping[str, str]) -> None:
    """See what an image says of itself (OCI image specification, annotations)."""
    labels: dict[str, str] = json.loads(podman.run("image", "inspect", "--format", "{{json .Labels}}", tag))
    wanted = {"title": f"biobot {target}", "version": values["VERSION"], "revision": values["REVISION"], "licenses": "Apache-2.0"}
    for name, value in wanted.items():
        if (found := labels.get(f"{_OCI}{name}")) != value:
            raise CheckFailedError(f"{tag}: label {name} is {found!r} in place of {value!r}")
    if not labels.get(f"{_OCI}description"):
        raise CheckFailedError(f"{tag}: no description among its labels")


def check_demo(podman: Podman, say: Say) -> None:
    """Bring the demo up, see its health checks pass, look at page and map, stop all, and take it down."""
    project = Project(
        podman=podman,
        name="biobot-check-demo",
        files=(_DOCKER / "compose.yaml",),
        services=("simulator", "gateway", "mapper"),
        variables={"BIOBOT_PAGE_PORT": _HTTP_PORT},
    )
    started = time.monotonic()
    with project:
        say(f"up after {time.monotonic() - started:.0f} s")
        _check_services(project, hangs=("gateway", "mapper"), say=say)
        _check_version(project, say=say)
        token = _make_token(project, "--store", "/var/lib/biobot/mapper.sqlite")
        _check_page(f"http://127.0.0.1:{_HTTP_PORT}", token=token, n_holes=2, ca=None, say=say)
    _check_gone(podman, project)


def check_site(podman: Podman, say: Say) -> None:
    """Make a site's certificates, bring it up with a simulated dongle on a pseudo-terminal, and see that all goes by TLS and token."""
    place = podman.home / "site"
    subprocess.run(["rm", "-rf", str(place)], check=True)
    place.mkdir()
    files = (_DOCKER / "compose.site.yaml",)
    variables = {
        "BIOBOT_SITE": str(place),
        "BIOBOT_BUS_PORT": _BUS_PORT,
        "BIOBOT_PAGE_PORT": _HTTPS_PORT,
        "BIOBOT_DONGLE_GROUP": _DONGLE_GROUP,
    }
    setup = Project(podman=podman, name="biobot-check-site", files=files, services=(), variables=variables)
    setup.compose("--profile", "setup", "run", "-T", "--rm", "setup", "demo", "127.0.0.1", "base.local")
    first = (place / "mapper" / "certificate.pem").read_bytes()
    setup.compose("--profile", "setup", "run", "-T", "--rm", "setup", "renew")
    if (place / "mapper" / "certificate.pem").read_bytes() == first:
        raise CheckFailedError("the certificates are the same after `setup renew`")
    say("certificates and configuration made, and certificates renewed")
    _check_keys(place)
    with _dongle(podman.home) as terminal:
        gateway = place / "gateway" / "gateway.toml"
        gateway.write_text(
            gateway.read_text(encoding="utf-8").replace('"serial:/dev/dongle?dialect=znp"', '"serial:/dev/dongle"')
            + "\n[mission]\nis_enabled = true\ndispersion_s = 10.0\nn_landmarks = 20\n",
            encoding="utf-8",
        )
        override = podman.home / "site-dongle.yaml"
        # A pseudo-terminal opens in its own file system alone, so it is mounted and not made anew, which `devices:` does.
        override.write_text(json.dumps({"services": {"gateway": {"volumes": [f"{terminal}:/dev/dongle"]}}}), encoding="utf-8")
        project = Project(
            podman=podman,
            name="biobot-check-site",
            files=(*files, override),
            services=("router", "gateway", "mapper"),
            variables=variables | {"BIOBOT_DONGLE": "/dev/zero"},
        )
        with project:
            _check_services(project, hangs=("router", "gateway", "mapper"), say=say)
            token = _make_token(project, "--config", "/etc/biobot/mapper.toml")
            url, ca = f"https://127.0.0.1:{_HTTPS_PORT}", place / "ca.pem"
            _check_page(url, token=token, n_holes=2, ca=ca, say=say)
            _check_console(project, say=say)
            _check_data_stay(project, token=token, url=url, ca=ca, say=say)
    _check_gone(podman, project)


def _check_services(project: Project, *, hangs: tuple[str, ...], say: Say) -> None:
    for service in project.services:
        say(f"{service}: healthy after {project.wait_healthy(service):.0f} s")
    for service in project.services:
        project.check_shut_in(service)
    say(f"inside: user {UID}, root file system read-only, no capabilities, no new privileges, no compiler, no pip")
    for service in hangs:
        project.check_notices_a_hang(service)
    say(f"health checks fail while the process hangs, and pass again after: {', '.join(hangs)}")


def _check_version(project: Project, *, say: Say) -> None:
    """See that what runs in each container is of the version that its image says."""
    for service in project.services:
        program = "biobot-sim" if service == "simulator" else f"biobot-{service}"
        told = project.inside(service, program, "--version").split()[-1]
        if told != read_version():
            raise CheckFailedError(f"{service}: the program says that it is version {told}, and its image {read_version()}")
    say(f"all programs are of version {read_version()}, as their images say")


def _make_token(project: Project, *where: str) -> str:
    told = project.inside("mapper", "biobot-mapper", "tokens", "add", "check", "--role", "admin", *where)
    found = _TOKEN.search(told)
    if found is None:
        raise CheckFailedError(f"no token in what `tokens add` printed: {told!r}")
    return found.group()


def _check_page(url: str, *, token: str, n_holes: int, ca: Path | None, say: Say) -> None:
    status, page = fetch(f"{url}/", ca=ca)
    if status != 200 or _PAGE_TITLE not in page:
        raise CheckFailedError(f"{url}/ answers {status}: {page[:200]!r}")
    if (refused := fetch(f"{url}/api/v1/map", ca=ca)[0]) != 401:
        raise CheckFailedError(f"{url}/api/v1/map without a token: {refused} in place of 401")
    started = time.monotonic()
    last = ""

    def map_with_holes() -> dict[str, Any] | None:
        nonlocal last
        status, body = fetch(f"{url}/api/v1/map", token=token, ca=ca)
        last = f"the last answer: {status} {body[:300]!r}"
        document: dict[str, Any] | None = json.loads(body) if status == 200 else None
        return document if document is not None and document["betti_numbers"] == [1, n_holes] else None

    document = until(map_with_holes, what=f"a map with {n_holes} holes", timeout_s=600, explain=lambda: last)
    took_s = time.monotonic() - started
    say(f"page, and a map with {n_holes} holes of {document['n_encounters']} encounters {took_s:.0f} s later")
    status, body = fetch(f"{url}/api/v1/stop", token=token, method="POST", ca=ca)
    if status not in {200, 202}:
        raise CheckFailedError(f"a stop of all over REST: {status} {body[:300]!r}")
    say(f"stop of all over REST: {status}")


def _check_console(project: Project, *, say: Say) -> None:
    told = json.loads(project.compose("--profile", "console", "run", "-T", "--rm", "console", "status", "--json"))
    if told["gateway"] != "base1" or not told["radios"]:
        raise CheckFailedError(f"status as an operator of the site: {told}")
    say("an operator's certificate from outside the services: status of base1 heard through the router")


def _check_data_stay(project: Project, *, token: str, url: str, ca: Path, say: Say) -> None:
    """Take the containers down without their volumes and up again: journal and tokens are there as they were."""
    before = _count_records(project)
    project.compose("down", "--timeout", "20")
    project.compose("up", "--detach", "--no-build", *project.services)
    for service in project.services:
        project.wait_healthy(service)
    after = _count_records(project)
    if after < before:
        raise CheckFailedError(f"the journal had {before} records, and after down and up {after}")
    if (status := fetch(f"{url}/api/v1/me", token=token, ca=ca)[0]) != 200:
        raise CheckFailedError(f"the token does not open any more after down and up: {status}")
    say(f"down and up again: the journal goes on ({before} records, then {after}), the token still opens")


def _count_records(project: Project) -> int:
    told = project.inside("gateway", "biobot-gateway", "journal", "check", "/var/lib/biobot/gateway.sqlite")
    found = re.search(r"(\d+) records", told)
    if found is None:
        raise CheckFailedError(f"no count of records in what `journal check` printed: {told!r}")
    return int(found.group(1))


def _check_keys(place: Path) -> None:
    for key in place.glob("*/key.pem"):
        facts = key.stat()
        if facts.st_mode & 0o077 or str(facts.st_uid) != UID:
            raise CheckFailedError(f"{key}: mode {facts.st_mode & 0o777:04o}, owner {facts.st_uid}")


def _check_gone(podman: Podman, project: Project) -> None:
    left = podman.run("ps", "--all", "--quiet", "--filter", f"name={project.name}")
    left += podman.run("volume", "ls", "--quiet", "--filter", f"name={project.name}")
    if left:
        raise CheckFailedError(f"{project.name} is down, and this is left: {left}")


@contextlib.contextmanager
def _dongle(place: Path) -> Iterator[Path]:
    """Run a simulator whose coordinator is at a pseudo-terminal, which belongs to the dongles' group as udev would have it."""
    link, ready = place / "dongle", place / "dongle.ready"
    ready.unlink(missing_ok=True)
    command = [sys.executable, "-m", "simulator", "serve", "--link", f"pty:{link}", "--ready-file", str(ready)]
    command += ["--scenario", "two-obstacles", "--speed", "4", "--seed", "1"]
    with (place / "dongle.log").open("w") as log, subprocess.Popen(command, stdout=log, stderr=log) as simulator:
        try:
            until(lambda: True if ready.exists() or simulator.poll() is not None else None, what="the simulated dongle", timeout_s=60)
            if simulator.poll() is not None:
                raise CheckFailedError(f"the simulated dongle ended at once; {place / 'dongle.log'} says why")
            terminal = link.resolve()
            os.chown(terminal, 0, int(_DONGLE_GROUP))
            terminal.chmod(0o660)
            yield terminal
        finally:
            simulator.terminate()
