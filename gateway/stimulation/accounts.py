"""How each biobot was stimulated, for its keepers: counted from the rows of the audit log, as they are written and, after a restart, read.

What limits stimulation is the ledger; this only tells.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from firmware_protocol.contract.commands import Stage, StimulationAccount
from firmware_protocol.units import NS_PER_MS, Nanoseconds, NodeId
from gateway.config import StimulationTable
from gateway.journal_file import STAGE, AuditEntry
from gateway.nodes import NodeBook
from gateway.stimulation.habituation import Habituation
from gateway.stimulation.ledger import TrainLedger
from gateway.stimulation.telling import NOT_OBEYED, OBEYED, TAKEN_BACK

_UNSENT = frozenset({Stage.REFUSED, Stage.FAILED})
_STAGES = {stage.value: stage for stage in Stage}
_MAX_OPEN = 64
"""Trains of one biobot that may yet prove not to have been given; older ones count."""


@dataclass(slots=True)
class _Account:
    n_trains: int = 0
    on_ms: int = 0
    last_train_wall_ns: int | None = None
    n_commands: int = 0
    n_confirmed: int = 0
    n_unknown: int = 0
    n_refused: int = 0
    n_answerable: int = 0
    n_obeyed: int = 0
    habituation: Habituation = field(default_factory=Habituation)
    open: dict[str, tuple[int, Habituation, int | None]] = field(default_factory=dict)
    """By command: the length of its train [ms], and what was so before it."""


class Accounts:
    """One account for each biobot that ever got a command; at most as many as there are biobots."""

    def __init__(
        self,
        *,
        gateway: str,
        table: StimulationTable,
        ledger: TrainLedger,
        nodes: NodeBook,
        controller_of: Callable[[NodeId], str],
    ) -> None:
        self._gateway = gateway
        self._table = table
        self._ledger = ledger
        self._nodes = nodes
        self._controller_of = controller_of
        self._accounts: dict[NodeId, _Account] = {}

    def take(self, entry: AuditEntry) -> None:
        """Count a row of the audit log; rows of one command come in order."""
        if entry.node is None or self._nodes.find(entry.node) is None:
            return
        account = self._accounts.get(entry.node)
        if account is None:
            account = self._accounts[entry.node] = _Account()
        stage = _STAGES.get(entry.stage) if entry.kind == STAGE else None
        if stage in {Stage.ACCEPTED, Stage.REFUSED} and entry.command_id not in account.open:
            account.n_commands += 1
        if entry.train_ms:
            self._add_train(account, entry)
        elif stage is Stage.ACCEPTED:
            account.open.setdefault(entry.command_id, (0, account.habituation, account.last_train_wall_ns))
        while len(account.open) > _MAX_OPEN:
            del account.open[next(iter(account.open))]
        account.n_confirmed += stage is Stage.BIOBOT_CONFIRMED
        account.n_unknown += stage is Stage.UNKNOWN
        account.n_refused += stage is Stage.REFUSED
        account.n_answerable += entry.kind in {OBEYED, NOT_OBEYED}
        account.n_obeyed += entry.kind == OBEYED
        if stage in _UNSENT or entry.kind == TAKEN_BACK:
            self._take_train_back(account, entry.command_id)
        elif stage in {Stage.BIOBOT_CONFIRMED, Stage.UNKNOWN}:
            account.open.pop(entry.command_id, None)

    def of(self, node: NodeId, *, now_ns: int, wall_ns: int) -> StimulationAccount | None:
        """Return a biobot's account as it is now, or None where it never got a command."""
        account = self._accounts.get(node)
        if account is None:
            return None
        known = self._nodes.find(node)
        n_in_window, on_ms_in_window = self._ledger.in_window(node, now_ns=now_ns)
        ready_ns = self._ledger.ready_ns(
            node, train_ms=self._table.duration_ms, now_ns=now_ns, announced=None if known is None else known.limits
        )
        ready_in_ms = _NEVER_MS if ready_ns is None else -((now_ns - ready_ns) // NS_PER_MS)
        return StimulationAccount(
            gateway=self._gateway,
            node=node,
            wall_ns=Nanoseconds(wall_ns),
            n_trains=account.n_trains,
            on_ms=account.on_ms,
            n_trains_in_window=n_in_window,
            on_ms_in_window=on_ms_in_window,
            window_s=self._table.window_s,
            last_train_wall_ns=None if account.last_train_wall_ns is None else Nanoseconds(account.last_train_wall_ns),
            ready_in_ms=ready_in_ms,
            n_commands=account.n_commands,
            n_confirmed=account.n_confirmed,
            n_unknown=account.n_unknown,
            n_refused=account.n_refused,
            n_answerable=account.n_answerable,
            n_obeyed=account.n_obeyed,
            habituation=account.habituation.at(wall_ns),
            controlled_by=self._controller_of(node),
        )

    def nodes(self) -> list[NodeId]:
        """Return whose accounts there are."""
        return sorted(self._accounts)

    @staticmethod
    def _add_train(account: _Account, entry: AuditEntry) -> None:
        account.open[entry.command_id] = (entry.train_ms, account.habituation, account.last_train_wall_ns)
        account.n_trains += 1
        account.on_ms += entry.train_ms
        account.last_train_wall_ns = entry.wall_ns
        account.habituation = account.habituation.after_train(entry.wall_ns)

    @staticmethod
    def _take_train_back(account: _Account, command_id: str) -> None:
        train_ms, habituation, last_wall_ns = account.open.pop(command_id, (0, account.habituation, account.last_train_wall_ns))
        if train_ms:
            account.n_trains -= 1
            account.on_ms -= train_ms
            account.habituation, account.last_train_wall_ns = habituation, last_wall_ns


_NEVER_MS = 0x7FFF_FFFF
"""Stands for a train that no wait makes admissible: the configuration's own is beyond what the backpack allows in a minute."""
