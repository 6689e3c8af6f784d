"""Why nobody can be connected to or listened for, in words with a next step; and Zenoh's own words of refused handshakes."""

import socket

import pytest

from firmware_protocol.contract.sessions import TlsTable
from gateway.bus_session import open_client, open_service
from gateway.connecting import diagnose, why_not_listening
from gateway.errors import BusError
from gateway.zenoh_log import put_plainly, what_is_told
from studies.ports import free_port


def test_a_busy_port_is_told_as_one_and_nothing_else() -> None:
    with socket.create_server(("127.0.0.1", 0)) as busy:
        endpoint = f"tcp/127.0.0.1:{busy.getsockname()[1]}"
        with pytest.raises(BusError) as caught:
            open_service(listen=[endpoint], connect=[], tls=TlsTable())
    assert str(caught.value).startswith(f"cannot listen on {endpoint}: another program has that port")
    assert why_not_listening(f"tcp/127.0.0.1:{free_port()}") is None


def test_a_dead_port_is_asked_one_question() -> None:
    with pytest.raises(BusError) as caught:
        open_client(connect=[f"tcp/127.0.0.1:{free_port()}"], tls=TlsTable())
    assert str(caught.value).endswith(": nobody listens there; is the gateway or router running, and the port right?")


@pytest.mark.parametrize(
    ("endpoint", "words"),
    [
        ("tcp/no-such-host.invalid:7447", "there is no host no-such-host.invalid: is it spelled right, is the network up?"),
        ("tcp/foo", "names no host and port"),
        ("quic/127.0.0.1:7447", "only tcp/ and tls/ endpoints can be tried by hand"),
    ],
)
def test_names_that_do_not_resolve_and_endpoints_that_are_none_are_told_apart(endpoint: str, words: str) -> None:
    assert words in diagnose(endpoint, TlsTable())


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ("received fatal alert: DecryptError", "of another authority than their tls.ca"),
        ("received fatal alert: BadCertificate", "not for the address they use"),
        ("invalid peer certificate: UnknownIssuer", "of another authority"),
        ("invalid peer certificate: Expired", "out of date"),
        ("peer sent no certificates", "shows no certificate"),
        ("received corrupt message of type InvalidContentType", "speaks no TLS"),
        ("tls handshake eof", "hung up"),
    ],
)
def test_refused_handshakes_are_put_plainly(said: str, words: str) -> None:
    told = put_plainly(said)
    assert words in told
    assert told.endswith(f"[{said}]")
    assert put_plainly("something else") == "something else"


def test_what_zenoh_says_of_one_that_is_denied_is_told_once_and_explained() -> None:
    start = "2026-11-27T08:03:53.709162Z ERROR net-0 ThreadId(09) zenoh::net::routing:"
    lines = [f"{start} {text}" for text in ("Unknown interest", "Unknown subscriber id=1", "Unknown id", "something else", "Unknown id")]
    told = list(what_is_told(lines, clock_s=lambda: 0.0))
    assert [level for level, _ in told] == ["ERROR", "ERROR"]
    assert "who is not on the roster (router.stranger names them)" in told[0][1]
    assert told[1][1] == "something else"
