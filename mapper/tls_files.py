"""The certificate files that the configuration names: checked before the bus is opened with them."""

import ssl
from pathlib import Path

from firmware_protocol.configuration import Unfit
from firmware_protocol.contract.access import Role, identity_problem
from firmware_protocol.contract.handshakes import CertificateFacts, examine, explain
from firmware_protocol.contract.sessions import TlsTable, tls_problems
from mapper.config import MapperConfig

EXPIRES_SOON_DAYS = 30.0


def check_tls_files(config: MapperConfig) -> tuple[list[Unfit], CertificateFacts | None]:
    """Return what is wrong with the files and endpoints, and what the own certificate says where there is one and it is sound."""
    tls, serve = config.tls, config.serve
    about = ("tls.ca", "tls.certificate", "tls.key", "serve.listen", "serve.connect")
    unfit = [Unfit(keys=about, reason=reason) for reason in tls_problems(tls, listen=serve.listen, connect=serve.connect)]
    for key, path in (("ca", tls.ca), ("certificate", tls.certificate), ("key", tls.key)):
        if path is not None:
            unfit += _unreadable(key, Path(path))
    if unfit or tls.ca is None:
        return unfit, None
    try:
        holder, verifier = client_context(tls), _verifier(tls)
        holder.check_hostname, holder.verify_mode = False, ssl.CERT_NONE
        facts = examine(holder=holder, verifier=verifier) if tls.certificate is not None else None
    except ssl.SSLCertVerificationError as error:
        return [Unfit(keys=("tls.certificate",), reason=f"tls.certificate {tls.certificate}: {explain(error)}")], None
    except ssl.SSLError as error:
        reason = f"tls.ca {tls.ca}, tls.certificate {tls.certificate} and tls.key {tls.key} do not fit ({error}); give all as issued"
        return [Unfit(keys=about[:3], reason=reason)], None
    misfit = None if facts is None else identity_problem(facts.common_name, roles=(Role.MAPPER,), site=serve.site, name=serve.name)
    if misfit is None:
        return [], facts
    # A router lets a mapper speak under its certificate's name alone.
    advice = ", or leave serve.name out: it is then the certificate's" if serve.name is not None else ""
    return [
        Unfit(keys=("serve.name", "serve.site", "tls.certificate"), reason=f"tls.certificate {tls.certificate}: {misfit}{advice}")
    ], None


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


def _unreadable(key: str, path: Path) -> list[Unfit]:
    try:
        with path.open("rb"):
            return []
    except OSError as error:
        told = (error.strerror or str(error)).lower()
        reason = f"tls.{key} {path}: cannot be read: {told}; give the path of a PEM file that this user may read"
        return [Unfit(keys=(f"tls.{key}",), reason=reason)]
