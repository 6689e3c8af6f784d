"""What is said to a backpack: commands as messages on the wire. Pure."""

from firmware_protocol.contract.commands import StimulationAction
from firmware_protocol.messages import Action, Stimulate
from gateway.stimulation.commands import Command
from gateway.stimulation.pulses import WAVEFORMS, Pulse

MAX_QUEUED_MS = 1_000
"""So long a command may wait in its backpack for a train that runs, and no longer: of the gateway's own trains none runs then, for the
pause between two is kept, so what it would wait for is another's."""

_MAX_TTL_MS = 0xFFFF

_ACTIONS = {
    StimulationAction.START: Action.START,
    StimulationAction.STOP: Action.STOP,
    StimulationAction.STOP_ALL: Action.STOP,
    StimulationAction.TURN_LEFT: Action.TURN_LEFT,
    StimulationAction.TURN_RIGHT: Action.TURN_RIGHT,
    StimulationAction.FOLLOW_WALLS: Action.FOLLOW_WALLS,
}


def stimulus(command: Command, pulse: Pulse, *, ttl_ms: int) -> Stimulate:
    """Return the message of a start or a turn that has ``ttl_ms`` left."""
    return _message(command, pulse, duration_ms=pulse.duration_ms, ttl_ms=min(ttl_ms, MAX_QUEUED_MS))


def stop(command: Command, pulse: Pulse, *, has_train: bool) -> Stimulate:
    """Return the message of a stop; without a train the backpack makes the insect stand all the same (WIRE_FORMAT.md §6.8)."""
    return _message(command, pulse, duration_ms=pulse.duration_ms if has_train else 0, ttl_ms=_MAX_TTL_MS)


def _message(command: Command, pulse: Pulse, *, duration_ms: int, ttl_ms: int) -> Stimulate:
    assert command.wire_command is not None
    return Stimulate(
        command=command.wire_command,
        action=_ACTIONS[command.request.action],
        ttl_ms=ttl_ms,
        hold_ms=command.request.hold_ms,
        frequency_hz=pulse.frequency_hz,
        pulse_width_us=pulse.pulse_width_us,
        amplitude_mv=pulse.amplitude_mv,
        duration_ms=duration_ms,
        channel=pulse.channel,
        waveform=WAVEFORMS[pulse.waveform],
    )
