"""The one gate for commands to living animals: admits, limits, expires, confirms, and journals all of it (docs/stimulation.md)."""

from gateway.stimulation.gate import StimulationGate
from gateway.stimulation.outside import AuditReader, CommandJournal, CommandSender

__all__ = ["AuditReader", "CommandJournal", "CommandSender", "StimulationGate"]
