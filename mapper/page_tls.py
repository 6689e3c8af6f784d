"""The certificate of the page: whether its files can be used, before anything is opened with them."""

import ssl
from collections.abc import Iterator
from pathlib import Path

from firmware_protocol.configuration import Unfit
from mapper.config import ServiceConfig

_KEYS = ("serve.certificate", "serve.key")


def check_page_tls(serve: ServiceConfig) -> Iterator[Unfit]:
    """Yield what is wrong with certificate and key; nothing where neither is given."""
    if serve.certificate is None and serve.key is None:
        return
    if serve.certificate is None or serve.key is None:
        given, missing = ("certificate", "key") if serve.key is None else ("key", "certificate")
        yield Unfit(keys=_KEYS, reason=f"serve.{given} is given without serve.{missing}; give both, or neither for http")
        return
    files = {"certificate": Path(serve.certificate), "key": Path(serve.key)}
    unreadable = [
        Unfit(keys=(f"serve.{name}",), reason=f"serve.{name} {path}: {why}") for name, path in files.items() if (why := _unreadable(path))
    ]
    if unreadable:
        yield from unreadable
        return
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(serve.certificate, serve.key, password=_refuse_to_ask)
    except _LockedKeyError:
        yield Unfit(
            keys=_KEYS, reason=f"serve.key {serve.key}: is locked by a passphrase; give it without, for the service's user alone to read"
        )
    except ssl.SSLError as error:
        why = "are not of each other" if error.reason == "KEY_VALUES_MISMATCH" else f"cannot be used ({error.reason or error})"
        reason = f"serve.certificate {serve.certificate} and serve.key {serve.key}: {why}; give both as issued, in PEM form"
        yield Unfit(keys=_KEYS, reason=reason)


class _LockedKeyError(Exception):
    pass


def _refuse_to_ask() -> str:
    # Without this, OpenSSL asks on the terminal, and waits.
    raise _LockedKeyError


def _unreadable(path: Path) -> str:
    try:
        with path.open("rb"):
            return ""
    except OSError as error:
        return f"cannot be read: {(error.strerror or str(error)).lower()}; give the path of a PEM file that this user may read"
