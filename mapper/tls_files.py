"""The certificate files that the configuration names: checked before the bus is opened with them."""

import ssl
from pathlib import Path

from firmware_protocol.contract.access import Role, identity_problem
from firmware_protocol.contract.handshakes import CertificateFacts, examine, explain
from firmware_protocol.contract.sessions import TlsTable, tls_problems
from mapper.config import MapperConfig

EXPIRES_SOON_DAYS = 30.0


def check_tls_files(config: MapperConfig) -> tuple[list[str], CertificateFacts | None]:
    """Return what is wrong with the files and endpoints, one line each, and what the own certificate says where there is one."""
    tls, serve = config.tls, config.serve
    problems = tls_problems(tls, listen=serve.listen, connect=serve.connect)
    for key, path in (("ca", tls.ca), ("certificate", tls.certificate), ("key", tls.key)):
        if path is not None:
            problems += _unreadable(key, Path(path))
    if problems or tls.ca is None:
        return problems, None
    try:
        holder, verifier = client_context(tls), _verifier(tls)
        holder.check_hostname, holder.verify_mode = False, ssl.CERT_NONE
        facts = examine(holder=holder, verifier=verifier) if tls.certificate is not None else None
    except ssl.SSLCertVerificationError as error:
        return [f"tls.certificate {tls.certificate}: {explain(error)}"], None
    except ssl.SSLError as error:
        return [f"tls.ca {tls.ca}, tls.certificate {tls.certificate} and tls.key {tls.key} do not fit ({error}); give all as issued"], None
    misfit = None if facts is None else identity_problem(facts.common_name, roles=(Role.MAPPER,), site=serve.site, name=serve.name)
    return [] if misfit is None else [f"tls.certificate {tls.certificate}: {misfit}"], facts


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


def _verifier(tls: TlsTable) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_verify_locations(cafile=tls.ca)
    if tls.certificate is not None:
        context.load_cert_chain(tls.certificate, tls.key)
    return context


def _unreadable(key: str, path: Path) -> list[str]:
    try:
        with path.open("rb"):
            return []
    except OSError as error:
        told = (error.strerror or str(error)).lower()
        return [f"tls.{key} {path}: cannot be read: {told}; give the path of a PEM file that this user may read"]
