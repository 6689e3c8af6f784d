"""Laws of roles, rosters and liveliness keys."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.contract.access import (
    PERMISSIONS,
    Deed,
    Identity,
    Role,
    access_control,
    identity_problem,
    may,
    parse_identity,
    parse_roster,
)
from firmware_protocol.contract.keys import ANY
from firmware_protocol.contract.presence import Kind, Token, build_token_key, parse_token_key
from firmware_protocol.contract.sessions import TlsTable, host_and_port, tls_problems
from firmware_protocol.errors import KeyExpressionError

NAMES = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,14}", fullmatch=True)
IDENTITIES = st.builds(Identity, site=NAMES | st.just(ANY), role=st.sampled_from(Role), name=NAMES)


@given(IDENTITIES)
def test_a_common_name_is_read_back_as_it_was_written(identity: Identity) -> None:
    assert parse_identity(identity.common_name) == identity


@given(st.text(max_size=80))
def test_a_common_name_is_ours_or_refused_with_a_reason(text: str) -> None:
    try:
        identity = parse_identity(text)
    except KeyExpressionError:
        return
    assert identity.common_name == text


@given(st.lists(IDENTITIES, max_size=5, unique=True), st.text(alphabet="#/ab\n ", max_size=40))
def test_a_roster_keeps_what_can_be_read_and_names_the_lines_that_cannot(members: list[Identity], noise: str) -> None:
    text = "\n".join([*(f"{member.common_name}  # one of us" for member in members), *(f"/{line}" for line in noise.splitlines())])
    read, problems = parse_roster(text)
    assert set(members) <= set(read)
    assert len(problems) == sum(bool(f"/{line}".partition("#")[0].strip()) for line in noise.splitlines())


def test_a_gateway_has_its_own_keys_and_nobody_elses() -> None:
    base1 = Identity(site="demo", role=Role.GATEWAY, name="base1")
    assert may(base1, Deed.PUBLISH, stream="encounters", site="demo", name="base1")
    assert not may(base1, Deed.PUBLISH, stream="encounters", site="demo", name="base2")
    assert not may(base1, Deed.PUBLISH, stream="encounters", site="other", name="base1")
    assert not may(base1, Deed.ASK, stream="command", site="demo", name="base1")
    assert {row.role for row in PERMISSIONS if row.deed is Deed.ASK and "command" in row.streams} == {Role.MAPPER, Role.OPERATOR}
    assert not any(row.role is Role.VIEWER and row.deed not in {Deed.SUBSCRIBE, Deed.WATCH} for row in PERMISSIONS)


@given(st.lists(IDENTITIES, min_size=1, max_size=5, unique=True))
def test_access_control_denies_by_default_and_gives_each_member_rules_of_its_own_site(members: list[Identity]) -> None:
    control = msgspec.convert(access_control(members), dict[str, object])
    assert control["default_permission"] == "deny"
    rules = msgspec.convert(control["rules"], list[dict[str, object]])
    assert len({str(rule["id"]) for rule in rules}) == len(rules)
    for rule in rules:
        owner = parse_identity(str(rule["id"]).split(":")[0])
        assert all(key.startswith(f"biobot/@v1/{owner.site}/") for key in msgspec.convert(rule["key_exprs"], list[str]))


@given(site=NAMES, name=NAMES, radio=st.text(min_size=1, max_size=60).filter(lambda text: text != ANY and text.isprintable()))
def test_any_radio_has_a_token_that_is_read_back(site: str, name: str, radio: str) -> None:
    key = build_token_key(site=site, kind=Kind.RADIO, name=name, radio=radio)
    assert key.count("/") == 5
    assert not set("*$?#") & set(key)
    assert parse_token_key(key) == Token(site=site, kind=Kind.RADIO, name=name, radio=radio)


@given(st.text(max_size=90))
def test_no_token_key_raises_anything_but_that_it_is_none(text: str) -> None:
    for key in (text, f"biobot/@v1/demo/radios/base1/{text}", f"biobot/@v1/demo/{text}"):
        try:
            token = parse_token_key(key)
        except KeyExpressionError:
            continue
        assert (token.radio is None) == (token.kind is not Kind.RADIO)


def test_a_certificate_for_another_role_site_or_name_does_not_fit() -> None:
    roles = (Role.GATEWAY,)
    assert identity_problem("demo/gateway/base1", roles=roles, site="demo", name="base1") is None
    assert identity_problem("*/gateway/base1", roles=roles, site="demo", name="base1") is None
    for common_name in ("demo/viewer/base1", "other/gateway/base1", "demo/gateway/base2", "base1", ""):
        assert identity_problem(common_name, roles=roles, site="demo", name="base1") is not None


@pytest.mark.parametrize(
    ("endpoint", "address"),
    [
        ("tls/base.local:7447", ("base.local", 7447)),
        ("tcp/[::1]:7447", ("::1", 7447)),
        ("tcp/127.0.0.1:1?x=1#iface=lo", ("127.0.0.1", 1)),
        ("udp/127.0.0.1:1", None),
        ("tcp/127.0.0.1", None),
        ("tcp/127.0.0.1:99999", None),
        ("", None),
    ],
)
def test_an_endpoint_is_a_host_and_a_port_or_none(endpoint: str, address: tuple[str, int] | None) -> None:
    assert host_and_port(endpoint) == address


def test_what_is_missing_of_tls_is_told_all_at_once() -> None:
    assert tls_problems(TlsTable(), listen=["tcp/127.0.0.1:1"], connect=[]) == []
    assert len(tls_problems(TlsTable(), listen=["tls/0.0.0.0:1"], connect=["tls/a:1"])) == 2
    assert len(tls_problems(TlsTable(certificate="c"), listen=[], connect=[])) == 2
    assert len(tls_problems(TlsTable(ca="a"), listen=["tls/0.0.0.0:1"], connect=["tls/a:1"])) == 1
