"""Many histories, in batches that each follow from a number: what happened in them, and the shortest history that broke a law."""

import contextlib
import io
import logging
from collections import Counter
from collections.abc import Iterator

import msgspec
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis.stateful import run_state_machine_as_test

from firmware_protocol.messages import Action
from studies.cases import Study
from studies.gate_histories.machine import GateHistory
from studies.gate_histories.world import World

_STEPS = 25
"""Rules that a history is made of, at most; one of them may be a dozen commands."""


class Batch(msgspec.Struct, frozen=True, kw_only=True):
    """Some histories; the same number gives the same ones."""

    number: int
    n_histories: int


class BatchResult(msgspec.Struct, frozen=True, kw_only=True):
    """What happened in a batch, by name; ``broken`` is the shortest history found that broke a law, and how, empty: none did."""

    counts: dict[str, int]
    broken: str = ""


def run_batch(batch: Batch) -> BatchResult:
    """Run the histories of a batch, and judge each; the first that breaks a law is shrunk, and ends the batch."""
    counts: Counter[str] = Counter()
    is_shrinking = False

    def report(world: World, found: list[str]) -> None:
        nonlocal is_shrinking
        if not is_shrinking:
            counts.update(_count(world))
        is_shrinking = is_shrinking or bool(found)

    class Reporting(GateHistory):
        def __init__(self) -> None:
            super().__init__(report)

    seed(batch.number)(Reporting)
    how = settings(
        max_examples=batch.n_histories,
        stateful_step_count=_STEPS,
        database=None,
        deadline=None,
        derandomize=False,
        print_blob=False,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    with contextlib.redirect_stdout(io.StringIO()) as told, _quiet():
        try:
            run_state_machine_as_test(Reporting, settings=how)
        except AssertionError as error:
            return BatchResult(counts=counts, broken="\n".join((told.getvalue(), *getattr(error, "__notes__", ()), str(error))).strip())
    return BatchResult(counts=counts)


STUDY = Study(name="gate histories", compute=run_batch, result_type=BatchResult)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Log nothing: a full disk and a dead radio are everyday here."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def _count(world: World) -> Counter[str]:
    counts = Counter(world.counts)
    counts["histories"] += 1
    counts["lives of the gateway"] += len(world.lives)
    counts["frames"] += len(world.air.frames)
    counts["frames that arrived"] += sum(bool(frame.landed_ns) for frame in world.air.frames)
    counts["walks along walls"] += sum(one.action is Action.FOLLOW_WALLS for biobot in world.biobots.values() for one in biobot.log)
    counts["trains at an electrode"] += sum(one.train is not None for biobot in world.biobots.values() for one in biobot.log)
    counts.update(f"outcome: {call.last.stage.value}" for call in world.calls if call.last is not None)
    return counts
