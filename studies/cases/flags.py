"""Flags of every command that runs cases."""

import argparse
from pathlib import Path

from studies.cases.run import Changed, Options
from studies.cases.workers import LOCAL_CLUSTER, Workers


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Add ``--jobs``, ``--dask``, ``--changed`` and ``--retry-failed``."""
    group = parser.add_argument_group("how cases are run")
    group.add_argument("--jobs", type=_count, metavar="N", help="processes at once (default: one a core)")
    group.add_argument("--dask", metavar="ADDRESS", help=f"compute on a Dask cluster: tcp://HOST:PORT, or {LOCAL_CLUSTER!r} (extra 'dask')")
    group.add_argument(
        "--changed",
        type=Changed,
        choices=list(Changed),
        default=Changed.REFUSE,
        help="what to do with kept results of an earlier state of the code (default: %(default)s)",
    )
    group.add_argument("--retry-failed", action="store_true", help="compute again what failed before")


def read_flags(parsed: argparse.Namespace, *, journal: Path | None) -> Options:
    """Return what the flags say."""
    workers = Workers(jobs=parsed.jobs, dask=parsed.dask)
    return Options(journal=journal, workers=workers, changed=parsed.changed, retry_failed=parsed.retry_failed)


def _count(text: str) -> int:
    try:
        count = int(text)
    except ValueError:
        count = 0
    if not 1 <= count <= 1024:
        raise argparse.ArgumentTypeError(f"{text!r}; wanted a whole number from 1 to 1024")
    return count
