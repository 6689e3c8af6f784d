"""What the gate needs of the rest of the gateway: a way to the radios, a journal, and what the journal has. Nothing else is the outside."""

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Protocol

from firmware_protocol.contract.commands import CommandStage, StimulationAccount, StimulationRequest
from firmware_protocol.messages import Stimulate
from firmware_protocol.units import NodeId
from gateway.journal_file import AuditEntry, JournalWrite
from gateway.radio import RadioOutcome

StageListener = Callable[[CommandStage], None]
"""Hears the stages of one command."""

CommandListener = Callable[[StimulationRequest, CommandStage], None]
"""Hears every stage of every command."""

AccountListener = Callable[[StimulationAccount], None]

Sending = asyncio.Future[RadioOutcome]
"""Fate of a frame; never fails."""


class CommandSender(Protocol):
    """The way to the biobots, as of ``DownlinkSender``. What cannot be sent raises ``RadioUnavailableError``."""

    def send(self, node: NodeId, message: Stimulate, *, is_urgent: bool = False) -> Sending:
        """Send over the radio that heard the biobot last."""
        ...

    def send_elsewhere(self, node: NodeId, message: Stimulate) -> list[Sending]:
        """Send, urgently, over each other radio that heard the biobot within the last minutes; never raises."""
        ...

    def ways_to(self, node: NodeId) -> Sequence[str]:
        """Return the radios that may reach a biobot: the one that heard it last, and each other that heard it within the last minutes."""
        ...

    def send_over(self, radio: str, node: NodeId, message: Stimulate) -> Sending:
        """Send, urgently, over one of these radios."""
        ...

    def send_to_all(self, message: Stimulate) -> Mapping[str, Sending]:
        """Send to everybody, urgently, over each radio that is up; never raises."""
        ...

    def withdraw(self, sending: Sending) -> bool:
        """Keep a frame from being written; True: it was not, and its fate is NOT_SENT."""
        ...


class CommandJournal(Protocol):
    """Where all is written down, as of ``Journal``."""

    @property
    def fault(self) -> str | None:
        """Why the disk takes nothing now, or None."""
        ...

    def append(self, write: JournalWrite) -> "asyncio.Future[None]":
        """Queue a write; the future is done when it is on disk. Raises ``JournalFullError``."""
        ...


class AuditReader(Protocol):
    """What of earlier commands is on disk, as of ``JournalReader``. May raise ``sqlite3.Error``."""

    def read_audit(self, *, command_id: str) -> Sequence[AuditEntry]:
        """Return all rows of a command, in order."""
        ...

    def read_newest_audit(self, *, limit: int) -> Iterable[AuditEntry]:
        """Yield the newest rows of commands, in order."""
        ...

    def read_last_audit(self, *, kind: str) -> AuditEntry | None:
        """Return the newest row of a kind that is no stage."""
        ...

    def read_last_wire_command(self) -> int | None:
        """Return the number that the last admitted command had on the wire."""
        ...
