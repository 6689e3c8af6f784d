"""What a yard is told when it starts."""

import msgspec

from studies.campaign.meetings import Meetings, Pace


class YardConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One gateway's part of a site: its dongles, and the biobots that belong to them.

    Attributes
    ----------
    lines
        What each dongle is behind, as ``biobot-sim serve --link`` takes it.
    dongles_before, n_dongles
        Dongles are counted over all yards: how many come before ours, and how many there are.
    t0_ns
        When the run begins, on the machine's monotonic clock; all yards are given the same.
    mode_period_s
        How often a biobot changes its mode, about.
    """

    seed: int
    rate: float
    n_biobots: int
    lines: tuple[str, ...]
    dongles_before: int
    n_dongles: int
    t0_ns: int
    is_quick: bool
    directory: str
    loss: float = 0.02
    drift_ppm: float = 40.0
    mode_period_s: float = 30.0

    def meetings(self, pace: Pace) -> Meetings:
        """Return the schedule of all yards."""
        return Meetings(seed=self.seed, n_biobots=self.n_biobots, rate=self.rate, pace=pace)
