"""Tokens and their file: only what was handed out opens, and neither kills, full disks nor two at a time lose any."""

import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapper.__main__ import main
from mapper.access import (
    LastAdminError,
    Rate,
    Role,
    TokenFileError,
    TokenNameError,
    TokenNotFoundError,
    TokenRecord,
    add_token,
    check_name,
    contains_token,
    read_tokens,
    revoke_token,
    role_needed,
)
from mapper.access.buckets import Buckets
from mapper.access.token_file import change_tokens
from mapper.access.tokens import Keyring, mint

randoms = st.binary(min_size=36, max_size=36)


def is_fit(name: str) -> bool:
    try:
        return check_name(name) == name
    except TokenNameError:
        return False


names = st.text(st.characters(categories=["L", "N", "P", "S"]), min_size=1, max_size=64).filter(is_fit)
roles = st.sampled_from(Role)


@given(random=randoms, name=names, role=roles, now=st.integers(0, 2**62), at=st.integers(0, 79), other=st.characters())
def test_a_token_opens_and_nothing_that_is_one_character_off(random: bytes, name: str, role: Role, now: int, at: int, other: str) -> None:
    text, record = mint(name=name, role=role, random=random, now_wall_ns=now)
    assert Keyring([record]).find(text) == record
    assert contains_token(f"?x={text}&y") is True
    changed = text[:at] + other + text[at + 1 :]
    assert Keyring([record]).find(changed) == (record if changed == text else None)
    assert text[16:] not in str(record)


@settings(max_examples=15)
@given(st.lists(st.tuples(randoms, names, roles, st.booleans()), max_size=4, unique_by=lambda one: one[0][:4]))
def test_what_is_kept_is_read_again_and_opens_what_is_not_revoked(
    tmp_path_factory: pytest.TempPathFactory, made: list[tuple[bytes, str, Role, bool]]
) -> None:
    path = tmp_path_factory.mktemp("tokens") / "tokens.json"
    pairs = [mint(name=name, role=role, random=random, now_wall_ns=1) for random, name, role, _ in made]
    records = tuple(record for _, record in pairs)
    change_tokens(path, lambda _before: (records, None))
    assert read_tokens(path) == records
    for (_, record), (_, _, _, is_revoked) in zip(pairs, made, strict=True):
        if is_revoked:
            revoke_token(path, token_id=record.id, keeps_admin=False)
    keyring = Keyring(read_tokens(path) or ())
    assert [keyring.find(text) is None for text, _ in pairs] == [is_revoked for *_, is_revoked in made]


@given(name=st.text(max_size=70))
def test_a_name_can_stand_in_an_audit_log_or_is_refused(name: str) -> None:
    try:
        kept = check_name(name)
    except TokenNameError:
        return
    assert kept.isprintable()
    assert 1 <= len(kept) <= 64
    assert kept == name.strip()


@pytest.mark.parametrize("name", ["dead-man", "Mission", " mapper-shutdown ", "anonymous", "", "  ", "a\nb", "a" * 65])
def test_nobody_is_called_like_a_service_or_like_nothing(name: str) -> None:
    with pytest.raises(TokenNameError):
        check_name(name)


@given(method=st.sampled_from(["GET", "HEAD", "OPTIONS", "POST", "PUT", "PATCH", "DELETE", "TRACE", "FOO"]) | st.text(), path=st.text())
def test_whatever_is_not_known_to_be_open_is_closed(method: str, path: str) -> None:
    needed = role_needed(method, f"/api/v1/{path}")
    assert needed is not None
    if method not in {"GET", "HEAD", "OPTIONS"}:
        assert needed.covers(Role.OPERATOR)
        assert role_needed(method, path) is not None
    assert role_needed(method, f"/api/v1/tokens/{path}") is Role.ADMIN


@given(
    per_s=st.floats(0.1, 50),
    burst=st.floats(1, 20),
    steps=st.lists(st.tuples(st.sampled_from("ab"), st.floats(0, 5)), max_size=60),
)
def test_nobody_takes_more_than_burst_and_rate_allow_and_waiting_helps(per_s: float, burst: float, steps: list[tuple[str, float]]) -> None:
    buckets, now_s = Buckets(Rate(per_s=per_s, burst=burst)), 0.0
    taken: dict[str, list[float]] = {"a": [], "b": []}
    for who, pause_s in steps:
        now_s += pause_s
        wait_s = buckets.take(who, now_s=now_s)
        if wait_s > 0:
            now_s += wait_s * (1 + 1e-9)
            assert buckets.take(who, now_s=now_s) == pytest.approx(0, abs=1e-6)
        taken[who].append(now_s)
    for times in taken.values():
        for first in range(len(times)):
            for last in range(first, len(times)):
                assert last - first + 1 <= burst + per_s * (times[last] - times[first]) + 1e-3


def test_a_file_that_others_may_read_or_that_is_damaged_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "tokens.json"
    assert read_tokens(path) is None
    add_token(path, name="anna", role=Role.OPERATOR)
    whole = path.read_bytes()
    assert path.stat().st_mode & 0o777 == 0o600
    path.chmod(0o640)
    with pytest.raises(TokenFileError, match="chmod 600"):
        read_tokens(path)
    path.chmod(0o600)
    for damaged in (*(whole[:n] for n in range(0, len(whole) - 2, 7)), whole + whole, whole.replace(b'"format": 1', b'"format": 2')):
        path.write_bytes(damaged)
        with pytest.raises(TokenFileError):
            read_tokens(path)
        with pytest.raises(TokenFileError):
            add_token(path, name="bert", role=Role.OPERATOR)
        assert path.read_bytes() == damaged


def test_the_last_admin_is_kept_where_that_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "tokens.json"
    first, second = (add_token(path, name="ada", role=Role.ADMIN).record for _ in range(2))
    revoke_token(path, token_id=first.id, keeps_admin=True)
    with pytest.raises(LastAdminError):
        revoke_token(path, token_id=second.id, keeps_admin=True)
    with pytest.raises(TokenNotFoundError):
        revoke_token(path, token_id="00000000", keeps_admin=True)
    again = revoke_token(path, token_id=first.id, keeps_admin=True)
    assert [one.is_valid for one in read_tokens(path) or ()] == [False, True]
    assert again == (read_tokens(path) or ())[0]


_ADDING = """
import sys
from pathlib import Path
from mapper.access import Role, add_token
path, n = Path(sys.argv[1]), int(sys.argv[2])
for _ in range(n):
    print(add_token(path, name="anna", role=Role.OPERATOR).record.id, flush=True)
"""


def _adding(path: Path, n: int) -> "subprocess.Popen[str]":
    return subprocess.Popen([sys.executable, "-c", _ADDING, str(path), str(n)], stdout=subprocess.PIPE, text=True)


def test_two_at_a_time_and_a_kill_lose_no_token(tmp_path: Path) -> None:
    path = tmp_path / "tokens.json"
    told: list[str] = []
    with _adding(path, 900) as one, _adding(path, 30) as other:
        assert one.stdout is not None
        assert other.stdout is not None
        told += [one.stdout.readline().strip() for _ in range(20)]
        one.send_signal(signal.SIGKILL)
        told += one.stdout.read().split()
        told += other.stdout.read().split()
    kept = [record.id for record in read_tokens(path) or ()]
    assert set(told) <= set(kept)
    assert len(kept) - len(told) in {0, 1}  # one that was written, and not told any more
    add_token(path, name="anna", role=Role.OPERATOR)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["tokens.json"]


_ON_A_FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from mapper.access import Role, TokenFileError, add_token
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
try:
    add_token(Path(sys.argv[1]), name="anna", role=Role.OPERATOR)
except TokenFileError as error:
    print(error)
"""


def test_where_nothing_can_be_written_the_tokens_stay_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "tokens.json"
    add_token(path, name="anna", role=Role.OPERATOR)
    before = path.read_bytes()
    done = subprocess.run([sys.executable, "-c", _ON_A_FULL_DISK, str(path)], capture_output=True, text=True, check=True)
    assert "cannot be written" in done.stdout
    assert path.read_bytes() == before
    assert sorted(one.name for one in tmp_path.iterdir()) == ["tokens.json"]


_FIRST = "import sys; from pathlib import Path; from mapper.access import open_register; open_register(Path(sys.argv[1]), token_file=None)"


def test_the_first_token_is_shown_to_a_terminal_once_and_to_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "tokens.json"
    command = [sys.executable, "-c", _FIRST, str(path)]
    piped = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "no_admin" in piped.stderr
    assert not contains_token(piped.stderr + piped.stdout)
    assert not path.exists()
    shown = []
    for _ in range(2):
        terminal, end = pty.openpty()
        subprocess.run(command, stderr=end, check=True)
        os.close(end)
        said = b""
        try:
            while part := os.read(terminal, 4096):
                said += part
        except OSError:
            pass  # the other end is closed, and all was read
        os.close(terminal)
        shown.append(said.decode())
    assert [contains_token(said) for said in shown] == [True, False]
    (record,) = read_tokens(path) or ()
    token = next(line for line in shown[0].split() if contains_token(line))
    assert Keyring([record]).find(token) == record
    assert (record.name, record.role) == ("admin", Role.ADMIN)


def test_tokens_are_made_listed_and_revoked_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tokens.json"
    where = ["--tokens", str(path)]
    assert main(["tokens", "add", "Anna B.", "--role", "operator", *where]) == 0
    token = capsys.readouterr().out.strip()
    assert main(["tokens", "add", "bert", "--role", "viewer", "--token-file", str(tmp_path / "bert"), *where]) == 0
    assert not contains_token("".join(capsys.readouterr()))
    assert (tmp_path / "bert").stat().st_mode & 0o777 == 0o600
    anna, bert = read_tokens(path) or ()
    assert Keyring([bert]).find((tmp_path / "bert").read_text().strip()) == bert
    assert Keyring([anna]).find(token) == anna
    assert main(["tokens", "revoke", anna.id, *where]) == 0
    assert main(["tokens", "list", *where]) == 0
    listed = capsys.readouterr().out
    assert [line.split()[:2] for line in listed.splitlines()[1:]] == [[anna.id, "operator"], [bert.id, "viewer"]]
    assert not contains_token(listed)
    assert Keyring(read_tokens(path) or ()).find(token) is None
    for bad, status in ((["add", "mission", "--role", "admin"], 1), (["revoke", "00000000"], 1)):
        assert main(["tokens", *bad, *where]) == status
        assert "biobot-mapper: error: " in capsys.readouterr().err
    for bad in ([], ["add"], ["add", "carl"], ["revoke"]):
        with pytest.raises(SystemExit):
            main(["tokens", *bad, *where])


def test_who_makes_a_token_hears_who_heeds_it_and_which_others_open(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tokens.json"
    add = ["tokens", "add", "anna", "--role", "operator", "--tokens", str(path)]
    assert main(["tokens", "list", "--tokens", str(path)]) == 0
    assert f"no tokens in {path}, which is not there; name the service's with" in capsys.readouterr().err
    assert main(add) == 0
    told = capsys.readouterr().err
    assert f"in {path}; " in told
    assert (
        f"that file was not there before: a service heeds it whose store is in the same folder, or that is started with --tokens {path}"
        in told
    )
    assert "another" not in told
    assert main(["tokens", "add", "bert", "--role", "viewer", "--tokens", str(path)]) == 0
    assert len(capsys.readouterr().err.splitlines()) == 1
    first, _ = read_tokens(path) or ()
    assert main(add) == 0
    said = f"anna has another token, id {first.id}, operator; if that is lost: biobot-mapper tokens revoke {first.id} --tokens {path}"
    assert said in capsys.readouterr().err
    revoke_token(path, token_id=first.id, keeps_admin=False)
    assert main(add) == 0
    assert first.id not in capsys.readouterr().err, "one that was revoked opens nothing"


def test_a_record_says_nothing_of_the_secret() -> None:
    text, record = mint(name="anna", role=Role.ADMIN, random=bytes(range(36)), now_wall_ns=1)
    assert isinstance(record, TokenRecord)
    assert text.rpartition("_")[2] not in repr(record)
