"""Errors of the mapper: each leaf is named for what the caller can do about it.

MapError
├── InputFileError         a file of encounters or modes cannot be used; its faults are listed line by line
├── TooFewEncountersError  there is nothing to make a map of yet
├── TooManyEncountersError the kernels cannot number so many encounters
├── UnlikeMapsError        maps to be joined were made in different ways
├── OutOfMemoryError       there is not enough memory for so many encounters
├── UnknownBiobotError     a biobot was named that is in no encounter
├── MapDocumentError       a file or object that should be a map is none
├── PlaceError             a place was named that the map does not show
├── PinsError              pins do not fix a frame
├── RouteError             no route leads from one place to another on the map
├── OutputFileError        a result cannot be written where it was asked for
├── EngineMissingError     a library that this step needs is not installed
├── KernelsError           the kernels that were asked for cannot be used
├── SelfTestError          a map of a known place came out wrong
├── StoreError             the file of records cannot be opened, or is none of ours
├── BusError               Zenoh cannot be used as configured
├── QueryError             a query on the bus was not answered to its end
├── ListenError            the address for HTTP cannot be had
├── WorkerDiedError        the process that was computing ended before its answer
├── JobError               a computation failed for a reason that its code did not foresee
├── NoMapYetError          no map has been finished yet
├── BiobotNotFoundError    no gateway has spoken of this biobot
├── CommandNotFoundError   nobody told of a command of this id lately
├── CommandRefusedError    a command was refused
├── GatewayAwayError       the gateway that something was given to does not answer
├── StopUnansweredError    gateways told nothing of a stop
├── OrderRefusedError      no mission took an order
└── TooManyError           a limit on what runs at the same time is reached: ask again later

Those of access are in `mapper.access.errors`, and those of what is asked of the web service in `mapper.request_errors`.
"""

from collections.abc import Mapping, Sequence

from firmware_protocol.contract.commands import Refusal

_SHOWN_FAULTS = 10


class MapError(Exception):
    """Root of every error the mapper raises."""


class InputFileError(MapError):
    """A file cannot be used; ``faults`` says why, one line each, and ``n_faults`` how many there were in all."""

    def __init__(self, *, path: str, faults: Sequence[str], n_faults: int | None = None) -> None:
        self.path = path
        self.faults = tuple(faults[:_SHOWN_FAULTS])
        self.n_faults = len(faults) if n_faults is None else n_faults
        lines = [f"{path}: {fault}" for fault in self.faults]
        if self.n_faults > len(self.faults):
            lines.append(f"{path}: and {self.n_faults - len(self.faults)} more")
        super().__init__("\n".join(lines))


class TooFewEncountersError(MapError):
    """Fewer encounters than a map needs."""

    def __init__(self, *, n_encounters: int, minimum: int, where: str | None = None, n_outside: int = 0) -> None:
        place = f"{where}: " if where else ""
        counted = "1 encounter" if n_encounters == 1 else f"{n_encounters} encounters"
        lies = f" of {n_encounters + n_outside} between the times wanted" if n_outside else ""
        next_step = "widen --from-s, --until-s or --window-s" if n_outside else "record for longer or with more biobots"
        super().__init__(f"{place}{counted}{lies}, but a map needs at least {minimum}; {next_step}")
        self.n_encounters = n_encounters
        self.minimum = minimum


class TooManyEncountersError(MapError):
    """More encounters than the kernels can number."""

    def __init__(self, *, n_encounters: int, maximum: int) -> None:
        super().__init__(f"{n_encounters} encounters, but a map can be made of at most {maximum}; map a window of time")
        self.n_encounters = n_encounters
        self.maximum = maximum


class UnlikeMapsError(MapError):
    """Maps to be joined were made in different ways, so their distances cannot be compared."""

    def __init__(self, *, what: str, values: Sequence[str]) -> None:
        super().__init__(f"the maps differ in {what}: {', '.join(values)}; make them anew with the same, or merge the encounters")
        self.what = what
        self.values = tuple(values)


class OutOfMemoryError(MapError):
    """There is not enough memory for a map of so many encounters; None where not even all of them could be read."""

    def __init__(self, *, n_encounters: int | None) -> None:
        counted = "all that is read" if n_encounters is None else f"{n_encounters} encounters"
        next_step = "split the file by time" if n_encounters is None else "map a window of time (--window-s, --from-s, --until-s)"
        super().__init__(f"not enough memory for {counted}; {next_step}")
        self.n_encounters = n_encounters


class UnknownBiobotError(MapError):
    """None of the biobots named as stationary is in any encounter."""

    def __init__(self, *, ids: Sequence[int | str]) -> None:
        named = ", ".join(map(str, ids))
        super().__init__(f"no encounter has a biobot of --stationary {named}; compare the ids with the columns of ids")
        self.ids = tuple(ids)


class MapDocumentError(MapError):
    """What should be the JSON of a map is none, or lacks what is needed of it."""

    def __init__(self, *, source: str, problem: str) -> None:
        super().__init__(f"{source}: no map that can be used: {problem}; give what this version's run --json or /api/v1/map wrote")
        self.source = source
        self.problem = problem


class PlaceError(MapError):
    """A place is not understood, or the map does not show it."""

    def __init__(self, *, place: str, problem: str, next_step: str) -> None:
        super().__init__(f"{place!r} {problem}; {next_step}")
        self.place = place
        self.problem = problem
        self.next_step = next_step


class PinsError(MapError):
    """Pins do not fix where the map lies in the operator's frame; ``problems`` says why, one line each."""

    def __init__(self, *, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)


class RouteError(MapError):
    """No route leads from one place to the other on the map."""

    def __init__(self, *, begin: str, end: str, problem: str, next_step: str) -> None:
        super().__init__(f"no route from {begin} to {end}: {problem}; {next_step}")
        self.problem = problem
        self.next_step = next_step


class OutputFileError(MapError):
    """A result cannot be written."""

    def __init__(self, *, path: str, reason: str) -> None:
        super().__init__(f"{path}: cannot write: {reason}; choose another place")
        self.path = path
        self.reason = reason


class EngineMissingError(MapError):
    """A library that this step needs is not installed."""

    def __init__(self, *, library: str, needed_for: str, next_step: str) -> None:
        super().__init__(f"{library} is not installed, but {needed_for} needs it; {next_step}")
        self.library = library


class KernelsError(MapError):
    """The kernels that were asked for cannot be used."""

    def __init__(self, *, problem: str, next_step: str) -> None:
        super().__init__(f"{problem}; {next_step}")
        self.problem = problem


class SelfTestError(MapError):
    """The map of a known place is wrong: something installed here does not work as it should."""

    def __init__(self, *, found: tuple[int, int], wanted: tuple[int, int], parts: str) -> None:
        super().__init__(
            f"the map of a ring has Betti numbers {found}, not {wanted}, with {parts}; "
            "install the package again, see whether BIOBOT_KERNELS=plain helps, and report it"
        )
        self.found = found
        self.wanted = wanted


class StoreError(MapError):
    """The file of records cannot be used; it was not changed."""

    def __init__(self, *, path: str, reason: str, next_step: str) -> None:
        super().__init__(f"{path}: {reason}; {next_step}")
        self.path = path
        self.reason = reason


class BusError(MapError):
    """Zenoh cannot be used as configured."""

    def __init__(self, *, reason: str, next_step: str) -> None:
        super().__init__(f"{reason}; {next_step}")
        self.reason = reason


class QueryError(MapError):
    """A query on the bus was not answered to its end; what came before it counts."""

    def __init__(self, *, key: str, reason: str, is_timeout: bool) -> None:
        super().__init__(f"query {key}: {reason}; see the log of that gateway")
        self.key = key
        self.is_timeout = is_timeout


class ListenError(MapError):
    """The address for HTTP cannot be had."""

    def __init__(self, *, address: str, reason: str, next_step: str) -> None:
        super().__init__(f"cannot listen on {address}: {reason}; {next_step}")
        self.address = address
        self.reason = reason


class WorkerDiedError(MapError):
    """The process that was computing ended before its answer; the next job starts a new one."""

    def __init__(self, *, exit_code: int | None) -> None:
        how = f"was killed by signal {-exit_code}" if exit_code is not None and exit_code < 0 else f"ended with status {exit_code}"
        super().__init__(
            f"the computing process {how} before it was done; the next job starts a new one; see the log, and whether memory ran out"
        )
        self.exit_code = exit_code


class JobError(MapError):
    """A computation failed in its own process; ``details`` is the traceback there."""

    def __init__(self, *, reason: str, details: str) -> None:
        super().__init__(f"the computation failed: {reason}; details are in the log")
        self.reason = reason
        self.details = details


class NoMapYetError(MapError):
    """No map has been finished yet."""

    def __init__(self, *, n_encounters: int, minimum: int, reason: str | None = None, where: str = "yet") -> None:
        if reason is None:
            reason = (
                f"not enough encounters {where}: {n_encounters} of at least {minimum}"
                if n_encounters < minimum
                else f"the first map, of {n_encounters} encounters, is being computed"
            )
        super().__init__(reason)
        self.n_encounters = n_encounters
        self.minimum = minimum


class BiobotNotFoundError(MapError):
    """No gateway has spoken of this biobot."""

    def __init__(self, *, biobot: int) -> None:
        super().__init__(f"no gateway has spoken of biobot {biobot}; GET /api/v1/biobots lists those that are known")
        self.biobot = biobot


class CommandNotFoundError(MapError):
    """Nobody told of a command of this id lately."""

    def __init__(self, *, command_id: str, kept: int) -> None:
        super().__init__(f"no command has id {command_id!r}; of those since the start, the newest {kept} are kept")
        self.command_id = command_id


class CommandRefusedError(MapError):
    """A command was refused; the biobot got nothing. ``refusal`` is why, for programs; None: it did not say."""

    def __init__(self, *, command_id: str, reason: str, refusal: Refusal | None = None) -> None:
        super().__init__(f"the command was refused: {reason or 'the gateway gave no reason'}")
        self.command_id = command_id
        self.reason = reason
        self.refusal = refusal


class GatewayAwayError(MapError):
    """A gateway does not answer, or (None) none does, so a command or an order did not reach it."""

    def __init__(self, *, command_id: str, gateway: str | None, reason: str | None = None) -> None:
        who = "no gateway answers" if gateway is None else f"gateway {gateway!r} does not answer"
        why = "" if reason is None else f" ({reason})"
        delivered = (
            f"what was given to it as {command_id} was not delivered"
            if reason is None
            else f"whether it took what was given to it as {command_id} is not known: ask how it stands, or give it again under the same id"
        )
        super().__init__(f"{who}{why}; {delivered}; see whether the gateway runs and is connected")
        self.command_id = command_id
        self.gateway = gateway


class StopUnansweredError(MapError):
    """Gateways told nothing of a stop, or none is there: their biobots may walk on. ``facts`` is what is known of it, for programs."""

    def __init__(self, *, stop_id: str, gateways: Sequence[str], facts: Mapping[str, object]) -> None:
        who = f"no answer yet from gateway {', '.join(map(repr, gateways))}" if gateways else "no gateway is on the bus"
        super().__init__(
            f"{who}: biobots there may walk on; repeat the stop under the id {stop_id!r}, and look at the gateways and the animals"
        )
        self.stop_id = stop_id
        self.gateways = tuple(gateways)
        self.facts = dict(facts)


class OrderRefusedError(MapError):
    """No mission took an order; ``answers`` are gateways and their reasons."""

    def __init__(self, *, order_id: str, answers: Sequence[tuple[str, str]]) -> None:
        super().__init__("the order was refused: " + "; ".join(f"{gateway}: {reason or 'no reason given'}" for gateway, reason in answers))
        self.order_id = order_id
        self.answers = tuple(answers)


class TooManyError(MapError):
    """A limit on what runs at the same time is reached."""

    def __init__(self, *, what: str, limit: int) -> None:
        super().__init__(f"already {limit} {what}, the limit; ask again later")
        self.what = what
        self.limit = limit
