"""TLS handshakes in memory: what a certificate says, whether an authority vouches for it, and why a handshake fails.

Pure: bytes go in, bytes and facts come out. Who calls has read the files into the ``ssl`` contexts, and moves the bytes.
Zenoh tells of a failed handshake only that it could not connect; this names the reason.
"""

import ssl
from dataclasses import dataclass
from typing import Final

_NS_PER_S: Final = 1_000_000_000
_MAX_ROUNDS: Final = 20

# OpenSSL's reason and alert names, in words that say what to do.
_REASONS: Final = {
    "CERTIFICATE_REQUIRED": "it wants a certificate, and none was shown; give tls.certificate and tls.key",
    "PEER_DID_NOT_RETURN_A_CERTIFICATE": "no certificate was shown; give tls.certificate and tls.key",
    "UNKNOWN_CA": "it does not know the authority of our certificate; have it issued by the authority that the other side believes",
    "CERTIFICATE_EXPIRED": "our certificate is out of date; renew it with `biobot-gateway certs issue --renew`",
    "CERTIFICATE_UNKNOWN": "it does not accept our certificate; compare both sides' tls.ca",
    "BAD_CERTIFICATE": "it does not accept our certificate; compare both sides' tls.ca",
    "DECRYPT_ERROR": "our certificate is of an authority of the same name but another key; compare both sides' tls.ca",
    "WRONG_VERSION_NUMBER": "what listens there speaks no TLS; use tcp/ for it, or secure the other side",
    "RECORD_LAYER_FAILURE": "what listens there speaks no TLS; use tcp/ for it, or secure the other side",
    "UNEXPECTED_EOF_WHILE_READING": "the other side hung up during the handshake",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class CertificateFacts:
    """What a certificate says of its holder, and when it ends [ns, UTC]."""

    common_name: str
    not_after_ns: int
    hosts: tuple[str, ...]

    def days_left(self, *, now_ns: int) -> float:
        """Return how long it is still good; negative when it is out of date."""
        return (self.not_after_ns - now_ns) / (86_400 * _NS_PER_S)


def explain(error: ssl.SSLError) -> str:
    """Return why a handshake failed, and what to do."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return _explain_unverified(error.verify_message)
    reason = (error.reason or "").upper()
    for name, text in _REASONS.items():
        if name in reason:
            return text
    return f"TLS fails: {error.reason or error}"


def no_such_host(host: str) -> str:
    """Say that a name does not resolve, and what to do."""
    return f"there is no host {host}: is it spelled right, is the network up?"


def _explain_unverified(message: str) -> str:
    lowered = message.lower()
    if "expired" in lowered:
        return "the certificate is out of date; renew it with `biobot-gateway certs issue --renew`, and compare both clocks"
    if "not yet valid" in lowered:
        return "the certificate is not valid yet; compare both clocks"
    if "mismatch" in lowered or "doesn't match" in lowered:
        return f"the certificate is for another host ({message.rstrip('.')}); issue it with --host for the name in the endpoint"
    if "issuer" in lowered or "self-signed" in lowered or "self signed" in lowered or "signature failure" in lowered:
        return "the certificate is of an authority that tls.ca is not; compare both sides' tls.ca"
    return f"the certificate is not accepted: {message}"


class Handshake:
    """The client's side of a handshake: `step` until it is done."""

    def __init__(self, context: ssl.SSLContext, *, host: str | None) -> None:
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._incoming, self._outgoing, server_hostname=host)
        self.is_done = False

    def step(self, received: bytes) -> bytes:
        """Take what came and return what is to be sent.

        Raises
        ------
        ssl.SSLError
            The handshake has failed, or the other side says so after it; `explain` says why.
        """
        self._incoming.write(received)
        try:
            if not self.is_done:
                self._tls.do_handshake()
                self.is_done = True
            # With TLS 1.3 a server refuses a client's certificate after the client is done: reading brings its alert up.
            self._tls.read(1)
        except ssl.SSLWantReadError:
            pass
        return self._outgoing.read()


def examine(*, holder: ssl.SSLContext, verifier: ssl.SSLContext) -> CertificateFacts:
    """Show the holder's certificate to a verifier in memory, and return what it says.

    Parameters
    ----------
    holder
        A client's context with certificate and key loaded, which verifies nothing.
    verifier
        A server's context that asks for a certificate (``CERT_REQUIRED``), with the authority loaded; it shows the same certificate.

    Raises
    ------
    ssl.SSLError
        The authority does not vouch for the certificate, or it is out of date.
    """
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = holder.wrap_bio(to_client, to_server, server_hostname=None)
    server = verifier.wrap_bio(to_server, to_client, server_side=True)
    for _ in range(_MAX_ROUNDS):
        is_pending = False
        for side in (client, server):
            try:
                side.do_handshake()
            except ssl.SSLWantReadError:
                is_pending = True
        if not is_pending:
            break
    shown = server.getpeercert() or {}
    return _facts(shown)


def _facts(shown: "ssl._PeerCertRetDictType") -> CertificateFacts:
    names = [value for part in shown.get("subject", ()) for key, value in part if key == "commonName"]  # type: ignore[str-unpack]  # typeshed allows a plain str there
    return CertificateFacts(
        common_name=str(names[0]) if names else "",
        not_after_ns=int(ssl.cert_time_to_seconds(str(shown["notAfter"]))) * _NS_PER_S if "notAfter" in shown else 0,
        hosts=tuple(str(value) for _, value in shown.get("subjectAltName", ())),  # type: ignore[str-unpack]  # same
    )
