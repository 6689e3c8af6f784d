"""A private authority in a directory, and the certificates that it issues to the services of a site.

The directory holds ``ca.pem``, ``ca.key``, ``roster.txt`` (whom routers heed) and a folder for each certificate with
``certificate.pem`` and ``key.pem``. Keys are for their owner alone (0600), and nothing is overwritten. Keys are EC P-256: both TLS
libraries in use take them.
"""

import ipaddress
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from firmware_protocol.contract.access import Identity, Role, parse_identity, parse_roster
from firmware_protocol.contract.keys import ANY
from firmware_protocol.errors import KeyExpressionError
from gateway.errors import CertificateError

CA_DAYS = 3650
CERTIFICATE_DAYS = 398
"""Thirteen months: a season with its preparations."""

_BACKDATED = timedelta(hours=1)
"""A machine in a tent has no good clock: a certificate is valid from a little before it was issued."""

_HOST = re.compile(r"[A-Za-z0-9*]([A-Za-z0-9-]*[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?)*\Z")
_ROSTER_HEAD = "# Whom a router heeds: one common name a line (SITE/ROLE/NAME). Take a line away to shut somebody out.\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class IssuedCertificate:
    """A certificate of the directory and what is wrong with it, if anything is."""

    identity: str
    folder: Path
    hosts: tuple[str, ...]
    not_after: datetime
    is_on_roster: bool
    problems: tuple[str, ...]

    def days_left(self, now: datetime) -> float:
        """Return for how long it is good."""
        return (self.not_after - now) / timedelta(days=1)


class Authority:
    """An authority whose directory exists; made by `init` or `open`."""

    def __init__(self, directory: Path, *, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
        self._directory = directory
        self._certificate = certificate
        self._key = key

    @classmethod
    def init(cls, directory: Path, *, name: str, days: int, now: datetime) -> "Authority":
        """Make an authority in a directory, which may exist but must not hold one.

        Raises
        ------
        CertificateError
            It holds one, or cannot be written.
        """
        if (directory / "ca.key").exists() or (directory / "ca.pem").exists():
            raise CertificateError(path=str(directory), reason="there is an authority already", advice="choose another directory")
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        usage = _key_usage(signs_certificates=True)
        certificate = (
            _builder(subject, issuer=subject, public_key=key.public_key(), days=days, now=now)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(usage, critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .sign(key, hashes.SHA256())
        )
        with _writing(directory):
            directory.mkdir(mode=0o700, parents=True, exist_ok=True)
            _write_new(directory / "ca.key", _private_pem(key), mode=0o600)
            _write_new(directory / "ca.pem", _pem(certificate), mode=0o644)
            if not (directory / "roster.txt").exists():
                _write_new(directory / "roster.txt", _ROSTER_HEAD.encode(), mode=0o644)
        return cls(directory, certificate=certificate, key=key)

    @classmethod
    def open(cls, directory: Path) -> "Authority":
        """Open the authority of a directory.

        Raises
        ------
        CertificateError
            There is none, or its files are no certificate and key.
        """
        certificate = _load_certificate(directory / "ca.pem", advice="make an authority with `biobot-gateway certs init`")
        path = directory / "ca.key"
        try:
            key = serialization.load_pem_private_key(path.read_bytes(), password=None)
        except OSError as error:
            raise CertificateError(path=str(path), reason=_told(error), advice="issue where the authority's key is kept") from error
        except (ValueError, TypeError) as error:
            raise CertificateError(path=str(path), reason="holds no private key in PEM form", advice="restore it from a copy") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
            raise CertificateError(path=str(path), reason="is not the key to ca.pem", advice="restore both from the same copy")
        return cls(directory, certificate=certificate, key=key)

    def sites(self) -> list[str]:
        """Return the sites that those on the roster are of, in order; who is welcome at all sites says nothing of them.

        Raises
        ------
        CertificateError
            The roster cannot be read.
        """
        path = self._directory / "roster.txt"
        with _writing(path):
            text = path.read_text(encoding="utf-8") if path.exists() else ""
        return sorted({member.site for member in parse_roster(text)[0]} - {ANY})

    def issue(self, identity: Identity, *, hosts: Sequence[str], days: int, now: datetime, renew: bool = False) -> Path:
        """Issue a certificate, enter it on the roster, and return its folder.

        Parameters
        ----------
        hosts
            Host names and addresses under which others connect to this service; none for one that listens nowhere.
        renew
            The identity has a certificate: keep it and its key as ``.old`` files, and take its hosts where none are given.

        Raises
        ------
        CertificateError
            There is one already and ``renew`` is not set, or none and it is; a host is none, or a router has none; a file cannot be
            written.
        """
        folder = folder_of(self._directory, identity)
        target = folder / "certificate.pem"
        if target.exists() and not renew:
            raise CertificateError(path=str(target), reason="is there already", advice="renew it with --renew, or give another name")
        if renew:
            known = _load_certificate(target, advice="leave --renew out to issue the first one")
            hosts = hosts or _hosts_of(known)
        if days < 1 or now + timedelta(days=days) > self._certificate.not_valid_after_utc:
            left = (self._certificate.not_valid_after_utc - now).days
            raise CertificateError(
                path=str(target),
                reason=f"{days} days are asked for, but the authority lasts {left} more",
                advice="give --days from 1 to that",
            )
        if problems := _host_problems(identity.common_name, hosts):
            raise CertificateError(path=str(target), reason=problems[0], advice="give each name and address by which others reach it")
        names = [_general_name(host, path=str(target)) for host in hosts]
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, identity.common_name)])
        usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        builder = (
            _builder(subject, issuer=self._certificate.subject, public_key=key.public_key(), days=days, now=now)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_key_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False)
            # A certificate without any name in it is refused by TLS libraries even where nobody compares names.
            .add_extension(x509.SubjectAlternativeName(names or [x509.DNSName(f"{identity.name}.invalid")]), critical=False)
        )
        certificate = builder.sign(self._key, hashes.SHA256())
        with _writing(folder):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if renew:
                for name in ("certificate.pem", "key.pem"):
                    (folder / name).replace(folder / f"{name}.old")
            _write_new(folder / "key.pem", _private_pem(key), mode=0o600)
            _write_new(target, _pem(certificate), mode=0o644)
            _write_new(folder / "ca.pem", _pem(self._certificate), mode=0o644, may_exist=True)
        self._enter(identity)
        return folder

    def _enter(self, identity: Identity) -> None:
        path = self._directory / "roster.txt"
        with _writing(path):
            text = path.read_text(encoding="utf-8") if path.exists() else _ROSTER_HEAD
            if identity in parse_roster(text)[0]:
                return
            joint = "" if text.endswith("\n") else "\n"
            partial = path.with_name(".roster.partial")
            partial.write_text(f"{text}{joint}{identity.common_name}\n", encoding="utf-8")
            partial.replace(path)


def list_certificates(directory: Path, *, now: datetime) -> list[IssuedCertificate]:
    """Return all certificates of a directory with what is wrong with each, by name; the authority's own comes first.

    Raises
    ------
    CertificateError
        There is no authority, or the roster cannot be read.
    """
    ca = _load_certificate(directory / "ca.pem", advice="make an authority with `biobot-gateway certs init`")
    roster_path = directory / "roster.txt"
    with _writing(roster_path):
        members, problems = parse_roster(roster_path.read_text(encoding="utf-8"))
    roster = {member.common_name for member in members}
    own = IssuedCertificate(
        identity=_common_name(ca),
        folder=directory,
        hosts=(),
        not_after=ca.not_valid_after_utc,
        is_on_roster=True,
        problems=(*_date_problems(ca, now), *_mode_problems(directory / "ca.key"), *(f"roster.txt {problem}" for problem in problems)),
    )
    found = [own]
    for path in sorted(directory.glob("*/*/*/certificate.pem")):
        certificate = _load_certificate(path, advice="issue it again")
        name = _common_name(certificate)
        found.append(
            IssuedCertificate(
                identity=name,
                folder=path.parent,
                hosts=_hosts_of(certificate),
                not_after=certificate.not_valid_after_utc,
                is_on_roster=name in roster,
                problems=(
                    *_date_problems(certificate, now),
                    *_mode_problems(path.parent / "key.pem"),
                    *_issuer_problems(certificate, ca),
                    *_name_problems(name),
                    *_host_problems(name, _hosts_of(certificate)),
                ),
            )
        )
    return found


def folder_of(directory: Path, identity: Identity) -> Path:
    """Return where an identity's files lie."""
    return directory / ("all-sites" if identity.site == "*" else identity.site) / identity.role.value / identity.name


def _builder(
    subject: x509.Name, *, issuer: x509.Name, public_key: ec.EllipticCurvePublicKey, days: int, now: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BACKDATED)
        .not_valid_after(now + timedelta(days=days))
    )


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _general_name(host: str, *, path: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        if not _HOST.match(host) or len(host) > 253:
            raise CertificateError(
                path=path, reason=f"{host!r} is no host name and no address", advice="give --host base1.local or --host 192.168.1.7"
            ) from None
        return x509.DNSName(host)


def _hosts_of(certificate: x509.Certificate) -> tuple[str, ...]:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    hosts = [str(name.value) for name in names if isinstance(name, x509.DNSName | x509.IPAddress)]
    return tuple(host for host in hosts if not host.endswith(".invalid"))


def _common_name(certificate: x509.Certificate) -> str:
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def _date_problems(certificate: x509.Certificate, now: datetime) -> list[str]:
    if now > certificate.not_valid_after_utc:
        return [f"out of date since {certificate.not_valid_after_utc:%Y-%m-%d}; renew it with --renew"]
    if now < certificate.not_valid_before_utc:
        return [f"not valid before {certificate.not_valid_before_utc:%Y-%m-%d %H:%M} UTC; is this machine's clock right?"]
    return []


def _mode_problems(path: Path) -> list[str]:
    try:
        mode = path.stat().st_mode & 0o777
    except OSError as error:
        return [f"{path.name}: {_told(error)}"]
    return [f"{path.name} may be read by others (mode {mode:04o}); chmod 600 {path}"] if mode & 0o077 else []


def _issuer_problems(certificate: x509.Certificate, ca: x509.Certificate) -> list[str]:
    try:
        certificate.verify_directly_issued_by(ca)
    except (ValueError, TypeError, InvalidSignature):
        return ["not issued by the authority of this directory; issue it again"]
    return []


def _name_problems(common_name: str) -> list[str]:
    try:
        parse_identity(common_name)
    except KeyExpressionError as error:
        return [str(error)]
    return []


def _host_problems(common_name: str, hosts: Sequence[str]) -> list[str]:
    """A router is there to be connected to; of the others one that listens needs hosts, which its certificate does not tell."""
    is_router = common_name.split("/")[1:2] == [Role.ROUTER.value]
    return ["a router's certificate without a host lets nobody connect; issue it with --host ADDRESS"] if is_router and not hosts else []


def _load_certificate(path: Path, *, advice: str) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as error:
        raise CertificateError(path=str(path), reason=_told(error), advice=advice) from error
    except ValueError as error:
        raise CertificateError(path=str(path), reason="holds no certificate in PEM form", advice=advice) from error


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _private_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())


def _write_new(path: Path, content: bytes, *, mode: int, may_exist: bool = False) -> None:
    """Write a file that nobody else can have opened in between: it has its mode from the start."""
    flags = os.O_WRONLY | os.O_CREAT | (os.O_TRUNC if may_exist else os.O_EXCL)
    with os.fdopen(os.open(path, flags, mode), "wb") as file:
        file.write(content)


class _writing:  # noqa: N801  # used as a statement's word
    """Turn what the file system refuses into an error that names the file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if isinstance(error, OSError):
            path = str(error.filename or self._path)
            raise CertificateError(path=path, reason=_told(error), advice="choose a directory that this user may write") from error
        if isinstance(error, UnicodeDecodeError):
            raise CertificateError(path=str(self._path), reason="is no UTF-8 text", advice="restore it from a copy") from error


def _told(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
