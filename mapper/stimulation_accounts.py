"""How biobots were stimulated, as their gateways last told. Pure."""

from typing import Final

from firmware_protocol.contract.commands import StimulationAccount
from firmware_protocol.units import NodeId

_MAX_ACCOUNTS: Final = 65_536


class StimulationAccounts:
    """The newest account of each biobot at each gateway; ``n_ignored`` counts those for which there was no room."""

    def __init__(self) -> None:
        self.n_ignored = 0
        self._accounts: dict[tuple[NodeId, str], StimulationAccount] = {}

    def take(self, account: StimulationAccount) -> None:
        """Note an account; it stands for the one before, as the gateway's clock may have been set back."""
        key = (account.node, account.gateway)
        if key not in self._accounts and len(self._accounts) >= _MAX_ACCOUNTS:
            self.n_ignored += 1
        else:
            self._accounts[key] = account

    def of(self, node: NodeId) -> list[StimulationAccount]:
        """List what gateways told of one biobot, by gateway."""
        return [account for account in self.all() if account.node == node]

    def all(self) -> list[StimulationAccount]:
        """List all accounts, by biobot and gateway."""
        return [account for _, account in sorted(self._accounts.items(), key=lambda item: item[0])]
