"""What a run showed, as Markdown for people."""

from collections import Counter

from studies.sites.run import Findings


def write_table(found: Findings) -> str:
    """Return the tables."""
    lines = ["| fault | lasted [s] | cut off from their mapper | seen again [s] | store complete [s] |", "|---|---|---|---|---|"]
    for one in found.outcomes:
        who = ", ".join(one.cut_off) or "nobody"
        lines.append(f"| {one.name} | {one.lasts_s:g} | {who} | {one.seen_after_s:.1f} | {one.level_after_s:.1f} |")
    lines += [
        "",
        "| site | true encounters | reports | encounters that count | missing | doubled or forged | dated wrong |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, ledger in found.ledgers.items():
        numbers = (ledger.n_encounters, ledger.n_reports, ledger.n_records, len(ledger.missing), len(ledger.doubled), len(ledger.misdated))
        lines.append(f"| {name} | " + " | ".join(f"{number:,}" for number in numbers) + " |")
    lines += ["", f"{found.n_joint:,} encounters were recorded by two gateways; {found.n_wanderers} biobots were at two gateways or more."]
    lines += ["", "| order | link | answered at first | in the end | n |", "|---|---|---|---|---|"]
    orders = Counter(
        (one.action, "cut" if one.is_cut else "healed", one.first or "under way", one.last or "no end") for one in found.orders
    )
    lines += [f"| {' | '.join(row)} | {count} |" for row, count in sorted(orders.items())]
    lines += ["", "| stranger | connected | answers, questions, keys heard |", "|---|---|---|"]
    for told in sorted(found.strangers, key=lambda one: str(one["name"])):
        if told["is_connected"]:
            lines.append(f"| {told['name']} | yes | {told['n_answers']}, {len(told['asked'])}, {len(told['heard'])} |")
        else:
            lines.append(f"| {told['name']} | no: {told['reason'].partition(': ')[2]} | |")
    lines += ["", "| process | CPU [s] | peak of memory [MB] |", "|---|---|---|"]
    lines += [f"| {name} | {cpu_s:.1f} | {found.peak_rss[name] / 1e6:.0f} |" for name, cpu_s in found.cpu_s.items()]
    if found.n_ended:
        lines += ["", "Ended by itself, and started again: " + ", ".join(f"{name} {n} times" for name, n in found.n_ended.items()) + "."]
    lines += ["", "| cable | MB carried |", "|---|---|"]
    lines += [f"| {cable} | {n_bytes / 1e6:.2f} |" for cable, n_bytes in found.carried.items()]
    lines += ["", f"{found.seconds:.0f} s in all.", "", *(f"- {problem}" for problem in found.problems)]
    return "\n".join([*lines, "", "NOT SOUND: see above." if found.problems else "Sound.", ""])
