"""What a campaign's rounds showed, as one table for people."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from statistics import median
from typing import Any

from studies.campaign.plan import Kind


def write_table(rounds: Sequence[dict[str, Any]]) -> str:
    """Return the table in Markdown."""
    account = {name: sum(one["account"][name] for one in rounds) for name in rounds[0]["account"] if name.startswith("n_")}
    seconds = sum(one["seconds"] for one in rounds)
    worst = {name: max(one["account"][name] for one in rounds) / 1e6 for name in ("worst_error_ns", "worst_bound_ns")}
    levels = ", ".join(f"{name} {watermark:,} of {head:,}" for one in rounds for name, (head, watermark) in sorted(one["levels"].items()))
    lines = [
        *_fault_lines(rounds),
        "",
        "| account | |",
        "|---|---|",
        f"| reports of encounters by backpacks (of them while it went on) | {account['n_entries']:,} ({account['n_ongoing']:,}) |",
        f"| encounters that these make (of them told by both sides) | {account['n_encounters']:,} ({account['n_reciprocal']:,}) |",
        f"| encounters in the mapper's store (void records besides) | {account['n_records']:,} ({account['n_void']:,}) |",
        f"| lost / duplicated / altered / reported by nobody / in doubt | {_five(account, '', 'n_doubtful')} |",
        f"| modes told / stored | {account['n_modes']:,} / {account['n_mode_records']:,} |",
        f"| modes lost / duplicated / altered / told by nobody | {_five(account, 'modes_')} |",
        f"| largest error of a time; largest bound of one [ms] | {worst['worst_error_ns']:.0f}; {worst['worst_bound_ns']:.0f} |",
        f"| sides not sensed by backpacks with too much to tell | {_sum(rounds, 'left_out'):,} |",
        f"| encounters that backpacks had no room for, and never told | {_sum(rounds, 'dropped'):,} |",
        f"| watermark of the journal's head | {levels} |",
        f"| time [s]; encounters a second | {seconds:,.0f}; {account['n_encounters'] / seconds:,.0f} |",
        f"| peak of memory [MiB] | {_largest(rounds, 'peak_rss', 1 << 20)} |",
        f"| ended by itself; did not end when told to | {_largest(rounds, 'ended_by_itself', 1)}; {_largest(rounds, 'hung', 1)} |",
    ]
    impossible = {what: why for one in rounds for what, why in one["impossible"].items()}
    lines += [f"| not possible on this machine: {what} | {why} |" for what, why in impossible.items()]
    lines += ["", "Warnings and errors that services logged: " + "; ".join(_said(rounds))]
    lines += ["", *(f"- {example}" for one in rounds for example in one["account"]["examples"])]
    verdict = "Everything that was reported is in the store, once, as it was." if is_sound(rounds) else "NOT SOUND: see above."
    return "\n".join([*lines, "", verdict, ""])


def is_sound(rounds: Sequence[dict[str, Any]]) -> bool:
    """Whether no round lost, doubled or altered anything, and all came to rest."""
    return all(one["is_sound"] for one in rounds)


def _fault_lines(rounds: Sequence[dict[str, Any]]) -> list[str]:
    recoveries: dict[str, list[float]] = defaultdict(list)
    counts: Counter[str] = Counter()
    late: Counter[str] = Counter()
    n_void = 0
    for one in rounds:
        for kind, recovery_s, is_late, is_void in one["outcomes"]:
            n_void += is_void
            counts[kind] += not is_void
            late[kind] += is_late
            if recovery_s is not None:
                recoveries[kind].append(recovery_s)
    lines = ["| fault | n | recovery min | median | max [s] | not within 120 s |", "|---|---|---|---|---|---|"]
    for kind in Kind:
        if counts[kind.name]:
            found = recoveries[kind.name]
            times = f"{min(found):.2f} | {median(found):.2f} | {max(found):.2f}" if found else "- | - | -"
            lines.append(f"| {kind.value} | {counts[kind.name]} | {times} | {late[kind.name]} |")
    lines.append(f"| all | {sum(counts.values())} | | | | {sum(late.values())} |")
    return [*lines, "", f"Planned and not done, for no backpack came to rest in time: {n_void}."] if n_void else lines


def _five(account: dict[str, int], of: str, *others: str) -> str:
    names = [f"n_{of}{what}" for what in ("lost", "duplicated", "altered", "unreported")]
    return " / ".join(f"{account[name]:,}" for name in (*names, *others))


def _sum(rounds: Sequence[dict[str, Any]], name: str) -> int:
    return sum(int(one[name]) for one in rounds)


def _largest(rounds: Sequence[dict[str, Any]], name: str, unit: int) -> str:
    largest: dict[str, int] = {}
    for one in rounds:
        for who, value in one[name].items():
            largest[who] = max(largest.get(who, 0), value)
    return ", ".join(f"{who} {value // unit}" for who, value in largest.items())


def _said(rounds: Sequence[dict[str, Any]]) -> list[str]:
    said: dict[str, Counter[str]] = defaultdict(Counter)
    for one in rounds:
        for who, counts in one["said"].items():
            said[who].update(counts)
    return [f"{who}: " + (", ".join(f"{event} {n}" for event, n in counts.most_common(8)) or "none") for who, counts in said.items()]
