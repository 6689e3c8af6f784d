"""A refusal: for programs, and in words. Pure."""

from dataclasses import dataclass

from firmware_protocol.contract.commands import Refusal


@dataclass(frozen=True, slots=True, kw_only=True)
class Refused:
    """Why a command is not admitted. ``reason`` names the value, the limit and the next step."""

    refusal: Refusal
    reason: str
