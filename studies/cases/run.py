"""Run the cases of a study: take from the journal what is there, compute what is not, and write each down when it is done."""

import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache, partial
from pathlib import Path
from typing import Any, Generic

import msgspec

from studies.cases.journal import Entry, Failure, Journal
from studies.cases.program import PackageFile, fingerprint
from studies.cases.progress import Progress
from studies.cases.study import CaseT, ResultT, Study, plain
from studies.cases.workers import Workers
from studies.errors import CaseFailedError, ChangedProgramError, ForeignProgramError


class Changed(StrEnum):
    """What to do with results that another program computed: the code has changed since."""

    REFUSE = "refuse"
    RECOMPUTE = "recompute"
    KEEP = "keep"


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How cases are run.

    Parameters
    ----------
    journal
        File of what is done; None keeps nothing.
    workers
        Who computes.
    changed
        What to do with results of another program.
    retry_failed
        Compute again what failed before.
    """

    journal: Path | None = None
    workers: Workers = field(default_factory=Workers)
    changed: Changed = Changed.REFUSE
    retry_failed: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished(Generic[CaseT, ResultT]):
    """A case that is done: ``result`` is None where it failed, and ``failure`` says why."""

    case: CaseT
    result: ResultT | None
    failure: Failure | None
    seconds: float


def run_cases(study: Study[CaseT, ResultT], cases: Sequence[CaseT], options: Options, *, label: str) -> list[Finished[CaseT, ResultT]]:
    """Compute all cases that the journal does not hold, and return all, in the order of ``cases``.

    Parameters
    ----------
    label
        Names the cases in the account of progress on standard error.

    Raises
    ------
    ChangedProgramError
        The journal's results of these cases were computed by another program, and such are refused.
    JournalError, JournalBusyError, DaskError, WorkerLostError
        What is done stays done: another call goes on from there.

    Notes
    -----
    A case that raises is a failure, which is written down like a result; the other cases go on.
    """
    named = {study.digest(case): case for case in cases}
    program = fingerprint(study.compute, study.files)
    with Journal(options.journal, study=study.name) as journal:
        known = _usable(journal, named.keys(), program=program, options=options)
        _tell_of_journal(journal, n_wanted=len(journal.entries.keys() & named.keys()))
        todo = [(name, case) for name, case in named.items() if name not in known]
        attempt = partial(_attempt, study, program if options.workers.are_remote else None)
        with Progress(label=label, total=len(named), done=len(known)) as progress:
            for entry in _computed(options.workers, attempt, todo):
                if entry.program not in {"", program}:
                    raise ForeignProgramError(own=entry.program, wanted=program)
                journal.append(msgspec.structs.replace(entry, program=program, key=plain(study.key_of(named[entry.digest]))))
                progress.step(has_failed=entry.failure is not None)
        return [_finish(study, case, journal.entries[study.digest(case)]) for case in cases]


def results_of(finished: Sequence[Finished[CaseT, ResultT]]) -> list[ResultT]:
    """Return the results of cases of which none may fail.

    Raises
    ------
    CaseFailedError
        One did.
    """
    failures = [one for one in finished if one.failure is not None]
    if failures:
        first = failures[0].failure
        assert first is not None
        raise CaseFailedError(
            n_failed=len(failures), n_cases=len(finished), case=str(failures[0].case), kind=first.kind, message=first.message
        )
    return [one.result for one in finished if one.result is not None]


def _usable(journal: Journal, wanted: Any, *, program: str, options: Options) -> set[str]:
    """Return the digests of those wanted that need not be computed."""
    entries = [journal.entries[name] for name in wanted if name in journal.entries]
    if options.retry_failed:
        entries = [entry for entry in entries if entry.failure is None]
    old = [entry for entry in entries if entry.program != program]
    if old and options.changed is Changed.REFUSE:
        raise ChangedProgramError(path=journal.path, n_old=len(old), n_cases=len(wanted), was=old[-1].program, now=program)
    if options.changed is Changed.RECOMPUTE:
        entries = [entry for entry in entries if entry.program == program]
    return {entry.digest for entry in entries}


def _tell_of_journal(journal: Journal, *, n_wanted: int) -> None:
    if journal.has_torn_line:
        sys.stderr.write(f"{journal.path}: the last line was cut short by a crash and is left out; its case is computed again\n")
    others = len(journal.entries) - n_wanted
    if others:
        sys.stderr.write(f"{journal.path}: {others} of {len(journal.entries)} results belong to other cases; they stay and are not used\n")


def _computed(workers: Workers, attempt: Callable[[tuple[str, CaseT]], Entry], todo: Sequence[tuple[str, CaseT]]) -> Iterator[Entry]:
    """Yield what comes from the workers; none is begun where nothing is to do."""
    if todo:
        yield from workers.map(attempt, todo)


@cache
def _own_program(compute: Callable[..., Any], files: tuple[PackageFile, ...]) -> str:
    return fingerprint(compute, files)


def _attempt(study: Study[CaseT, ResultT], wanted_program: str | None, item: tuple[str, CaseT]) -> Entry:
    """Compute one case, in a worker.

    Parameters
    ----------
    wanted_program
        What the worker must run: another one computes nothing, and says which it is. None where it cannot be another.
    """
    name, case = item
    own = "" if wanted_program is None else _own_program(study.compute, study.files)
    if own != (wanted_program or ""):
        return Entry(digest=name, program=own, seconds=0.0)
    began_s = time.perf_counter()
    try:
        result, failure = study.pack(study.compute(case)), None
    except Exception as error:  # noqa: BLE001  # whatever it is, it is written down, and the other cases go on
        result, failure = None, Failure(kind=type(error).__name__, message=str(error), traceback="".join(traceback.format_exception(error)))
    return Entry(digest=name, program=own, seconds=round(time.perf_counter() - began_s, 6), result=result, failure=failure)


def _finish(study: Study[CaseT, ResultT], case: CaseT, entry: Entry) -> Finished[CaseT, ResultT]:
    result = None if entry.failure is not None else study.unpack(entry.result)
    return Finished(case=case, result=result, failure=entry.failure, seconds=entry.seconds)
