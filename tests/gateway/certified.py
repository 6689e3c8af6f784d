"""An authority with certificates for tests, and sessions that show them."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import zenoh

from firmware_protocol.contract.access import access_control, parse_identity, parse_roster
from firmware_protocol.contract.sessions import TlsTable
from gateway.bus_session import open_service
from gateway.certificates import Authority, folder_of


class Certified:
    """An authority in a directory; every certificate is good for 127.0.0.1."""

    def __init__(self, directory: Path, *, now: datetime | None = None) -> None:
        self.directory = directory
        self._now = now or datetime.now(UTC)
        self._authority = Authority.init(directory, name="test authority", days=3650, now=self._now)

    def tls(self, common_name: str, *, days: int = 90) -> TlsTable:
        """Return the table of an identity, whose certificate is issued when it has none."""
        identity = parse_identity(common_name)
        folder = folder_of(self.directory, identity)
        if not folder.exists():
            self._authority.issue(identity, hosts=["127.0.0.1"], days=days, now=self._now)
        return TlsTable(ca=str(folder / "ca.pem"), certificate=str(folder / "certificate.pem"), key=str(folder / "key.pem"))

    @property
    def roster(self) -> Path:
        return self.directory / "roster.txt"

    @contextmanager
    def router(self, port: int, *, host: str = "127.0.0.1") -> Iterator[zenoh.Session]:
        """Open a router in this process that heeds the roster as it is now."""
        tls = self.tls("*/router/main")
        members, _ = parse_roster(self.roster.read_text())
        with open_service(listen=[f"tls/{host}:{port}"], connect=[], tls=tls, access=access_control(members)) as session:
            yield session
