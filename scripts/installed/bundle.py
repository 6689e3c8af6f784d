"""What docs/bundle.md promises, seen to on a machine that has Python alone and no network; one function a promise, in the page's order."""

from pathlib import Path

from scripts.containers.podman import CheckFailedError
from scripts.installed.checks import INSTALL_S, LINK, MAY_DIFFER, Say, expect, expect_served, journal_head, show, start_insects
from scripts.installed.machine import Machine, until

BROUGHT = "/media"
"""Where the archive is on the machine: what somebody has carried over."""

_PLACE = "/home/pi"
_PREFIX = "/opt/biobot"
_SERVICES = ("gateway", "mapper")
_AS_SOMEBODY = f"setpriv --reuid=1000 --regid=1000 --clear-groups env HOME={_PLACE}"


def live_from_bundle(machine: Machine, say: Say, archive: Path) -> None:
    """Unpack, check, be refused, be interrupted, install as a user and as services, upgrade, lose the power, and remove all."""
    folder = f"{_PLACE}/{_unpack(machine, say, archive)}"
    before = machine.files()
    _check_refusals(machine, say, folder)
    _check_interruption(machine, say, folder)
    changed = {line for line in machine.files() ^ before if not MAY_DIFFER.match(line)}
    expect(not changed, f"came or went: {sorted(changed)}")
    simulator = _check_own_folder(machine, say, folder)
    start_insects(machine, simulator=simulator)
    version = folder.rpartition("-")[2]
    _check_services(machine, say, folder, version=version)
    _check_second_run(machine, say, folder, version=version)
    machine.restart()
    start_insects(machine, simulator=simulator)
    expect_served(machine, _SERVICES)
    say("power lost and booted again: both serve")
    _check_removal(machine, say, before)


def _unpack(machine: Machine, say: Say, archive: Path) -> str:
    told = machine.run(f"mkdir -p {_PLACE} && cd {BROUGHT} && sha256sum -c {archive.name}.sha256")
    expect(f"{archive.name}: OK" in told, told)
    machine.run(f"cd {_PLACE} && tar xf {BROUGHT}/{archive.name}", timeout_s=INSTALL_S)
    name = machine.run(f"ls {_PLACE}").strip()
    told = machine.run(f"cd {_PLACE}/{name} && sh install.sh --check", timeout_s=INSTALL_S)
    expect("this folder is whole; /usr/bin/python3 fits" in told, told)
    more = machine.run("for one in pip3 gcc make; do command -v $one || true; done; python3 -c 'import ensurepip' 2>&1 || true").strip()
    expect(more.endswith("No module named 'ensurepip'") and "/bin/" not in more, f"the machine has more than Python: {more}")
    say("unpacked and found whole, on a machine with Python and neither pip, ensurepip nor a compiler")
    return name


def _check_refusals(machine: Machine, say: Say, folder: str) -> None:
    """Say no before anything is changed: to somebody who is not root, to a wheel that is cut off, to a disk that is small."""
    said = machine.run(f"{_AS_SOMEBODY} sh {folder}/install.sh --service", status=1)
    expect("wants root: sudo sh install.sh" in said, said)
    said = machine.run(f"{_AS_SOMEBODY} sh {folder}/install.sh", status=1, timeout_s=INSTALL_S)
    expect(f"{_PREFIX}/" in said and "run this as root, or name a folder of yours with --prefix" in said, said)
    wheel = machine.run(f"ls {folder}/wheels/numpy-*.whl | head -n 1").strip()
    machine.run(f"cp {wheel} {_PLACE}/kept && truncate -s -100 {wheel}")
    said = machine.run(f"sh {folder}/install.sh", status=1, timeout_s=INSTALL_S)
    expect(f"{wheel.rpartition('/')[2]}: FAILED" in said and "not what was packed (above); copy it anew" in said, said)
    machine.run(f"mv {_PLACE}/kept {wheel}")
    said = machine.run(f"sh {folder}/install.sh --python /bin/true", status=1)
    expect("/bin/true: it is no Python" in said and "Debian 12 and Raspberry Pi OS 12 (64 bits) have 3.11" in said, said)
    said = _install_on(machine, "size=100m", folder)
    expect(f"MB are free at {_PREFIX}, and an installation takes" in said and "make room, or name a folder on another disk" in said, said)
    said = _install_on(machine, "size=2g,nr_inodes=3000", folder)
    expect("No space left on device" in said and "pip could not install (above); nothing of it stays" in said, said)
    say("refused, with nothing changed: not root, a wheel that was cut off, no Python, a disk that is small, or that is full half way")


def _install_on(machine: Machine, disk: str, folder: str) -> str:
    """Install onto a disk of its own, which is too small; returns what was said, after nothing was left there."""
    machine.run(f"mkdir {_PREFIX} && mount -t tmpfs -o {disk} tmpfs {_PREFIX}")
    said = machine.run(f"sh {folder}/install.sh", status=1, timeout_s=INSTALL_S)
    left = machine.run(f"ls -A {_PREFIX}")
    expect(not left, f"left behind: {left}")
    machine.run(f"umount {_PREFIX} && rmdir {_PREFIX}")
    return said


def _check_interruption(machine: Machine, say: Say, folder: str) -> None:
    """Kill it, and all that it started, in the middle; the next one removes what was left, and a SIGTERM leaves nothing."""
    site = f"{_PREFIX}/*/lib/python3*/site-packages/numpy"
    for signal in ("KILL", "TERM"):
        machine.run(f"systemd-run --quiet --unit=interrupted --property=KillMode=mixed sh {folder}/install.sh")
        until(lambda: machine.attempt(f"ls -d {site}").returncode == 0, what="half of it is there", timeout_s=INSTALL_S)
        machine.run(f"systemctl kill --signal={signal} --kill-who=all interrupted")
        until(lambda: machine.attempt("systemctl is-active interrupted").stdout.strip() in {"inactive", "failed"}, what="it has ended")
        machine.attempt("systemctl reset-failed interrupted")
        left = machine.run(f"ls -A {_PREFIX} 2>/dev/null || true").split()
        expect(len(left) == (2 if signal == "KILL" else 0), f"left after {signal}: {left}")
        if signal == "KILL":
            said = machine.run(f"cd {folder} && sh install.sh --prefix {_PREFIX}", timeout_s=INSTALL_S)
            expect("was interrupted; it is removed" in said and "installed in" in said, said)
            place = said.partition("to be rid of it: ")[2].splitlines()[0]
            machine.run(f"{place} && rmdir {_PREFIX}")
    say("killed half way: the next run removes what was left and installs; ended by SIGTERM: nothing is left")


def _check_own_folder(machine: Machine, say: Say, folder: str) -> str:
    """Install without root, into a folder of one's own; returns the simulator's program."""
    machine.run(f"chown 1000:1000 {_PLACE}")
    said = machine.run(f"cd {folder} && {_AS_SOMEBODY} sh install.sh --prefix {_PLACE}/biobot", timeout_s=INSTALL_S)
    place = said.partition("installed in ")[2].partition(":")[0]
    expect(place.startswith(f"{_PLACE}/biobot/"), said)
    told = machine.run(
        f"cd {_PLACE} && {_AS_SOMEBODY} {place}/bin/biobot-sim run --scenario two-obstacles --seed 1 --out run", timeout_s=INSTALL_S
    )
    told += machine.run(
        f"cd {_PLACE} && {_AS_SOMEBODY} {place}/bin/biobot-mapper run run/encounters.csv --modes run/modes.csv --json map.json",
        timeout_s=INSTALL_S,
    )
    holes = machine.run(f"python3 -c \"import json; print(json.load(open('{_PLACE}/map.json'))['betti_numbers'])\"").strip()
    expect(holes == "[1, 2]", f"{holes}: {told}")
    say("installed without root into a folder of one's own; it maps a run of two obstacles as [1, 2]")
    return f"{place}/bin/biobot-sim"


def _check_services(machine: Machine, say: Say, folder: str, *, version: str) -> None:
    """Install as services, with a radio: they start and answer, and there is a map."""
    said = machine.run(f"cd {folder} && sh install.sh --service --port {LINK} --site tent", timeout_s=INSTALL_S)
    expect(f"up, with version {version}: gateway, mapper" in said, said)
    expect_served(machine, _SERVICES)
    site = machine.run("grep ^site /etc/biobot/gateway.toml /etc/biobot/mapper.toml")
    expect(site.count('"tent"') == 2, site)
    say(f"install.sh --service: {', '.join(_SERVICES)} of version {version} serve, and there is a map")


def _check_second_run(machine: Machine, say: Say, folder: str, *, version: str) -> None:
    """Run it again over services that run: they move to the new programs, with their data and configurations."""
    configuration = machine.run("sed -i 's/^name = .*/name = \"base1\" # ours/' /etc/biobot/gateway.toml; cat /etc/biobot/gateway.toml")
    token = machine.run("cat /var/lib/biobot/mapper/first-token")
    head = journal_head(machine)
    said = machine.run(f"cd {folder} && sh install.sh --service", timeout_s=INSTALL_S)
    expect(f"there is {_PREFIX}/{version} as well, which stays" in said and f"up, with version {version}" in said, said)
    expect_served(machine, _SERVICES)
    for name in _SERVICES:
        expect(f"{_PREFIX}/{version}-2/bin/" in show(machine, name, "ExecStart"), f"biobot-{name} is not of the second run")
    expect(machine.run("cat /etc/biobot/gateway.toml") == configuration, "gateway.toml was changed")
    expect(machine.run("cat /var/lib/biobot/mapper/first-token") == token, "the first token was changed")
    now = journal_head(machine)
    expect(now >= head, "the journal lost records")
    say(f"run again over services that run: configuration and token as they were, journal at {now} after {head} before")


def _check_removal(machine: Machine, say: Say, before: set[str]) -> None:
    """Remove it as docs/installing.md says: first all but the data, then those."""
    said = machine.run("biobot-gateway uninstall-service", timeout_s=INSTALL_S)
    expect("stay" in said, said)
    left = {line.split(" ")[0] for line in machine.files() - before if not MAY_DIFFER.match(line)}
    strays = sorted(path for path in left if not path.startswith(("/var/lib/biobot", "/etc/biobot")))
    expect(not strays, f"left behind: {strays}")
    expect("/var/lib/biobot/gateway/biobot-gateway.sqlite" in left and "/etc/biobot/gateway.toml" in left, "data went without being asked")
    machine.run("rm -r /etc/biobot /var/lib/biobot; userdel biobot; systemctl stop insects")
    changed = {line for line in machine.files() ^ before if not MAY_DIFFER.match(line)}
    if changed:
        raise CheckFailedError(f"left behind, or gone: {sorted(changed)}")
    say(f"removed: data and configurations stayed until they were removed, too; then the {len(before)} files of before, and no other")
