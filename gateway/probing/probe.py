"""Tries a port at one speed after the other until something answers that can be told."""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

from firmware_protocol.dialects.can import DEFAULT_UNIT
from gateway.errors import TransportError, TransportOpenError
from gateway.probing import findings
from gateway.probing.asking import Identity, Pace, ask_host, ask_transparent_xbee, ask_xbee, ask_znp, exchange
from gateway.probing.findings import Finding, Verdict
from gateway.probing.recognition import (
    CAN_VERSION,
    LAST_TESTS,
    LEAVE_BOOT_LOADER,
    RESET_ROM_BOOT_LOADER,
    TEST_FRAMES,
    Family,
    is_can_adapter,
    is_rom_acknowledgement,
    recognise,
)
from gateway.transports.can_spec import CanSpec
from gateway.transports.interface import Transport
from gateway.transports.serial_port import SerialTransport, settings_kept
from gateway.transports.spec import SerialSpec, TcpSpec, open_transport, parse_port_spec

BAUDS = (115_200, 9_600, 57_600, 38_400, 230_400)
"""In this order: what most dongles have, what an XBee has from the factory, and the rest."""

_BOOT_LOADER_BAUD = 115_200
_CAN_BITRATE = 500_000
_LINES_S = 0.15
_LINES = ((False, False), (False, True), (False, False))
"""DTR and RTS, one after the other, that restart CC2652 boards whose boot loader pin and reset hang on them."""

_SHOWN = 24

_ASK: dict[Family, Callable[[Transport, Pace], Coroutine[Any, Any, Identity]]] = {
    Family.NATIVE: lambda transport, pace: ask_host(transport, pace, dialect="native"),
    Family.XBEE: ask_xbee,
    Family.ZNP: ask_znp,
}
_STUCK = {
    Family.CC253X_BOOT_LOADER: findings.CC253X_STUCK,
    Family.CC26X2_BOOT_LOADER: findings.CC26X2_STUCK,
    Family.MENU_BOOT_LOADER: findings.MENU_STUCK,
}


async def probe_port(
    port: str, *, is_intrusive: bool = False, pace: Pace | None = None, on_try: Callable[[str], None] = lambda _: None
) -> Finding:
    """Tell what is at a port, named by a device's path or as ``--port`` has it; with ``baud=`` only that speed is tried.

    The port's settings are as they were when this returns. Opening a port asserts DTR and RTS, as every program does that opens one;
    nothing else is done with them unless ``is_intrusive``. ``on_try`` is told what is tried, before it is.

    Raises
    ------
    TransportSpecError
        The name means nothing.
    """
    pace = pace or Pace()
    spec = parse_port_spec(port if ":" in port else f"serial:{port}")
    try:
        if isinstance(spec, SerialSpec):
            with settings_kept(spec.path):
                return await _probe_serial(port, spec, pace, is_intrusive=is_intrusive, on_try=on_try)
        on_try(port)
        if isinstance(spec, CanSpec):
            return await _probe_bus(port, spec, pace)
        return await _probe_tcp(port, spec, pace)
    except TransportOpenError as error:
        return Finding(port=port, verdict=Verdict.NOT_OPENED, advice=error.reason)
    except TransportError as error:
        return Finding(port=port, verdict=Verdict.SILENT, advice=f"it went away while it was asked: {error}")


async def _probe_serial(port: str, spec: SerialSpec, pace: Pace, *, is_intrusive: bool, on_try: Callable[[str], None]) -> Finding:
    bauds = (spec.baud,) if "baud=" in port else BAUDS
    heard = b""
    doubt = ""
    for number, baud in enumerate(bauds):
        on_try(f"{port} at {baud} baud ({number + 1} of {len(bauds)})")
        transport = await open_transport(replace(spec, baud=baud))
        try:
            if is_intrusive and number == 0:
                await _toggle_lines(transport, pace)
            family, said = await _find(transport, pace, baud=baud, is_intrusive=is_intrusive)
            heard = heard or said
            if family is Family.SLCAN:
                return _can_adapter(port, spec.path)
            if family is not None:
                finding = await _tell(transport, family, pace, port=port, base=f"serial:{spec.path}?baud={baud}&dialect=", baud=baud)
                if finding.verdict is not Verdict.SILENT:
                    return finding
                doubt = doubt or finding.advice
            elif is_intrusive and (identity := await ask_transparent_xbee(transport, pace)) is not None:
                return Finding(
                    port=port,
                    verdict=Verdict.ANSWERS,
                    family=Family.XBEE.value,
                    baud=baud,
                    firmware=identity.firmware,
                    facts=identity.facts,
                    spec=f"serial:{spec.path}?baud={baud}&dialect=xbee",
                    advice=findings.XBEE_TRANSPARENT,
                )
        finally:
            await transport.aclose()
    return _silent(port, heard, doubt=doubt, is_intrusive=is_intrusive)


async def _probe_tcp(port: str, spec: TcpSpec, pace: Pace) -> Finding:
    transport = await open_transport(spec)
    try:
        family, heard = await _find(transport, pace, baud=_BOOT_LOADER_BAUD, is_intrusive=False)
        if family is not None and family is not Family.SLCAN:
            return await _tell(transport, family, pace, port=port, base=f"{spec.name}?dialect=", baud=None)
        return _silent(port, heard)
    finally:
        await transport.aclose()


def _can_adapter(port: str, path: str) -> Finding:
    spec = f"can:slcan:{path}?unit={DEFAULT_UNIT}&bitrate={_CAN_BITRATE}"
    return Finding(port=port, verdict=Verdict.ANSWERS, family=Family.SLCAN.value, spec=spec, advice=findings.CAN_ADAPTER)


async def _probe_bus(port: str, spec: CanSpec, pace: Pace) -> Finding:
    """Ask on a CAN bus as the gateway would: neither dialect nor speed is a question there."""
    transport = await open_transport(spec)
    try:
        identity = await ask_host(transport, pace, dialect=spec.dialect)
    finally:
        await transport.aclose()
    if not identity.facts:
        return Finding(port=port, verdict=Verdict.SILENT, advice=f"no coordinator answered in dialect {spec.dialect}")
    return Finding(port=port, verdict=Verdict.ANSWERS, family=spec.dialect, firmware=identity.firmware, facts=identity.facts, spec=port)


async def _find(transport: Transport, pace: Pace, *, baud: int, is_intrusive: bool) -> tuple[Family | None, bytes]:
    """Return the family that answers, and all that was heard."""
    family, heard = await _test(transport, pace)
    if family is Family.CC253X_BOOT_LOADER or (family is None and baud == _BOOT_LOADER_BAUD):
        # Some boot loaders do not even answer their handshake; all know this byte, and nothing else does.
        said = await exchange(transport, LEAVE_BOOT_LOADER, is_enough=lambda data: recognise(data) is not None, wait_s=pace.boot_s)
        again, more = await _test(transport, pace)
        family, heard = again or family, heard + said + more
    if family is not None:
        return family, heard
    for test in LAST_TESTS:
        said = await exchange(transport, test, is_enough=lambda data: recognise(data) is not None, wait_s=pace.answer_s)
        heard += said
        if (family := recognise(said)) is not None:
            return family, heard
        if is_rom_acknowledgement(said):
            return await _leave_rom(transport, pace, is_intrusive=is_intrusive), heard
    said = await exchange(transport, CAN_VERSION, is_enough=lambda data: b"\r" in data[-1:], wait_s=pace.answer_s)
    return Family.SLCAN if is_can_adapter(said) else None, heard + said


async def _leave_rom(transport: Transport, pace: Pace, *, is_intrusive: bool) -> Family:
    if is_intrusive:
        await exchange(transport, RESET_ROM_BOOT_LOADER, is_enough=lambda data: recognise(data) is not None, wait_s=pace.boot_s)
        family, _ = await _test(transport, pace)
        if family is not None:
            return family
    return Family.CC26X2_BOOT_LOADER


async def _test(transport: Transport, pace: Pace) -> tuple[Family | None, bytes]:
    heard = await exchange(transport, TEST_FRAMES, is_enough=lambda data: recognise(data) is not None, wait_s=pace.answer_s)
    return recognise(heard), heard


async def _tell(transport: Transport, family: Family, pace: Pace, *, port: str, base: str, baud: int | None) -> Finding:
    if family in _STUCK:
        return Finding(port=port, verdict=Verdict.BOOT_LOADER, family=family.value, baud=baud, advice=_STUCK[family])
    if family is Family.EZSP:
        return Finding(port=port, verdict=Verdict.UNSUPPORTED, family=family.value, baud=baud, advice=findings.EZSP_UNSUPPORTED)
    identity = await _ASK[family](transport, pace)
    if not identity.firmware and not identity.facts:
        # A dongle tells at least one of them; what does not is something else, whatever its bytes looked like.
        advice = f"something that looks like {family.value} spoke{f' at {baud} baud' if baud else ''}, but did not tell who it is: "
        return Finding(port=port, verdict=Verdict.SILENT, advice=advice + findings.NOT_TOLD)
    return Finding(
        port=port,
        verdict=Verdict.ANSWERS,
        family=family.value,
        baud=baud,
        firmware=identity.firmware,
        facts=identity.facts,
        spec=base + family.value,
        advice=identity.advice,
    )


async def _toggle_lines(transport: Transport, pace: Pace) -> None:
    if isinstance(transport, SerialTransport):
        for dtr, rts in _LINES:
            if not transport.set_lines(dtr=dtr, rts=rts):
                return
            await asyncio.sleep(_LINES_S)
        await exchange(transport, b"", is_enough=lambda _: False, wait_s=pace.answer_s)


def _silent(port: str, heard: bytes, *, doubt: str = "", is_intrusive: bool = False) -> Finding:
    advice = findings.NOBODY
    if doubt:
        return Finding(port=port, verdict=Verdict.SILENT, advice=doubt)
    if TEST_FRAMES in heard:
        advice = findings.ECHO
    elif heard:
        beginning = heard[:_SHOWN].hex(" ")
        advice = f"{len(heard)} bytes came that no dialect explains, beginning {beginning}: {findings.NOT_EXPLAINED}"
        advice += "" if is_intrusive else findings.PERHAPS_TRANSPARENT
    return Finding(port=port, verdict=Verdict.SILENT, advice=advice)
