"""``biobot-gateway check-radio``: the acceptance check of whatever is plugged in."""

import argparse
import asyncio
import json
from dataclasses import asdict

from firmware_protocol.dialects.choice import DIALECTS
from firmware_protocol.errors import ConfigurationError
from firmware_protocol.units import NodeId
from gateway.acceptance.check_radio import check_radio
from gateway.acceptance.plan import Plan
from gateway.acceptance.results import Outcome, Result
from gateway.commands.outcome import DONE, FAILED, complain
from gateway.transports.spec import PortSpec, parse_port_spec

_MARKS = {Outcome.PASSED: "pass", Outcome.FAILED: "FAIL", Outcome.SKIPPED: "skip"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of ``check-radio``."""
    parser.add_argument("port", metavar="PORT", help="a device's path, or as --port of `run` has it")
    parser.add_argument("--dialect", choices=DIALECTS, help="what it speaks (default: as the port says, or native)")
    parser.add_argument("--node", type=int, metavar="N", help="the biobot to talk to (default: one that answers)")
    parser.add_argument("--stimulate", action="store_true", help="also start and stop that biobot: a living animal, past gate and journal")
    parser.add_argument("--soak-s", type=float, default=0.0, metavar="S", help="at last ask all for their time for so long")
    parser.add_argument("--json", action="store_true", help="the report as JSON")


def check(options: argparse.Namespace) -> int:
    """Check a radio and print a verdict for each capability; done only where all that is required passes."""
    text = options.port if ":" in options.port else f"serial:{options.port}"
    if options.dialect is not None and "dialect=" not in text:
        text += f"{'&' if '?' in text else '?'}dialect={options.dialect}"
    spec = parse_port_spec(text)
    if options.stimulate and options.node is None:
        raise ConfigurationError(["check-radio: --stimulate needs --node N: which biobot is to be stimulated"])
    if not 0 <= options.soak_s <= 86_400:
        raise ConfigurationError([f"check-radio: --soak-s is {options.soak_s:g}, but must be 0 to 86400"])
    node = None if options.node is None else NodeId(options.node)
    plan = Plan(node=node, stimulates=options.stimulate, soak_s=options.soak_s)

    results: list[Result] = []

    def on_result(result: Result) -> None:
        results.append(result)
        if not options.json:
            figures = ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in result.figures.items())
            told = "; ".join(part for part in (result.detail, figures) if part)
            print(f"{_MARKS[result.outcome]}  {result.name}{': ' if told else ''}{told}", flush=True)

    try:
        report = asyncio.run(check_radio(spec, plan, on_result=on_result))
    except KeyboardInterrupt:
        if options.json:
            _print_json(text, spec, results, is_passed=False)
        return complain(f"interrupted after {len(results)} checks; what is not told was not tried", status=FAILED)
    if options.json:
        _print_json(text, spec, results, is_passed=report.is_passed)
    else:
        n_untried = sum(one.outcome is Outcome.SKIPPED and one.is_required for one in report.results)
        untried = f", {n_untried} could not be tried" if n_untried else ""
        print("all that is required passed" if report.is_passed else f"not passed: {report.n_failed} failed{untried}")
    return DONE if report.is_passed else FAILED


def _print_json(port: str, spec: PortSpec, results: list[Result], *, is_passed: bool) -> None:
    told = [asdict(result) | {"outcome": result.outcome.value} for result in results]
    print(json.dumps({"port": port, "dialect": spec.dialect, "is_passed": is_passed, "results": told}, indent=2))
