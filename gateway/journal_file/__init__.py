"""The journal's file: segments of records and reports in SQLite, written by one gateway and read by anybody (docs/journal.md)."""

from gateway.journal_file.description import describe_journal, expect_journal
from gateway.journal_file.file import SESSIONS_PER_START, JournalFile, open_journal_file
from gateway.journal_file.integrity import check_journal
from gateway.journal_file.reader import JournalReader, RecordPage
from gateway.journal_file.segments import SegmentBuilder
from gateway.journal_file.upkeep import Retention, Upkeep
from gateway.journal_file.writes import AuditEntry, Committed, JournalIdentity, JournalWrite, UplinkReport

__all__ = [
    "SESSIONS_PER_START",
    "AuditEntry",
    "Committed",
    "JournalFile",
    "JournalIdentity",
    "JournalReader",
    "JournalWrite",
    "RecordPage",
    "Retention",
    "SegmentBuilder",
    "Upkeep",
    "UplinkReport",
    "check_journal",
    "describe_journal",
    "expect_journal",
    "open_journal_file",
]
