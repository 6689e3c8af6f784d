"""What an installation or a removal changes below a root, found by looking alone; nothing is changed here."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import msgspec

from gateway.errors import InstallationError
from gateway.installation.changes import Change, Link, MakeFolder, Remove, RemoveIfEmpty, WriteFile
from gateway.installation.layout import (
    CACHE,
    COMMANDS,
    CONFIGURATION,
    DATA,
    FOLDERS_MADE,
    RECORD,
    SERVICES,
    SIMULATOR,
    UNITS,
    WANTED,
    Wishes,
    default_configuration,
    first_configuration,
    system_files,
)
from gateway.installation.record import Record, encode_record

# Folders that are never removed, whoever made them.
_SHARED = {
    PurePosixPath(path) for path in ("/", "/opt", "/usr", "/usr/local", "/usr/lib", "/usr/local/lib", "/srv", "/var", "/var/lib", "/home")
}


@dataclass(slots=True, kw_only=True)
class Plan:
    """Changes in their order, what a person should know of them, and what is recorded once they are made."""

    root: Path
    changes: list[Change] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    record: Record | None = None

    def here(self, path: PurePosixPath) -> Path:
        """Return where a path of the installed system is now."""
        return self.root / path.relative_to("/")

    def content(self, path: PurePosixPath) -> bytes | None:
        """Return what a file holds now; None: there is none. Raises ``InstallationError`` where it cannot be read."""
        try:
            return self.here(path).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            reason = f"cannot be read: {(error.strerror or str(error)).lower()}"
            raise InstallationError(what=str(path), reason=reason, next_step="move it away, or look at its rights") from error

    def outcome(self, path: PurePosixPath) -> bytes | None:
        """Return what a file holds once the changes are made; None: there is none."""
        written = [change.content for change in self.changes if isinstance(change, WriteFile) and change.path == path]
        return written[-1] if written else self.content(path)


def plan_installation(root: Path, wishes: Wishes, *, record: Record | None, version: str) -> Plan:
    """Say what installs these services beside those that are installed already, or upgrades them."""
    plan = Plan(root=root)
    before = record or Record(version=version, programs=str(wishes.programs))
    services = tuple(name for name in SERVICES if name in {*before.services, *wishes.services})
    files = system_files(services, programs=wishes.programs)
    _plan_files(plan, files, before)
    defaults, made = _plan_configurations(plan, wishes, services=services, before=before)
    links = _plan_links(plan, wishes, services=services, before=before)
    is_other_program = record is not None and record.programs != str(wishes.programs)
    after = Record(
        version=version,
        programs=str(wishes.programs),
        previous=before.programs if is_other_program else before.previous,
        services=services,
        files={str(path): digest(content) for path, content in files.items()},
        defaults=defaults,
        made=made,
        links=links,
    )
    folders = _missing_folders(plan, [change.path for change in plan.changes if isinstance(change, WriteFile | Link)] + [RECORD])
    all_folders = {*before.folders, *_folders_made_for(plan, wishes.programs), *map(str, folders)}
    after = msgspec.structs.replace(after, folders=tuple(sorted(all_folders, key=lambda path: (path.count("/"), path))))
    if plan.changes:
        _announce(plan, before=before, after=after, folders=folders)
    if plan.content(RECORD) != encode_record(after):
        plan.changes.append(WriteFile(path=RECORD, content=encode_record(after)))
    plan.record = after
    return plan


def plan_removal(root: Path, *, record: Record | None, purges: bool) -> Plan:
    """Say what removes the program, and with ``purges`` all data and configurations too."""
    plan = Plan(root=root, record=record)
    record = record or Record(version="", programs="")
    for path in (*map(PurePosixPath, record.files), *map(PurePosixPath, record.links)):
        content = None if plan.here(path).is_symlink() else plan.content(path)
        if content is not None and not purges and digest(content) != record.files.get(str(path)):
            _keep_edited(plan, path, content)
        if content is not None or plan.here(path).is_symlink():
            plan.changes.append(Remove(path=path))
    for name, service in SERVICES.items():
        link = WANTED / service.unit  # that of `systemctl enable`, where it was disabled and enabled by hand
        if name in record.services and str(link) not in record.links and plan.here(link).is_symlink():
            plan.changes.append(Remove(path=link))
        dropins = UNITS / f"{service.unit}.d"
        if purges and plan.here(dropins).is_dir():
            plan.changes.append(Remove(path=dropins))
    if not purges:
        _plan_unchanged_defaults(plan, record)
    plan.changes += [Remove(path=path) for path in (CACHE, *([CONFIGURATION] if purges else [])) if plan.here(path).exists()]
    for programs in filter(None, (record.programs, record.previous)):
        plan.changes += remove_programs(root, PurePosixPath(programs))
    # The record goes when nothing is left that it alone knows of: a removal that was interrupted is done again.
    folders = [PurePosixPath(path) for path in reversed(record.folders)]
    plan.changes += [RemoveIfEmpty(path=path) for path in folders if not RECORD.is_relative_to(path)]
    whole = DATA if purges else RECORD
    plan.changes += [Remove(path=whole)] if plan.here(whole).exists() else []
    if not purges:
        data = (*(service.data for service in SERVICES.values()), DATA)
        plan.changes += [RemoveIfEmpty(path=path) for path in data if plan.here(path).is_dir()]
    plan.changes += [RemoveIfEmpty(path=path) for path in folders if RECORD.is_relative_to(path)]
    return plan


def remove_programs(root: Path, programs: PurePosixPath) -> list[Change]:
    """Return what removes a virtual environment of the program, and the folder around it if it held nothing else; nothing else."""
    here = root / programs.relative_to("/")
    if not (here / "pyvenv.cfg").is_file() or not (here / "bin" / "biobot-gateway").exists() or programs in _SHARED:
        return []
    around: list[Change] = [] if programs.parent in _SHARED else [RemoveIfEmpty(path=programs.parent)]
    return [Remove(path=programs), *around]


def _announce(plan: Plan, *, before: Record, after: Record, folders: list[PurePosixPath]) -> None:
    """Put the folders before the changes, and before all else a record of what may be made: what is interrupted is known, then.

    Of the services it names those of before, since the new ones are not set up yet; what was there before is known by what it held before.
    """
    begun = msgspec.structs.replace(
        before,
        files=after.files | before.files,
        defaults=after.defaults | before.defaults,
        made=after.made | before.made,
        links=tuple(dict.fromkeys((*before.links, *after.links))),
        folders=after.folders,
    )
    makes = [MakeFolder(path=path) for path in folders]
    plan.changes[:0] = [
        *(change for change in makes if RECORD.is_relative_to(change.path)),
        WriteFile(path=RECORD, content=encode_record(begun), why="of what is begun"),
        *(change for change in makes if not RECORD.is_relative_to(change.path)),
    ]


def _folders_made_for(plan: Plan, programs: PurePosixPath) -> list[str]:
    """Return the folders that the installer had to make above the programs, which go with them if nothing else is in them."""
    content = plan.content(programs / FOLDERS_MADE)
    return [] if content is None else [line for line in content.decode(errors="replace").splitlines() if line.startswith("/")]


def digest(content: bytes) -> str:
    """Return the SHA-256 by which a file is known."""
    return hashlib.sha256(content).hexdigest()


def _plan_files(plan: Plan, files: dict[PurePosixPath, bytes], before: Record) -> None:
    for path, content in files.items():
        now = plan.content(path)
        if now == content:
            continue
        if now is not None and digest(now) != before.files.get(str(path)):
            _keep_edited(plan, path, now)
        plan.changes.append(WriteFile(path=path, content=content))
    gone = [PurePosixPath(path) for path in before.files if PurePosixPath(path) not in files]
    plan.changes += [Remove(path=path) for path in gone if plan.content(path) is not None]


def _keep_edited(plan: Plan, path: PurePosixPath, content: bytes) -> None:
    """Keep what somebody made of one of the program's own files."""
    kept = CONFIGURATION / f"{path.name}.edited"
    plan.changes.append(WriteFile(path=kept, content=content, why=f"{path} as somebody changed it"))
    plan.notes.append(f"{path} had been changed by hand: it is kept as {kept}; what is to last belongs into `systemctl edit {path.stem}`")


def _plan_configurations(plan: Plan, wishes: Wishes, *, services: tuple[str, ...], before: Record) -> tuple[dict[str, str], dict[str, str]]:
    """Plan configurations where there are none, and new defaults beside those that are there; returns ``defaults`` and ``made``."""
    defaults, made = {}, dict(before.made)
    for name in services:
        path = SERVICES[name].configuration
        fresh = path.with_name(f"{path.name}.new")
        default = default_configuration(name, services=services).encode()
        defaults[str(path)] = digest(default)
        now = plan.content(path)
        if now is None:
            content = first_configuration(name, wishes, services=services).encode()
            plan.changes.append(WriteFile(path=path, content=content))
            made |= {str(path): digest(content)} if content == default else {}
        elif now != default and before.defaults.get(str(path)) != digest(default):
            if plan.content(fresh) != default:
                plan.changes.append(WriteFile(path=fresh, content=default, why=f"the new default; {path} is kept as it is"))
            plan.notes.append(f"{path} is kept as it is; compare it with the new default in {fresh}")
            continue
        if plan.content(fresh) is not None and (now is None or now == default):
            plan.changes.append(Remove(path=fresh))
    return defaults, made


def _plan_links(plan: Plan, wishes: Wishes, *, services: tuple[str, ...], before: Record) -> tuple[str, ...]:
    """Plan links that start the services at boot, unless somebody disabled them since, and those that name the programs."""
    links: list[PurePosixPath] = []
    for name in services:
        unit = SERVICES[name].unit
        link = WANTED / unit
        if plan.here(link).is_symlink():
            links.append(link)
        elif name not in before.services:
            plan.changes.append(Link(path=link, target=UNITS / unit))
            links.append(link)
    wanted = {SERVICES[name].program for name in services}
    if any(plan.here(wishes.programs).glob("lib/python*/site-packages/shapely")):
        wanted.add(SIMULATOR)  # it is in every wheel, and of use with the packages that it needs
    for program in sorted(wanted):
        link, target = COMMANDS / program, wishes.programs / "bin" / program
        here = plan.here(link)
        if (here.exists() or here.is_symlink()) and str(link) not in before.links:
            if not here.is_symlink() or here.readlink() != Path(target):
                plan.notes.append(f"{link} is somebody's own and stays; the program is {target}")
            continue
        if not here.is_symlink() or here.readlink() != Path(target):
            plan.changes.append(Link(path=link, target=target))
        links.append(link)
    gone = [PurePosixPath(path) for path in before.links if PurePosixPath(path) not in links]
    plan.changes += [Remove(path=path) for path in gone if plan.here(path).is_symlink()]
    return tuple(map(str, links))


def _plan_unchanged_defaults(plan: Plan, record: Record) -> None:
    """Plan the removal of configurations that are as they were installed, and of all new defaults."""
    for path_text, default in record.defaults.items():
        path = PurePosixPath(path_text)
        now = plan.content(path)
        if now is not None and digest(now) in {default, record.made.get(path_text)}:
            plan.changes.append(Remove(path=path))
        fresh = path.with_name(f"{path.name}.new")
        if plan.content(fresh) is not None:
            plan.changes.append(Remove(path=fresh))


def _missing_folders(plan: Plan, paths: list[PurePosixPath]) -> list[PurePosixPath]:
    """Return the folders above these paths that are not there, the outer ones first."""
    missing = {folder for path in paths for folder in path.parents if not plan.here(folder).exists()}
    return sorted(missing, key=lambda folder: len(folder.parts))
