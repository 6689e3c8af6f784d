"""Stages of commands: made, written down, and told to whoever listens.

Each comes to the audit log and to the listeners in one place; a listener that fails keeps nobody else from being told.
"""

import asyncio
from collections.abc import Callable
from functools import partial

from firmware_protocol.contract.commands import CommandStage, Refusal, Stage
from firmware_protocol.contract.records import Mode, encode_record
from firmware_protocol.units import Nanoseconds, NodeId
from gateway.errors import JournalFullError
from gateway.health import Health
from gateway.journal_file import STAGE, AuditEntry, JournalWrite
from gateway.log import EventLog
from gateway.stimulation.commands import Command
from gateway.stimulation.outside import CommandJournal, CommandListener, StageListener
from gateway.stimulation.verdict import Refused

_log = EventLog(__name__)

COMMIT_TIMEOUT_S = 1.0
"""A command that is not on disk after this is refused: the disk is full or broken."""

LATE_REPLY = "late_reply"
"""Kind of a row of the audit log that nobody is told: a biobot's answer came when its command's last stage had been told."""

STRAYED = "strayed"
"""The same: another biobot than the one meant has obeyed, and has got the train."""

TAKEN_BACK = "taken_back"
"""The same: the frame that had the stop's train never left."""

OBEYED, NOT_OBEYED = "obeyed", "not_obeyed"
"""The same: the mode that the biobot reported after the command."""


class StageTeller:
    """Tells stages; see the module's description."""

    def __init__(
        self,
        *,
        gateway: str,
        journal: CommandJournal,
        health: Health,
        now_ns: Callable[[], int],
        wall_clock: Callable[[], int],
    ) -> None:
        self._gateway = gateway
        self._journal = journal
        self._health = health
        self._now_ns = now_ns
        self._wall_clock = wall_clock
        self._listeners: list[CommandListener] = []
        self._row_listeners: list[Callable[[AuditEntry], None]] = []

    def listen(self, listener: CommandListener) -> None:
        """Have ``listener`` called in the loop with every stage of every command, after it was given to the journal."""
        self._listeners.append(listener)

    def listen_to_rows(self, listener: Callable[[AuditEntry], None]) -> None:
        """Have ``listener`` called with every row that is given to the journal, or would be."""
        self._row_listeners.append(listener)

    def stage(
        self,
        command: Command,
        stage: Stage,
        *,
        reason: str = "",
        refusal: Refusal | None = None,
        mode: Mode | None = None,
        deadline_ns: int | None = None,
    ) -> CommandStage:
        """Return a stage of a command; ``deadline_ns`` (monotonic) is by when the next one is told."""
        request, wall_ns = command.request, self._wall_clock()
        return CommandStage(
            command_id=request.command_id,
            gateway=self._gateway,
            node=request.node,
            action=request.action,
            stage=stage,
            wall_ns=Nanoseconds(wall_ns),
            reason=reason,
            mode=mode,
            operator=request.operator,
            refusal=refusal,
            deadline_wall_ns=None if deadline_ns is None else Nanoseconds(wall_ns + deadline_ns - self._now_ns()),
            part_of=command.part_of,
        )

    async def commit(self, command: Command, stage: CommandStage, *, train_ms: int = 0) -> bool:
        """Write a stage down, and wait for the disk; tell nobody. False: it was not there in time, or the command was overtaken."""
        committed = self.write(command, stage, train_ms=train_ms)
        if committed is None:
            return False
        await asyncio.wait({committed, command.overtaken}, timeout=COMMIT_TIMEOUT_S, return_when=asyncio.FIRST_COMPLETED)
        return committed.done() and not committed.cancelled() and committed.exception() is None and not command.is_overtaken

    async def refuse(self, command: Command, refused: Refused) -> None:
        """Tell a refusal when it is on disk, or after a while all the same."""
        stage = self.stage(command, Stage.REFUSED, reason=refused.reason, refusal=refused.refusal)
        committed = self.write(command, stage)
        if committed is not None:
            await asyncio.wait({committed}, timeout=COMMIT_TIMEOUT_S)
        if committed is None or not committed.done() or committed.exception() is not None:
            _log.error("command.not_journaled", command=stage.command_id, stage=stage.stage.value)
        self.announce(command, stage)

    def tell(
        self,
        command: Command,
        stage: Stage,
        *,
        reason: str = "",
        refusal: Refusal | None = None,
        mode: Mode | None = None,
        train_ms: int = 0,
        deadline_ns: int | None = None,
    ) -> "asyncio.Future[None] | None":
        """Tell a stage and write it down, without waiting for the disk: the animal has been, or must be, acted on already.

        Returns
        -------
        asyncio.Future or None
            Done when it is on disk; None: the journal has no room.
        """
        told = self.stage(command, stage, reason=reason, refusal=refusal, mode=mode, deadline_ns=deadline_ns)
        written = self.write(command, told, train_ms=train_ms)
        self.announce(command, told)
        return written

    def note(
        self, command: Command, row: str, *, node: NodeId | None = None, train_ms: int = 0, reason: str = ""
    ) -> "asyncio.Future[None] | None":
        """Write down what is no stage; ``node`` is another biobot than the command's. Returns what ``tell`` does."""
        return self.write(command, self.stage(command, command.stages[-1].stage, reason=reason), train_ms=train_ms, row=row, node=node)

    def announce(self, command: Command, stage: CommandStage) -> None:
        """Tell a stage that is written down."""
        command.stages.append(stage)
        self._health.count(f"command.{stage.stage.value}")
        if stage.is_final:
            _log.info("command.done", command=stage.command_id, node=stage.node, action=stage.action.value, outcome=stage.stage.value)
        for listener in command.listeners:
            self._call(stage.command_id, partial(listener, stage))
        for hears_all in self._listeners:
            self._call(stage.command_id, partial(hears_all, command.request, stage))

    def answer(self, listener: StageListener, stage: CommandStage) -> None:
        """Tell one listener alone."""
        self._call(stage.command_id, partial(listener, stage))

    def write(
        self, command: Command, stage: CommandStage, *, train_ms: int = 0, row: str | None = None, node: NodeId | None = None
    ) -> "asyncio.Future[None] | None":
        """Give a row to the journal; None: it has no room, and it is told in the log."""
        entry = AuditEntry(
            wall_ns=self._wall_clock(),
            command_id=stage.command_id,
            wire_command=command.wire_command,
            kind=row or STAGE,
            stage=row or stage.stage.value,
            node=stage.node if node is None else node,
            operator=command.request.operator,
            mono_ns=self._now_ns(),
            train_ms=train_ms,
            request=encode_record(command.request),
            body=encode_record(stage),
        )
        for listener in self._row_listeners:
            self._call(stage.command_id, partial(listener, entry))
        try:
            return self._journal.append(JournalWrite(audit=entry))
        except JournalFullError as error:
            _log.error("command.not_journaled", command=stage.command_id, stage=entry.stage, kind=entry.kind, reason=str(error))
            return None

    def _call(self, command_id: str, tell: Callable[[], None]) -> None:
        try:
            tell()
        except Exception as error:  # noqa: BLE001  # whoever listens is no reason to leave an animal as it is
            self._health.count("command.broken_listener")
            _log.error("command.broken_listener", command=command_id, reason=f"{type(error).__name__}: {error}")
