"""Every command of the documents is run, as far as it can be here; those in the text name commands, flags and targets that there are."""

import contextlib
import importlib
import io
import os
import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from studies.ports import free_port
from studies.reference import COMMANDS, help_text
from tests.documents.at_hand import lay_out
from tests.documents.commands import DOCUMENTS, OURS, PROGRAMS, ROOT, Command, block_commands, blocks, inline_commands
from tests.documents.running import RULES, Extent, rule_for

BLOCKS = block_commands()
WITH_PROGRAMS = sorted({one.document for one in BLOCKS if one.program in PROGRAMS})
SYSTEM = {"apt-get", "cat", "cd", "curl", "docker", "git", "ip", "ls", "qemu-system-arm", "sh", "sha256sum", "systemctl", "tar"}
"""Programs that are not ours. What they are told of ours is looked at: files of ours by their path; requests in test_requests.py."""


@dataclass(frozen=True)
class Ended:
    status: int
    output: str
    everything: str


@contextlib.contextmanager
def standard_input(path: Path) -> Iterator[None]:
    """Have file descriptor 0 be a file for a while."""
    before = os.dup(0)
    try:
        with path.open("rb") as source:
            os.dup2(source.fileno(), 0)
        yield
    finally:
        os.dup2(before, 0)
        os.close(before)


def run(words: Sequence[str]) -> Ended:
    """Run a program of ours in this process: an interpreter takes seconds to start, and there are many commands."""
    inner, err, before = io.BytesIO(), io.StringIO(), dict(os.environ)
    out = io.TextIOWrapper(inner, write_through=True)
    main = importlib.import_module(f"{PROGRAMS[Path(words[0]).name]}.__main__").main
    os.environ.update({"COLUMNS": "110", "NO_COLOR": "1", "USER": "anna"})
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main(list(words[1:]))
    except SystemExit as leaving:
        status = leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)
    finally:
        os.environ.clear()
        os.environ.update(before)
    told = inner.getvalue().decode()
    return Ended(int(status or 0), told, told + err.getvalue())


@pytest.fixture(scope="module")
def at_hand(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("at-hand")
    with contextlib.redirect_stderr(io.StringIO()):
        lay_out(directory)
    return directory


@pytest.fixture
def desk(at_hand: Path, tmp_path: Path) -> Iterator[Path]:
    """A directory of a reader's own, as the current one."""
    directory = tmp_path / "desk"
    shutil.copytree(at_hand, directory)
    with contextlib.chdir(directory):
        yield directory


def put_aside(words: Sequence[str], desk: Path) -> list[str]:
    """Keep a command to the reader's directory: devices and ``/tmp`` are there, and a site where nobody listens."""
    moved = [re.sub(r"(?<=:)/(dev|tmp)/|^/(dev|tmp)/", lambda found: f"{desk}/{found[1] or found[2]}/", word) for word in words]
    asks_a_site = re.match(r"biobot-gateway (command|stop|steer|mission|status)\b", " ".join((Path(words[0]).name, *words[1:])))
    return [*moved, "--connect", f"tcp/127.0.0.1:{free_port()}"] if asks_a_site else moved


@pytest.mark.parametrize("document", WITH_PROGRAMS)
def test_the_commands_of_a_document_run_one_after_the_other(document: str, desk: Path) -> None:
    for command in [one for one in BLOCKS if one.document == document and one.program in PROGRAMS]:
        rule = rule_for(command.text)
        words = put_aside(command.words, desk)
        if rule is not None and rule.extent is not Extent.WHOLE:
            words.append("--check-config" if rule.extent is Extent.CONFIGURATION else "--help")
            check_flags(command)
        with standard_input(desk / command.source if command.source else Path(os.devnull)):
            ended = run(words)
        assert ended.status == (rule.status if rule else 0), (command.line, ended.everything[-2000:])
        assert (rule.says if rule else "") in ended.everything, (command.line, ended.everything[-2000:])
        if command.target:
            (desk / command.target).write_text(ended.output)
        if command.text.startswith("biobot-gateway certs issue"):  # it says which lines to put into that service's file
            role, name = command.words[4:6]
            (desk / f"{name if role in {'operator', 'viewer'} else role}.toml").write_text(ended.output)


def test_every_rule_is_needed() -> None:
    used = {rule.pattern for one in BLOCKS if (rule := rule_for(one.text)) is not None}

    assert used == {rule.pattern for rule in RULES}


def test_no_command_hides_in_a_block_that_is_not_run() -> None:
    for path in DOCUMENTS:
        for language, text in blocks(path):
            if language not in {"sh", "console"}:
                hidden = re.findall(rf"^(?:\$ )?(?:\.venv/bin/)?(?:{'|'.join((*OURS, *SYSTEM))}) .*", text, re.MULTILINE)
                assert not hidden, (path.name, hidden)


def test_other_programs_are_known_and_are_told_of_files_that_exist() -> None:
    for command in BLOCKS:
        if command.program not in OURS:
            assert command.program in SYSTEM, command
            for word in command.words[1:]:
                if word.startswith(("docker/", "scripts/")):
                    assert list(ROOT.glob(word)), (command.document, word)


def commands_of(command: Command) -> tuple[str, list[str]]:
    """Return which command of a program is named (as ``journal export``), and the words after it."""
    words = list(command.words[1:])
    path: list[str] = []
    while words and " ".join([*path, words[0]]) in COMMANDS[command.program][1]:
        path.append(words.pop(0))
    return " ".join(path), words


def check_flags(command: Command) -> None:
    named, rest = commands_of(command)
    if rest and not named:
        assert rest[0].startswith("-"), f"{command.document}: {command.line}: {command.program} has no such command"
    known = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", help_text(PROGRAMS[command.program], named or None)))
    given = {word.split("=")[0] for word in rest if re.match(r"--[a-z]", word)}
    assert given <= known, f"{command.document}: {command.line}: {sorted(given - known)}"


def test_commands_in_the_text_name_commands_and_flags_that_there_are() -> None:
    for command in inline_commands():
        if command.program in PROGRAMS:
            check_flags(command)


def make_targets() -> dict[str, str]:
    """Return the targets of the Makefile and what each runs."""
    return dict(re.findall(r"^([a-z-]+):[^\n]*\n((?:\t.*\n)*)", (ROOT / "Makefile").read_text(), re.MULTILINE))


def studies_named() -> Iterator[tuple[str, str, list[str]]]:
    """Yield the line, module and arguments of each study that a document has run, by ``make`` or by ``python -m``."""
    targets = make_targets()
    for command in [*BLOCKS, *inline_commands()]:
        words = list(command.words[1:])
        if command.program == "make" and words:
            more = next((word.removeprefix("ARGS=").split() for word in words if word.startswith("ARGS=")), [])
            found = re.search(r"-m (studies\.\S+)([^\n]*)\$\(ARGS\)", targets[words[0]])
            if found:
                yield command.line, found[1], [*found[2].split(), *more]
        elif command.program == "python" and words[:1] == ["-m"] and words[1].startswith("studies."):
            yield command.line, words[1], words[2:]


def test_every_make_target_that_a_document_names_exists() -> None:
    targets = make_targets()
    for command in [*BLOCKS, *inline_commands()]:
        if command.program == "make" and len(command.words) > 1:
            assert command.words[1] in targets, (command.document, command.line)


def test_studies_that_documents_name_exist_and_know_the_flags_that_are_given() -> None:
    """Their flags stand in their source: to import all of them would take longer than all other tests of documents."""
    for line, module, arguments in studies_named():
        path = ROOT / module.replace(".", "/")
        sources = [path.with_suffix(".py")] if path.with_suffix(".py").exists() else sorted(path.glob("*.py"))
        assert sources, line
        text = "".join(one.read_text() for one in [*sources, *(ROOT / "studies" / "cases").glob("*.py")])
        for flag in [word.split("=")[0] for word in arguments if word.startswith("--")]:
            assert f'"{flag}"' in text, (line, flag)
