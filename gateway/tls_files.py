"""The certificate files that the configuration names: read, and checked before anything is opened with them."""

import ssl
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.contract.access import Identity, Role, identity_problem, parse_roster
from firmware_protocol.contract.handshakes import CertificateFacts, examine, explain
from firmware_protocol.contract.sessions import TlsTable

EXPIRES_SOON_DAYS = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TlsReport:
    """What the files of a TLS table are worth: problems, one line each, and what the own certificate says where there is one."""

    problems: tuple[str, ...]
    facts: CertificateFacts | None = None


def check_tls_files(tls: TlsTable, *, roles: Iterable[Role], site: str | None = None, name: str | None = None) -> TlsReport:
    """Check that the files can be read, belong together, are in date and name a service of one of these roles.

    Parameters
    ----------
    site, name
        What the certificate must name, or None where any will do.
    """
    problems = []
    for key, path in (("ca", tls.ca), ("certificate", tls.certificate), ("key", tls.key)):
        if path is not None:
            problems += _unreadable(key, Path(path))
    if problems or tls.ca is None:
        return TlsReport(problems=tuple(problems))
    try:
        client_context(TlsTable(ca=tls.ca))
    except ssl.SSLError:
        return TlsReport(problems=(f"tls.ca {tls.ca}: holds no certificate in PEM form; give the ca.pem of `biobot-gateway certs init`",))
    if tls.certificate is None or tls.key is None:
        return TlsReport(problems=())
    try:
        facts = examine(holder=_holder(tls), verifier=_verifier(tls))
    except ssl.SSLCertVerificationError as error:
        return TlsReport(problems=(f"tls.certificate {tls.certificate}: {explain(error)}",))
    except ssl.SSLError as error:
        told = (
            "they do not belong together" if "MISMATCH" in (error.reason or "") else f"not a certificate and its key in PEM form ({error})"
        )
        return TlsReport(problems=(f"tls.certificate {tls.certificate} and tls.key {tls.key}: {told}; give both as issued",))
    misfit = identity_problem(facts.common_name, roles=tuple(roles), site=site, name=name)
    return TlsReport(problems=() if misfit is None else (f"tls.certificate {tls.certificate}: {misfit}",), facts=facts)


def read_roster(path: str) -> tuple[list[Identity], tuple[str, ...]]:
    """Return whom a roster lists, and what is wrong with it, one line each."""
    try:
        members, problems = parse_roster(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        told = (error.strerror or str(error)).lower() if isinstance(error, OSError) else "it is no UTF-8 text"
        return [], (f"roster {path}: cannot be read: {told}; `biobot-gateway certs issue` writes it",)
    if not members and not problems:
        problems = ["nobody is on it, so everybody would be refused; `biobot-gateway certs issue` enters whom it issues to"]
    return members, tuple(f"roster {path}: {problem}" for problem in problems)


def client_context(tls: TlsTable) -> ssl.SSLContext:
    """Return what a TLS client needs: the authority, and the own certificate where there is one.

    Raises
    ------
    OSError, ssl.SSLError
        A file cannot be used.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = tls.verify_name
    if tls.ca is not None:
        context.load_verify_locations(cafile=tls.ca)
    if tls.certificate is not None:
        context.load_cert_chain(tls.certificate, tls.key)
    return context


def days_left(facts: CertificateFacts) -> float:
    """Return for how many days from now a certificate is good."""
    return facts.days_left(now_ns=time.time_ns())


def _holder(tls: TlsTable) -> ssl.SSLContext:
    context = client_context(tls)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


def _verifier(tls: TlsTable) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_verify_locations(cafile=tls.ca)
    context.load_cert_chain(str(tls.certificate), tls.key)
    return context


def _unreadable(key: str, path: Path) -> list[str]:
    try:
        with path.open("rb"):
            return []
    except OSError as error:
        told = (error.strerror or str(error)).lower()
        return [f"tls.{key} {path}: cannot be read: {told}; give the path of a PEM file that this user may read"]
