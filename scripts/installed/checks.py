"""What docs/installing.md promises, seen to on the machine; one function a promise, in the order of a station's life."""

import re
from collections.abc import Callable, Sequence

from scripts.containers.podman import CheckFailedError
from scripts.installed.machine import Machine, until

SERVICES = ("router", "gateway", "mapper")
Say = Callable[[str], None]

_CHECKOUT = "/home/checkout"
_OFFLINE = "PIP_NO_INDEX=1 PIP_FIND_LINKS=/wheels PIP_NO_CACHE_DIR=1 PIP_ROOT_USER_ACTION=ignore"
LINK = "tcp:127.0.0.1:7600"
_MAX_EXPOSURE = 3.0
INSTALL_S = 600
MAY_DIFFER = re.compile(
    r"^/(var/log|var/lib/systemd|var/tmp/systemd-private-|var/cache/ldconfig|etc/(passwd|group|shadow|gshadow|subuid|subgid)-|root/\.)"
)
"""Logs and marks of systemd itself, and the copies that useradd and userdel make of what they change."""

_TABLES = """import sqlite3
print(sqlite3.connect("file:{path}?mode=ro&immutable=1", uri=True).execute("SELECT name FROM sqlite_schema").fetchall())"""


def make_simulator(machine: Machine, version: str) -> None:
    """Have insects that walk, at the end of a line that a gateway can open."""
    machine.copy_checkout(_CHECKOUT, version=version)
    machine.run(f"cd {_CHECKOUT} && {_OFFLINE} PIP_NO_COMPILE=1 sh scripts/install.sh /sim requirements/simulator.txt", timeout_s=INSTALL_S)
    machine.run(f"{_OFFLINE} /sim/bin/python -m pip install --quiet --no-build-isolation --no-deps {_CHECKOUT}", timeout_s=INSTALL_S)
    machine.run("rm -rf /sim/bin/biobot-gateway /sim/bin/biobot-mapper")


def start_insects(machine: Machine, *, simulator: str = "/sim/bin/biobot-sim") -> None:
    """Have them walk."""
    command = f"{simulator} serve --link {LINK} --scenario two-obstacles --speed 4 --seed 1"
    machine.run(f"systemd-run --quiet --unit=insects --property=Restart=always {command}")


def check_refusals(machine: Machine, say: Say) -> None:
    """Refuse to begin where it cannot end well, and leave all as it was."""
    before = machine.files()
    said = machine.run(f"cd {_CHECKOUT} && setpriv --reuid nobody --clear-groups sh scripts/services.sh install", status=1)
    expect("not root" in said, said)
    said = machine.run(f"/sim/bin/python -m gateway install-service --programs {_CHECKOUT}", status=1)
    expect("is not there" in said, said)
    expect(machine.files() == before, "files came or went")
    say("refused without root and without programs, with nothing changed")


def check_installation(machine: Machine, say: Say, version: str) -> None:
    """Install as docs/installing.md does: without a dongle first, then with one, then with a router beside."""
    said = _make(machine, "install", version=version, flags="--site tent --name base1")
    expect("biobot-gateway.service is not started" in said and "no radio" in said, said)
    expect(f"up, with version {version}: mapper" in said, said)
    tools = machine.run(f"ls /opt/biobot/{version}/lib/python3*/site-packages | grep -E '^(hatchling|editables|setuptools)$' || true")
    expect(not tools, f"what only building wants is still there: {tools}")
    said = machine.run("biobot-gateway install-service --services gateway,mapper")
    expect("nothing was changed" in said, said)
    machine.run(f"sed -i 's|^ports = .*|ports = [\"{LINK}\"]|' /etc/biobot/gateway.toml && systemctl start biobot-gateway")
    expect_served(machine, ("gateway", "mapper"))
    expect(machine.run("cat /var/lib/biobot/mapper/first-token").startswith("biobot_"), "no first token")
    told = machine.run("stat --format '%U %G %a' /var/lib/biobot/gateway /var/lib/biobot/mapper /var/lib/biobot/mapper/first-token")
    expect(told.split("\n")[:3] == ["biobot biobot 750", "biobot biobot 750", "biobot biobot 600"], told)
    say(f"installed version {version}: without a dongle it says what to do; with one there is a map; a second time changes nothing")
    said = machine.run("biobot-gateway install-service --services router")
    expect("router and gateway both listen on 127.0.0.1:7447" in said and "gateway.toml.new" in said, said)
    edit = "sed -i -e '1,/^.monitor/s/^listen = .*/listen = []/' -e 's|^connect = .*|connect = [\"tcp/127.0.0.1:7447\"]|'"
    machine.run(f"{edit} /etc/biobot/gateway.toml")
    machine.run("systemctl restart biobot-gateway && systemctl start biobot-router")
    expect_units(machine, version)
    expect_served(machine)
    say("a router beside them: it waits until the gateway gives it its port, then all three serve")


def check_units(machine: Machine, say: Say) -> None:
    """Ask systemd what it thinks of the units as they are installed."""
    for name in SERVICES:
        unit = f"/etc/systemd/system/biobot-{name}.service"
        said = machine.run(f"systemd-analyze verify --man=no {unit}")
        expect(not said.strip(), f"{unit}: {said}")
        told = machine.run(f"systemd-analyze security --no-pager biobot-{name}.service")
        exposure = float(re.search(r"Overall exposure level.*: ([0-9.]+)", told)[1])  # type: ignore[index]  # no number: no check
        expect(exposure <= _MAX_EXPOSURE, f"{unit}: exposure {exposure}")
        say(f"biobot-{name}: nothing to verify, exposure {exposure}")
    said = machine.run("udevadm control --reload; udevadm test --action=add /sys/class/tty/tty 2>&1 | grep -i '70-biobot' || true")
    expect("Invalid" not in said and "error" not in said.lower(), said)


def check_watchdogs(machine: Machine, say: Say) -> None:
    """Stop each process without its knowing, and see systemd kill it and start it anew."""
    for name in SERVICES:
        restarts = int(show(machine, name, "NRestarts"))
        machine.run(f"kill -STOP {show(machine, name, 'MainPID')}")
        took_s = until(lambda name=name, n=restarts: _restarted(machine, name, n), what=f"{name} is killed and serves again", timeout_s=180)  # type: ignore[misc]
        said = machine.run(f"journalctl --unit=biobot-{name} --output=cat --no-pager")
        expect("Watchdog timeout" in said, f"biobot-{name} was not ended by its watchdog")
        say(f"biobot-{name} hung, was killed by its watchdog and served again {took_s:.0f} s later")
    expect_served(machine)


def check_upgrade(machine: Machine, say: Say, version: str, before: str) -> None:
    """Upgrade: data and configurations are kept, what ran runs again."""
    configuration = machine.run("sed -i 's/^name = .*/name = \"base1\" # ours/' /etc/biobot/gateway.toml; cat /etc/biobot/gateway.toml")
    head = journal_head(machine)
    machine.run("systemctl disable biobot-router")
    said = _make(machine, "install", version=version)
    expect(f"up, with version {version}: router, gateway, mapper" in said, said)
    expect(machine.run("cat /etc/biobot/gateway.toml") == configuration, "gateway.toml was changed")
    expect(journal_head(machine) >= head, "the journal lost records")
    expect(machine.attempt("systemctl is-enabled biobot-router").stdout.strip() == "disabled", "what was disabled was enabled")
    machine.run("systemctl enable --quiet biobot-router")
    expect_units(machine, version)
    expect(before in machine.run("ls /opt/biobot"), "the version before has gone")
    expect_served(machine)
    now = journal_head(machine)
    say(f"upgraded to {version}: configuration as it was, journal at {now} after {head} before, {before} kept to go back to")


def check_broken_upgrades(machine: Machine, say: Say, running: str) -> None:
    """Try versions that do not come up: the one before runs again, with its data."""
    store = "/var/lib/biobot/mapper/mapper.sqlite"
    broken = ('        self._send("READY=1")', '        raise RuntimeError("broken on purpose")')
    ready = [(f"{package}/service_manager.py", *broken) for package in ("gateway", "mapper")]
    schema = [
        ("mapper/store_file.py", "SCHEMA_VERSION: Final = 5", "SCHEMA_VERSION: Final = 6"),
        (
            "mapper/store_file.py",
            "_STEPS: Final = {\n",
            '_STEPS: Final = {\n    6: "CREATE TABLE of_the_future (id INTEGER PRIMARY KEY)",\n',
        ),
    ]
    for version, patch, what in (("9.0.1", ready[:1], "router"), ("9.0.2", [ready[1], *schema], "mapper")):
        head, units = journal_head(machine), machine.run("cat /etc/systemd/system/biobot-*.service")
        said = _make(machine, "install", version=version, patch=patch, status=2)
        expect(f"version {version} did not come up" in said and f"version {running} runs again" in said, said)
        expect("broken on purpose" in said, said)
        expect(machine.run("cat /etc/systemd/system/biobot-*.service") == units, "units are not as they were")
        expect(version not in machine.run("ls /opt/biobot"), "the broken version stays on the disk")
        expect(journal_head(machine) >= head, "the journal lost records")
        expect_served(machine)
        say(f"a version whose {what} does not come up gave way; {running} serves again, with its data")
    tables = machine.run("python3 -", stdin=_TABLES.format(path=store))
    expect("of_the_future" not in tables and "record" in tables, f"the store was not put back: {tables}")
    expect("schema-" not in machine.run("ls /var/lib/biobot/mapper"), "a copy of the data was left")
    say("a store that the broken version had written in a newer form was put back")
    machine.run("sed -i '1,/^.monitor/s/^listen = .*/listen = [\"carrier-pigeon\"]/' /etc/biobot/gateway.toml")
    said = _make(machine, "install", version="9.0.3", status=2)
    expect("nothing was changed" in said and "carrier-pigeon" in said, said)
    machine.run("sed -i '1,/^.monitor/s/^listen = .*/listen = []/' /etc/biobot/gateway.toml")
    say("a configuration that is not valid is told before anything is changed")


def check_boot(machine: Machine, say: Say) -> None:
    """Lose the power: at the next boot all serve again, with the journal."""
    head = journal_head(machine)
    machine.restart()
    start_insects(machine)
    expect_served(machine)
    expect(journal_head(machine) >= head, "the journal lost records")
    say("killed and booted: all serve, the journal is whole")


def check_obstacles(machine: Machine, say: Say) -> None:
    """Name what stands in the way: a disk that is full, a port that another program has."""
    machine.run("systemctl stop biobot-mapper biobot-gateway biobot-router && mount -t tmpfs -o size=1m tmpfs /var/lib/biobot")
    before = machine.files()
    said = machine.run("biobot-gateway install-service", status=1)
    expect("MB are needed; make room" in said, said)
    expect(machine.files() == before, "files came or went")
    machine.run("umount /var/lib/biobot && systemctl start biobot-router biobot-gateway")
    say("a full disk is told before anything is changed")
    machine.run("systemd-run --quiet --unit=squatter python3 -m http.server 8080 --bind 127.0.0.1")
    until(lambda: machine.attempt("ss -ltn | grep -q 127.0.0.1:8080").returncode == 0, what="somebody has port 8080")
    said = _make(machine, "install", version="2.0.0")
    expect("mapper is to listen on 127.0.0.1:8080: another program has it" in said, said)
    machine.run("systemctl stop squatter && systemctl start biobot-mapper")
    expect_served(machine)
    say("a port that another program has is told")


def check_image(machine: Machine, say: Say) -> None:
    """Write the files of an image, and take them out again: the folder is as empty as it was."""
    image = "/home/image"
    make = f"cd {_CHECKOUT} && {_OFFLINE} PIP_NO_COMPILE=1 make DESTDIR={image} SERVICES=gateway"
    machine.run(f"mkdir {image} && {make} install", timeout_s=INSTALL_S)
    unit = machine.run(f"cat {image}/etc/systemd/system/biobot-gateway.service")
    program = re.search(r"^ExecStart=(\S+)", unit, re.MULTILINE)
    expect(program is not None and program[1].startswith("/opt/biobot/"), unit)
    assert program is not None
    first_line = machine.run(f"test -x {image}{program[1]} && head -n 1 {image}{program[1]}")
    expect(image not in first_line, f"{program[1]} would be started by {first_line}")
    machine.run(f"{make} uninstall", timeout_s=INSTALL_S)
    left = machine.run(f"find {image}")
    expect(left.split() == [image], f"left behind: {left}")
    say("an image: files written below it and taken out again, /opt too, which it had not")


def check_removal(machine: Machine, say: Say, before: set[str]) -> None:
    """Remove the program, then all; nothing is left."""
    said = machine.run(f"cd {_CHECKOUT} && make uninstall", timeout_s=INSTALL_S)
    expect("stay" in said, said)
    left = {line.split(" ")[0] for line in machine.files() - before if not MAY_DIFFER.match(line)}
    strays = sorted(path for path in left if not path.startswith(("/var/lib/biobot", "/etc/biobot")))
    expect(not strays, f"left behind: {strays}")
    expect("/var/lib/biobot/gateway/biobot-gateway.sqlite" in left and "/etc/biobot/gateway.toml" in left, "data went without being asked")
    say("uninstalled: data and configurations stay, and nothing else")
    check_reinstallation(machine, say)
    machine.run(f"cd {_CHECKOUT} && make uninstall ARGS='--purge --yes'", timeout_s=INSTALL_S)
    machine.run("systemctl stop insects")
    left = {line for line in machine.files() ^ before if not MAY_DIFFER.match(line)}
    expect(not left, f"left behind, or gone: {sorted(left)}")
    expect(machine.attempt("getent passwd biobot || getent group biobot").returncode != 0, "the user stays")
    say(f"purged: of {len(before)} files before, {len(before)} are there, and no other")


def check_reinstallation(machine: Machine, say: Say) -> None:
    """Install again over data and configurations that stayed: they are taken as they are."""
    configuration = machine.run("cat /etc/biobot/gateway.toml")
    _make(machine, "install", version="1.0.0", services=",".join(SERVICES))
    expect(machine.run("cat /etc/biobot/gateway.toml") == configuration, "gateway.toml was changed")
    expect_served(machine)
    say("installed again over what had stayed")


def _make(
    machine: Machine,
    target: str,
    *,
    version: str,
    flags: str = "",
    services: str = "",
    patch: list[tuple[str, str, str]] | None = None,
    status: int = 0,
) -> str:
    machine.copy_checkout(_CHECKOUT, version=version, patch=patch or ())
    chosen = f"SERVICES={services}" if services else ""
    quick = "PIP_NO_COMPILE=1" if patch else ""
    return machine.run(f"cd {_CHECKOUT} && {_OFFLINE} {quick} make {target} {chosen} ARGS='{flags}'", timeout_s=INSTALL_S, status=status)


def expect(is_so: bool, otherwise: str) -> None:  # noqa: FBT001  # reads as an assertion
    """Raise ``CheckFailedError`` with what there was otherwise."""
    if not is_so:
        raise CheckFailedError(otherwise)


def expect_units(machine: Machine, version: str) -> None:
    """See that all units start the programs of a version."""
    for name in SERVICES:
        expect(f"/opt/biobot/{version}/bin/" in show(machine, name, "ExecStart"), f"biobot-{name} is not of version {version}")


def expect_served(machine: Machine, services: Sequence[str] = SERVICES) -> None:
    """See that they are up, and that encounters come through to a map."""
    asked = "import urllib.request as r; r.urlopen('http://127.0.0.1:8080/api/v1/map', timeout=5)"
    for name in services:
        until(lambda name=name: show(machine, name, "ActiveState") == "active", what=f"biobot-{name} is active")  # type: ignore[misc]
    for port in (9466, 8080):
        ready = f"python3 -c \"import urllib.request as r; r.urlopen('http://127.0.0.1:{port}/readyz', timeout=5)\""
        until(lambda ready=ready: machine.attempt(ready).returncode == 0, what=f"port {port} answers that it is ready")  # type: ignore[misc]
    until(lambda: machine.attempt(f'python3 -c "{asked}"').returncode == 0, what="there is a map")


def journal_head(machine: Machine) -> int:
    """Return how many records the gateway has written, ever."""
    said = machine.run("python3 -c \"import urllib.request as r; print(r.urlopen('http://127.0.0.1:9466/metrics').read().decode())\"")
    found = re.search(r"^biobot_gateway_journal_head_offset ([0-9.e+]+)$", said, re.MULTILINE)
    expect(found is not None, "no journal_head_offset among the metrics")
    assert found is not None
    return int(float(found[1]))


def _restarted(machine: Machine, name: str, n_before: int) -> bool:
    return int(show(machine, name, "NRestarts")) > n_before and show(machine, name, "ActiveState") == "active"


def show(machine: Machine, name: str, key: str) -> str:
    """Return what systemd says of a service."""
    return machine.run(f"systemctl show --property={key} --value biobot-{name}.service").strip()
