"""``biobot-sim scenarios``: what scenarios and presets there are."""

import json
import math
from dataclasses import asdict

from simulator.arenas.scenarios import SCENARIOS
from simulator.presets import DEFAULT_PRESET, PRESETS
from simulator.radios.radio import RADIO_PRESETS


def list_scenarios(*, as_json: bool) -> str:
    """List all scenarios and presets, as tables or as JSON with the source of every value."""
    side = PRESETS[DEFAULT_PRESET].side
    built = {name: scenario.build(side) for name, scenario in SCENARIOS.items()}
    later = {name: scenario.build_changes(side) for name, scenario in SCENARIOS.items()}
    if as_json:
        scenarios = [
            {
                "name": name,
                "summary": SCENARIOS[name].summary,
                "betti_numbers": [arena.betti.components, arena.betti.holes],
                "free_area_share": arena.area / side**2,
                "depends_on_seed": SCENARIOS[name].is_random,
                "changes": [
                    {"share_of_time": share, "betti_numbers_after": [after.betti.components, after.betti.holes]}
                    for share, after in later[name]
                ],
            }
            for name, arena in built.items()
        ]
        presets = [
            {
                "name": preset.name,
                "summary": preset.summary,
                "default": preset.name == DEFAULT_PRESET,
                "unit_of_length": preset.unit,
                "values": {
                    "side": preset.side,
                    **asdict(preset.motion),
                    "detection": preset.ranges.detection,
                    "communication": preset.ranges.communication,
                    "biobots": preset.biobots,
                    "landmarks": preset.landmarks,
                    "duration_s": preset.duration_s,
                    "dispersion_s": preset.dispersion_s,
                },
                "sources": dict(preset.sources),
            }
            for preset in PRESETS.values()
        ]
        radios = [
            {"name": radio.name, "summary": radio.summary, "values": _finite(asdict(radio.config)), "sources": dict(radio.sources)}
            for radio in RADIO_PRESETS.values()
        ]
        return json.dumps({"scenarios": scenarios, "presets": presets, "radio_presets": radios}, indent=2)
    lines = [f"{'scenario':<16}{'components':>11}{'holes':>7}  what it is"]
    for name, arena in built.items():
        note = " (counted with seed 0)" if SCENARIOS[name].is_random else ""
        lines.append(f"{name:<16}{arena.betti.components:>11}{arena.betti.holes:>7}  {SCENARIOS[name].summary}{note}")
        lines += [f"{f'  after {share:.0%}':<16}{after.betti.components:>11}{after.betti.holes:>7}" for share, after in later[name]]
    columns = f"{'side':>6}{'v_m':>8}{'l*':>8}{'r_d':>6}{'r_c':>6}{'biobots':>9}{'landmarks':>11}{'T [s]':>7}"
    lines.append(f"\n{'preset':<13}{'unit':>5}{columns}  what it is")
    lines += [
        f"{preset.name:<13}{preset.unit:>5}{preset.side:>6g}{preset.motion.speed:>8g}{preset.motion.mean_leg:>8g}"
        f"{preset.ranges.detection:>6g}{preset.ranges.communication:>6g}{preset.biobots:>9}{preset.landmarks:>11}"
        f"{preset.duration_s:>7g}  {preset.summary}{' (default)' if preset.name == DEFAULT_PRESET else ''}"
        for preset in PRESETS.values()
    ]
    lines += ["\nradio preset  what it is", *(f"{radio.name:<14}{radio.summary}" for radio in RADIO_PRESETS.values())]
    return "\n".join(lines)


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    """Write a limit that is not there as null: JSON has no infinity."""
    return {name: value if math.isfinite(value) else None for name, value in values.items()}
