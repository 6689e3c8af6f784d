"""How a Z-Stack dongle in an unknown state becomes a coordinator with a network (WIRE_FORMAT.md §9.4): steps and their order, no more.

The opening is a generator. It yields what is to be done next and is sent what came of it; ``znp.ZnpHost`` does it. A network that is there
is kept, whoever formed it; one is formed only where there is none.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

from firmware_protocol.dialects.interface import LostWhy
from firmware_protocol.envelope import CoordinatorHello
from firmware_protocol.framing.znp import encode_frame
from firmware_protocol.messages import MAX_RADIO_PAYLOAD
from firmware_protocol.units import NS_PER_MS, NS_PER_S
from firmware_protocol.znp import frames as znp
from firmware_protocol.znp.codec import command_of, encode_command
from firmware_protocol.znp.frames import Reply, Report, Request
from firmware_protocol.znp.numbers import (
    BDB_FORMATION,
    BIOBOT_CLUSTER,
    BIOBOT_ENDPOINT,
    BIOBOT_PROFILE,
    CLEAR_CONFIG,
    CLEAR_STATE,
    COORDINATOR_TYPE,
    HOST_CONFIGURED_VALUE,
    Command,
    DeviceState,
    NvItem,
    ZnpStatus,
)

_ZSTACK_1_2 = 0
_PRODUCTS = {_ZSTACK_1_2: "Z-Stack 1.2", 1: "Z-Stack 3.x.0", 2: "Z-Stack 3.0.x"}

_SKIP_BYTE = b"\xef"
"""Lets the serial boot loader of a CC2530 or CC2531 start the application [TI, Serial Boot Loader for CC253x]; no frame begins with it."""
_FLUSH = _SKIP_BYTE * 256
"""Fills up whatever frame the dongle thinks has begun: it has no timer of its own for that."""

_WAKING_NS = 500 * NS_PER_MS
_BOOTING_NS = 1_000 * NS_PER_MS
_RESET_LOOKS = 5
"""How often a reset is looked for, ``_LOOK_NS`` each: a chip that clears its memory takes some seconds."""
_LOOK_NS = 2 * NS_PER_S
_FORMING_LOOKS = 30
"""How often the state is looked at before forming is given up: a minute; an energy scan of all channels takes some 10 s."""

_ALL_ROUTERS = 0xFFFC
_TO_BROADCAST = 0x0F


_ANY_PAN_ID = 0xFFFF
_DEFAULT_CHANNEL = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class ZnpHostConfig:
    """What network to form where there is none, and who may join.

    Parameters
    ----------
    pan_id
        None: the dongle chooses.
    channel
        11 to 26; None: 20.
    permit_join_s
        How long nodes may join after each opening [s]; 0 never, 254 for as long as the base station runs.
    check_ns
        How often the dongle is asked whether it still has its network, whatever is heard from it.
    """

    pan_id: int | None = None
    channel: int | None = None
    permit_join_s: int = 254
    check_ns: int = 5 * NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Ask:
    """Send a request and wait for its answer; sent back: the answer, or None where none came."""

    request: Request
    patience_ns: int = 2 * NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Await:
    """Wait for a report of a kind; sent back: the report, or None where none came."""

    kind: type[Report]
    patience_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Write:
    """Put bytes on the line as they are; sent back: None."""

    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Say:
    """Tell the log; sent back: None."""

    level: int
    name: str
    text: str


Step: TypeAlias = Ask | Await | Write | Say
Came: TypeAlias = Reply | Report | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """The dongle is a coordinator with a network, and our endpoint is registered."""

    hello: CoordinatorHello
    description: str


class OpeningEndedError(Exception):
    """The opening cannot go on; raised by the generator, and never leaves ``ZnpHost``."""

    def __init__(self, why: LostWhy, detail: str) -> None:
        super().__init__(detail)
        self.why = why
        self.detail = detail


_AnswerT = TypeVar("_AnswerT")


def open_dongle(config: ZnpHostConfig) -> Generator[Step, Came, Opened]:
    """Yield the steps of an opening; raises ``OpeningEndedError`` where the dongle does not do its part."""
    yield from _wake()
    version = yield from _ask(znp.VersionRequest(), znp.VersionReply)
    info = yield from _ask(znp.DeviceInfoRequest(), znp.DeviceInfoReply)
    product = _PRODUCTS.get(version.product, f"Z-Stack product {version.product}")
    description = f"{product}, {version.major}.{version.minor}.{version.maintenance} build {version.revision}"
    yield Say(level=0, name="answers", text=description)
    if info.state != DeviceState.COORDINATOR:
        is_old = version.product == _ZSTACK_1_2
        if info.state != DeviceState.COORDINATOR_STARTING:
            if (yield from _has_network(is_old=is_old)):
                yield from _ask(znp.StartupRequest(delay_ms=100), znp.StatusReply)
            else:
                yield Say(level=1, name="forming", text="no network is there: one is formed")
                yield from _form(config, is_old=is_old)
        yield from _await_coordinator()
        if is_old:
            yield from _write_item(NvItem.HOST_CONFIGURED, bytes((HOST_CONFIGURED_VALUE,)))
    yield from _register()
    if version.product != _ZSTACK_1_2:
        # Backpacks with Z-Stack 1.2 exchange no keys; a firmware that does not know the command does not ask them to.
        yield Ask(request=znp.RequireKeyExchangeRequest(is_required=0))
    if config.permit_join_s:
        yield Ask(request=permit_join(config.permit_join_s))
    hello = yield from _hello(version, eui64=info.eui64)
    yield from _compare(config, hello)
    return Opened(hello=hello, description=description)


def permit_join(duration_s: int) -> znp.PermitJoinRequest:
    """Return the request that opens the whole network."""
    return znp.PermitJoinRequest(address_mode=_TO_BROADCAST, destination=_ALL_ROUTERS, duration_s=duration_s, trust_center=0)


def _wake() -> Generator[Step, Came, None]:
    """Ping until there is an answer; whoever waits for the opening has a patience of his own."""
    wakener = _SKIP_BYTE
    while not isinstance((yield Ask(request=znp.PingRequest(), patience_ns=_WAKING_NS)), znp.PingReply):
        yield Write(data=wakener)
        yield Await(kind=znp.ResetIndication, patience_ns=_BOOTING_NS)
        wakener = _FLUSH


def _has_network(*, is_old: bool) -> Generator[Step, Came, bool]:
    item, value = (NvItem.HOST_CONFIGURED, HOST_CONFIGURED_VALUE) if is_old else (NvItem.BDB_IS_ON_NETWORK, 1)
    reply = yield from _ask(znp.NvReadRequest(item=item), znp.NvReadReply)
    if reply.status != ZnpStatus.SUCCESS or reply.value[:1] != bytes((value,)):
        return False
    kind = yield from _ask(znp.NvReadRequest(item=NvItem.LOGICAL_TYPE), znp.NvReadReply)
    if kind.status == ZnpStatus.SUCCESS and kind.value[:1] != bytes((COORDINATOR_TYPE,)):
        detail = f"the dongle is of logical type {kind.value[:1].hex()} in somebody's network; erase its memory, or flash a coordinator"
        raise OpeningEndedError(LostWhy.REFUSED, detail)
    callbacks = yield from _ask(znp.NvReadRequest(item=NvItem.ZDO_DIRECT_CB), znp.NvReadReply)
    if callbacks.value != b"\x01":
        yield from _write_item(NvItem.ZDO_DIRECT_CB, b"\x01")
    return True


def _form(config: ZnpHostConfig, *, is_old: bool) -> Generator[Step, Came, None]:
    pan_id = _ANY_PAN_ID if config.pan_id is None else config.pan_id
    channels = 1 << (_DEFAULT_CHANNEL if config.channel is None else config.channel)
    yield from _write_item(NvItem.STARTUP_OPTION, bytes((CLEAR_CONFIG | CLEAR_STATE,)))
    yield Write(data=encode_frame(encode_command(znp.ResetRequest(kind=1))))
    yield from _await_reset()
    yield from _write_item(NvItem.LOGICAL_TYPE, bytes((COORDINATOR_TYPE,)))
    yield from _write_item(NvItem.PANID, pan_id.to_bytes(2, "little"))
    yield from _write_item(NvItem.CHANLIST, channels.to_bytes(4, "little"))
    yield from _write_item(NvItem.ZDO_DIRECT_CB, b"\x01")
    if is_old:
        yield from _ask(znp.StartupRequest(delay_ms=100), znp.StatusReply)
        return
    yield from _ask(znp.SetChannelRequest(is_primary=1, channels=channels), znp.StatusReply)
    yield from _ask(znp.SetChannelRequest(is_primary=0, channels=0), znp.StatusReply)
    started = yield from _ask(znp.CommissioningRequest(mode=BDB_FORMATION), znp.StatusReply)
    if started.status != ZnpStatus.SUCCESS:
        raise OpeningEndedError(LostWhy.REFUSED, f"it does not form a network: status 0x{started.status:02X}")


def _await_reset() -> Generator[Step, Came, None]:
    for _ in range(_RESET_LOOKS):
        if (yield Await(kind=znp.ResetIndication, patience_ns=_LOOK_NS)) is not None:
            return
        yield Say(level=0, name="resetting", text="it clears its memory")
    raise OpeningEndedError(LostWhy.NO_ANSWER, f"it did not come back from a reset within {_RESET_LOOKS * _LOOK_NS // NS_PER_S} s")


def _await_coordinator() -> Generator[Step, Came, None]:
    for _ in range(_FORMING_LOOKS):
        change = yield Await(kind=znp.StateChange, patience_ns=_LOOK_NS)
        if isinstance(change, znp.StateChange):
            state = change.state
        else:  # the report may have been lost
            state = (yield from _ask(znp.DeviceInfoRequest(), znp.DeviceInfoReply)).state
        if state == DeviceState.COORDINATOR:
            return
        yield Say(level=0, name="starting", text=f"state 0x{state:02X}")
    detail = f"it is no coordinator {_FORMING_LOOKS * _LOOK_NS // NS_PER_S} s after it was told to start; unplug it, or erase its memory"
    raise OpeningEndedError(LostWhy.REFUSED, detail)


def _register() -> Generator[Step, Came, None]:
    request = znp.RegisterRequest(
        endpoint=BIOBOT_ENDPOINT, profile=BIOBOT_PROFILE, device=0, device_version=0, latency=0, in_clusters=(BIOBOT_CLUSTER,),
        out_clusters=(BIOBOT_CLUSTER,),
    )  # fmt: skip
    reply = yield from _ask(request, znp.StatusReply)
    if reply.status not in {ZnpStatus.SUCCESS, ZnpStatus.APS_DUPLICATE_ENTRY}:  # it is there since an earlier opening
        raise OpeningEndedError(LostWhy.REFUSED, f"it does not register endpoint 0x{BIOBOT_ENDPOINT:02X}: status 0x{reply.status:02X}")


def _hello(version: znp.VersionReply, *, eui64: int) -> Generator[Step, Came, CoordinatorHello]:
    network = yield from _ask(znp.NetworkInfoRequest(), znp.NetworkInfoReply)
    if network.state != DeviceState.COORDINATOR:
        raise OpeningEndedError(LostWhy.NO_ANSWER, f"it said that it had a network, and has none (state 0x{network.state:02X})")
    return CoordinatorHello(
        firmware=version.major << 8 | version.minor,
        eui64=eui64,
        pan_id=network.pan_id,
        channel=network.channel,
        max_radio_payload=MAX_RADIO_PAYLOAD,
    )


def _compare(config: ZnpHostConfig, hello: CoordinatorHello) -> Generator[Step, Came, None]:
    """Say so where a network that was kept is not the one that was wished for."""
    if config.pan_id not in {None, hello.pan_id} or config.channel not in {None, hello.channel}:
        there = f"PAN 0x{hello.pan_id:04X} on channel {hello.channel}"
        yield Say(level=2, name="other_network", text=f"it keeps its network, {there}; to form another, erase its memory first")


def _write_item(item: NvItem, value: bytes) -> Generator[Step, Came, None]:
    """Write an item, and make it first where it is not there."""
    yield from _ask(znp.NvInitRequest(item=item, length=len(value), value=value), znp.StatusReply)
    reply = yield from _ask(znp.NvWriteRequest(item=item, value=value), znp.StatusReply)
    if reply.status != ZnpStatus.SUCCESS:
        raise OpeningEndedError(LostWhy.REFUSED, f"it does not write {item.name}: status 0x{reply.status:02X}")


def _ask(request: Request, kind: type[_AnswerT]) -> Generator[Step, Came, _AnswerT]:
    answer = yield Ask(request=request)
    if isinstance(answer, kind):
        return answer
    name = Command(command_of(request)).name
    if answer is None:
        raise OpeningEndedError(LostWhy.NO_ANSWER, f"no answer to {name}")
    raise OpeningEndedError(LostWhy.REFUSED, f"it does not know {name}: it takes a coordinator firmware of Z-Stack 1.2 or later")
