"""How long the mapper takes to judge the clocks of many gateways: ``python -m studies.sites.clock_costs`` (docs/scaling.md; a minute).

Every gateway has told of as many encounters as are looked at of one start, and has news each time. In a row each shares a fifth of them
with the next one; where all mix, each encounter is of a pair that every gateway has heard of.
"""

import argparse
import sys
import time

import numpy as np

from mapper.clock_samples import MAX_SAMPLE, SampledRows, number_pairs
from mapper.gateway_clocks import GatewayClocks, Source
from mapper.types import IntArray

_NS_PER_S = 1_000_000_000
_HOUR_NS = 3600 * _NS_PER_S
_BIOBOTS_EACH = 150
_SHARE = 5
_NEWS = 50


def make_rows(*, n_gateways: int, is_mixed: bool, seed: int) -> SampledRows:
    """Return what gateways told within an hour; `MAX_SAMPLE` rows of each, at least."""
    draws = np.random.default_rng(seed)
    columns: list[tuple[IntArray, IntArray, IntArray, IntArray]] = []
    for gateway in range(n_gateways):
        first = 0 if is_mixed else gateway * _BIOBOTS_EACH
        low, high = np.sort(draws.integers(first, first + _BIOBOTS_EACH, (2, MAX_SAMPLE)), axis=0)
        middle = draws.integers(0, _HOUR_NS, MAX_SAMPLE)
        length = draws.integers(_NS_PER_S, 10 * _NS_PER_S, MAX_SAMPLE)
        pair = number_pairs(low, high)
        columns.append((np.full(MAX_SAMPLE, gateway), pair, middle, length))
        if gateway + 1 < n_gateways:
            shared = slice(0, MAX_SAMPLE // _SHARE)
            columns.append((np.full(MAX_SAMPLE // _SHARE, gateway + 1), pair[shared], middle[shared], length[shared]))
    source, pair, middle, length = (np.concatenate(one) for one in zip(*columns, strict=True))
    return SampledRows(source=source, pair=pair, middle_ns=middle, length_ns=length, is_usable=np.ones(len(source), dtype=np.bool_))


def measure(facts: SampledRows, *, n_gateways: int) -> tuple[float, int]:
    """Return the processor time of judging all clocks when every gateway has news [s], and of how many gateways a clock is known."""
    clocks = GatewayClocks()
    for gateway in range(n_gateways):
        clocks.number(Source(gateway=f"base{gateway:03d}", anchor_ns=gateway))

    def read(rows: IntArray) -> SampledRows:
        names = ("source", "pair", "middle_ns", "length_ns", "is_usable")
        return SampledRows(**{name: getattr(facts, name)[rows] for name in names})

    clocks.note(np.arange(len(facts.source)), sources=facts.source, pairs=facts.pair)
    clocks.settle(read)
    for gateway in range(n_gateways):
        news = np.flatnonzero(facts.source == gateway)[:_NEWS]
        clocks.note(news, sources=facts.source[news], pairs=facts.pair[news])
    begun_s = time.process_time()
    clocks.settle(read)
    return time.process_time() - begun_s, sum(clock.offset_ns is not None for clock in clocks.report())


def main(arguments: list[str] | None = None) -> int:
    """Print a row for each number of gateways."""
    parser = argparse.ArgumentParser(prog="python -m studies.sites.clock_costs", description=__doc__)
    parser.add_argument("--gateways", type=int, nargs="+", default=[2, 3, 10, 25, 50], metavar="N", help="(default: 2 3 10 25 50)")
    options = parser.parse_args(arguments)
    sys.stdout.write("| gateways | in a row [ms] | known | where all mix [ms] | known |\n|---|---|---|---|---|\n")
    for n_gateways in options.gateways:
        found = [measure(make_rows(n_gateways=n_gateways, is_mixed=mixed, seed=1), n_gateways=n_gateways) for mixed in (False, True)]
        cells = " | ".join(f"{1e3 * took_s:.0f} | {n_known}" for took_s, n_known in found)
        sys.stdout.write(f"| {n_gateways} | {cells} |\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
