"""Build the gateway's configuration from its four sources, and find all that is wrong with it at once.

Types and limits of single values stand in ``config``; here is what they cannot say: names, ports, values that must fit each other, and
whether files can be where they are wanted.
"""

import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from firmware_protocol.configuration import Unfit, load_configuration
from firmware_protocol.contract.access import Role
from firmware_protocol.contract.commands import WaveformName
from firmware_protocol.contract.keys import check_name
from firmware_protocol.contract.sessions import SECURE_PREFIXES, endpoint_problem, tls_problems
from firmware_protocol.errors import KeyExpressionError
from firmware_protocol.messages import OWN_CHANNEL
from gateway.config import GatewayConfig, StimulationTable
from gateway.config_file import read_config_file
from gateway.errors import JournalUnfitError
from gateway.journal_file import expect_fit_to_open
from gateway.tls_files import check_tls_files, read_roster
from gateway.transports.spec import port_problems

ENVIRONMENT_PREFIX = "BIOBOT_GATEWAY"

_LAST_CHANNEL = 7  # WIRE_FORMAT.md §5.8: Limits has eight bits for them


def load_gateway_config(
    *,
    toml_path: Path | None = None,
    environment: Mapping[str, str] | None = None,
    flags: Mapping[str, object] | None = None,
    flag_names: Mapping[str, str] | None = None,
    needs_radio: bool = True,
    roles: Sequence[Role] = (Role.GATEWAY,),
    tries_places: bool = False,
) -> GatewayConfig:
    """Build the configuration from its four sources and check what types cannot say.

    Parameters
    ----------
    flags, flag_names
        See ``load_configuration``.
    needs_radio
        Whether a configuration that names no radio is a fault.
    roles
        What the certificate must be for; a gateway's must have its name too. Only a gateway's places on the disk are looked at.
    tries_places
        Whether the journal that is there is read, and its directory written to for a moment, as the gateway would do it next.

    Raises
    ------
    ConfigurationError
        With one line for each fault of all sources.
    """

    def check(config: GatewayConfig) -> Iterator[Unfit]:
        yield from _name_problems(config)
        yield from _port_problems(config, needs_radio=needs_radio)
        yield from _endpoint_problems(config)
        yield from _tls_problems(config, roles)
        if Role.GATEWAY in roles:
            yield from _place_problems(config, tries_places=tries_places)
        yield from _monitor_problems(config)
        yield from _pulse_problems(config.stimulation)
        yield from _threshold_problems(config)
        yield from _wall_problems(config)

    return load_configuration(
        GatewayConfig,
        toml_text=read_config_file(toml_path),
        toml_name=str(toml_path),
        environment=environment,
        environment_prefix=ENVIRONMENT_PREFIX,
        flags=flags,
        flag_names=flag_names,
        check=check,
    )


def read_address(text: str) -> tuple[str, int]:
    """Return host and port of ``HOST:PORT`` or ``[V6]:PORT``; raises ``ValueError`` for anything else. Port 0 takes a free one."""
    found = re.fullmatch(r"(?:\[([0-9A-Fa-f:.]+)\]|([^\s:\[\]]+)):([0-9]{1,5})", text)
    if found is None or int(found[3]) > 65_535:
        raise ValueError(f"{text!r} is no HOST:PORT, such as 127.0.0.1:9466 or [::1]:9466")
    return found[1] or found[2], int(found[3])


def _name_problems(config: GatewayConfig) -> Iterator[Unfit]:
    for key, name, what in (("site", config.site, "site"), ("name", config.name, "gateway")):
        try:
            check_name(name, what=what)
        except KeyExpressionError as error:
            yield Unfit(keys=(key,), reason=f"{key}: {error}")


def _port_problems(config: GatewayConfig, *, needs_radio: bool) -> Iterator[Unfit]:
    for reason in port_problems(config.ports):
        yield Unfit(keys=("ports",), reason=reason)
    if needs_radio and not config.ports:
        advice = "name at least one with --port, such as --port serial:/dev/ttyACM0; `biobot-gateway list-ports` shows them"
        yield Unfit(keys=("ports",), reason=f"no radio: {advice}")


def _endpoint_problems(config: GatewayConfig) -> Iterator[Unfit]:
    for key, endpoints in (("listen", config.listen), ("connect", config.connect)):
        for endpoint in endpoints:
            if reason := endpoint_problem(endpoint, listens=key == "listen"):
                yield Unfit(keys=(key,), reason=f"{key}: {reason}")


def _tls_problems(config: GatewayConfig, roles: Sequence[Role]) -> Iterator[Unfit]:
    ends = ("listen", "connect") if any(one.startswith(SECURE_PREFIXES) for one in config.listen) else ("connect", "listen")
    for reason in tls_problems(config.tls, listen=config.listen, connect=config.connect):
        yield Unfit(keys=("tls.ca", "tls.certificate", "tls.key", *ends), reason=reason)
    name = config.name if Role.GATEWAY in roles else None
    for reason in check_tls_files(config.tls, roles=roles, site=config.site, name=name).problems:
        yield Unfit(keys=("tls.ca", "tls.certificate", "tls.key"), reason=reason)
    for reason in () if config.roster is None else read_roster(config.roster)[1]:
        yield Unfit(keys=("roster",), reason=reason)


def _place_problems(config: GatewayConfig, *, tries_places: bool) -> Iterator[Unfit]:
    path = Path(config.journal)
    if why := _why_no_file(path):
        yield Unfit(keys=("journal",), reason=f"journal {config.journal}: {why}")
    elif tries_places:
        if why := _why_nothing_is_made(path.parent):
            yield Unfit(keys=("journal",), reason=f"journal {config.journal}: {why}")
        if path.exists():
            try:
                expect_fit_to_open(path, gateway=config.name)
            except JournalUnfitError as error:
                yield Unfit(keys=("journal", "name"), reason=str(error))
    directory = config.recording.directory
    if directory is not None and (why := _why_no_directory(Path(directory))):
        yield Unfit(keys=("recording.directory",), reason=f"recording.directory {directory}: {why}")


def _monitor_problems(config: GatewayConfig) -> Iterator[Unfit]:
    if config.monitor.listen:
        try:
            read_address(config.monitor.listen)
        except ValueError as error:
            yield Unfit(keys=("monitor.listen",), reason=f"monitor.listen: {error}; leave it empty to answer nowhere")


def _pulse_problems(table: StimulationTable) -> Iterator[Unfit]:
    # Every phase of a pulse has the pulse width, or more where it is the weaker one; all of them must fit into one period.
    n_phases = 1 if table.waveform is WaveformName.MONOPHASIC else 2
    period_us = 1_000_000 // table.frequency_hz
    if n_phases * table.pulse_width_us > period_us:
        phases = "one phase" if n_phases == 1 else "two phases"
        limit = f"{phases} must fit into the {period_us} us period of {table.frequency_hz} Hz: at most {period_us // n_phases}"
        yield Unfit(
            keys=("stimulation.pulse_width_us", "stimulation.frequency_hz", "stimulation.waveform"),
            reason=f"stimulation.pulse_width_us is {table.pulse_width_us}, but {limit}",
        )
    for key, least, most in (
        ("frequency_hz", table.min_frequency_hz, table.max_frequency_hz),
        ("amplitude_mv", 0, table.max_amplitude_mv),
        ("pulse_width_us", 0, table.max_pulse_width_us),
        ("duration_ms", 0, table.max_duration_ms),
    ):
        value = getattr(table, key)
        if not least <= value <= most:
            keys = (f"stimulation.{key}", f"stimulation.max_{key}", *(["stimulation.min_frequency_hz"] if least else []))
            yield Unfit(keys=keys, reason=f"stimulation.{key} is {value}, but its own limits are {least} to {most}; change it, or them")
    if table.duration_ms > table.max_on_s * 1000:
        limit = f"no window takes more stimulation than stimulation.max_on_s = {table.max_on_s:g} s, so every command would be refused"
        yield Unfit(
            keys=("stimulation.duration_ms", "stimulation.max_on_s"),
            reason=f"stimulation.duration_ms is {table.duration_ms}, but {limit}; change one of them",
        )
    if _LAST_CHANNEL < table.channel < OWN_CHANNEL:
        limit = f"a backpack has channels 0 to {_LAST_CHANNEL}; {OWN_CHANNEL} leaves it to the backpack"
        yield Unfit(keys=("stimulation.channel",), reason=f"stimulation.channel is {table.channel}, but {limit}")


def _threshold_problems(config: GatewayConfig) -> Iterator[Unfit]:
    enter, leave = config.backpacks.rssi_enter_dbm, config.backpacks.rssi_exit_dbm
    if enter is not None and leave is not None and leave > enter:
        limit = f"it must not be above backpacks.rssi_enter_dbm = {enter}, or encounters would end as they begin"
        yield Unfit(keys=("backpacks.rssi_exit_dbm", "backpacks.rssi_enter_dbm"), reason=f"backpacks.rssi_exit_dbm is {leave}, but {limit}")


def _wall_problems(config: GatewayConfig) -> Iterator[Unfit]:
    every_s, length_s = config.mission.wall_following_every_s, config.mission.wall_following_s
    if every_s and length_s >= every_s:
        limit = f"it must be less than mission.wall_following_every_s = {every_s:g}, or walls would be followed for ever"
        keys = ("mission.wall_following_s", "mission.wall_following_every_s")
        yield Unfit(keys=keys, reason=f"mission.wall_following_s is {length_s:g}, but {limit}")


def _why_no_file(path: Path) -> str:
    """Return why a file cannot be written there, or nothing. Root may write what its file system lets it."""
    try:
        return _why_unfit_file(path)
    except (OSError, ValueError) as error:
        return f"cannot be looked at: {error}"


def _why_unfit_file(path: Path) -> str:
    if path.is_dir():
        return "is a directory; name a file"
    if path.exists():
        return "" if os.access(path, os.R_OK | os.W_OK) else "cannot be read and written by this user; give it to the gateway's user"
    folder = path.parent
    if not folder.is_dir():
        return f"{folder} is no directory; make it, or name a file elsewhere"
    return "" if os.access(folder, os.W_OK | os.X_OK) else f"nothing can be made in {folder} by this user; give it to the gateway's user"


def _why_nothing_is_made(folder: Path) -> str:
    """Try it, because permissions alone do not tell of a disk that is full or read-only; nothing is left behind."""
    try:
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"\0")
            probe.flush()
    except OSError as error:
        return f"nothing can be written in {folder}: {(error.strerror or str(error)).lower()}; make room, or name a file elsewhere"
    return ""


def _why_no_directory(path: Path) -> str:
    """Return why a directory cannot be there and be written to, or nothing."""
    try:
        there = next(place for place in (path, *path.absolute().parents) if place.exists())
    except (OSError, ValueError) as error:
        return f"cannot be looked at: {error}"
    if not there.is_dir():
        return f"{there} is a file; name a directory"
    return "" if os.access(there, os.W_OK | os.X_OK) else f"nothing can be made in {there} by this user; give it to the gateway's user"
