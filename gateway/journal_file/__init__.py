"""The journal's file: segments of records and reports in SQLite, written by one gateway and read by anybody (docs/journal.md)."""

from gateway.journal_file.audit_chain import ChainHead
from gateway.journal_file.audit_reading import (
    AuditSelection,
    Dose,
    UnreadableRow,
    read_audit_kinds,
    read_audit_rows,
    read_doses,
    verify_audit_of,
)
from gateway.journal_file.audit_verify import AuditFindings
from gateway.journal_file.description import describe_journal, expect_fit_to_open, expect_journal
from gateway.journal_file.file import PROGRESS, SESSIONS_PER_START, JournalFile, is_in_use, open_journal_file
from gateway.journal_file.integrity import check_journal
from gateway.journal_file.reader import JournalReader, RecordPage
from gateway.journal_file.schema import AFTER_DAMAGE
from gateway.journal_file.segments import SegmentBuilder
from gateway.journal_file.upkeep import Retention, Upkeep
from gateway.journal_file.walk import LeftOut, newest_offset, walk_records, walk_reports
from gateway.journal_file.writes import SENT_AGAIN, STAGE, AuditEntry, Committed, Damage, JournalIdentity, JournalWrite, UplinkReport

__all__ = [
    "AFTER_DAMAGE",
    "PROGRESS",
    "SENT_AGAIN",
    "SESSIONS_PER_START",
    "STAGE",
    "AuditEntry",
    "AuditFindings",
    "AuditSelection",
    "ChainHead",
    "Committed",
    "Damage",
    "Dose",
    "JournalFile",
    "JournalIdentity",
    "JournalReader",
    "JournalWrite",
    "LeftOut",
    "RecordPage",
    "Retention",
    "SegmentBuilder",
    "UnreadableRow",
    "Upkeep",
    "UplinkReport",
    "check_journal",
    "describe_journal",
    "expect_fit_to_open",
    "expect_journal",
    "is_in_use",
    "newest_offset",
    "open_journal_file",
    "read_audit_kinds",
    "read_audit_rows",
    "read_doses",
    "verify_audit_of",
    "walk_records",
    "walk_reports",
]
