"""WIRE_FORMAT.md §9 and the code say the same of commands, statuses and examples."""

import re
from pathlib import Path

import firmware_protocol
from firmware_protocol.dialects.znp_statuses import radio_status_of
from firmware_protocol.envelope import RadioStatus
from firmware_protocol.framing.znp import encode_frame
from firmware_protocol.znp import codec
from firmware_protocol.znp.codec import encode_command
from firmware_protocol.znp.frames import PingReply, PingRequest
from firmware_protocol.znp.numbers import BIOBOT_CLUSTER, BIOBOT_ENDPOINT, BIOBOT_PROFILE, Command

TEXT = (Path(firmware_protocol.__file__).parent / "WIRE_FORMAT.md").read_text(encoding="utf-8").split("\n## 9 ")[1].split("\n## ")[0]

# Asked by other hosts of the virtual chip alone.
OF_OTHER_HOSTS = {
    "SYS_GET_EXTADDR", "SYS_OSAL_NV_DELETE", "SYS_OSAL_NV_LENGTH", "SYS_NV_LENGTH", "SYS_NV_READ", "UTIL_ASSOC_FIND_DEVICE",
}  # fmt: skip
NAMES = {
    "sent": RadioStatus.SENT, "no acknowledgement": RadioStatus.NO_ACK, "channel busy": RadioStatus.CHANNEL_BUSY,
    "unknown address": RadioStatus.UNKNOWN_ADDRESS, "queue full": RadioStatus.QUEUE_FULL, "too long": RadioStatus.TOO_LONG,
}  # fmt: skip


def test_every_command_is_in_the_text_with_its_number() -> None:
    told = {name: int(cmd0 + cmd1, 16) for cmd0, cmd1, name in re.findall(r"^\| `(\w\w) (\w\w)` (\w+) \| [<>] ", TEXT, re.MULTILINE)}
    requests = {one.name: one.value for one in Command if one.name not in OF_OTHER_HOSTS}
    assert {name: number for name, number in told.items() if name in requests} == requests
    reports = {number for name, number in told.items() if name not in requests}
    assert reports == {0x4180, 0x4480, 0x4481, 0x45C0, 0x45C1, 0x45CA}
    assert reports <= set(codec._BY_COMMAND)


def test_every_status_of_the_text_has_its_outcome_and_no_other_has_one() -> None:
    told: dict[int, RadioStatus] = {}
    for codes, name in re.findall(r"^\| (0x[^|]+) \| [^|]+ \| ([a-z ]+) \|$", TEXT, re.MULTILINE):
        told |= {int(code, 16): NAMES[name.strip()] for code in codes.split(",")}
    assert told == {status: radio_status_of(status) for status in range(256) if radio_status_of(status) is not RadioStatus.OTHER}


def test_the_example_and_the_place_of_payloads_are_true() -> None:
    match = re.search(r"SYS_PING is `([0-9A-F ]+)`, and its answer `([0-9A-F ]+)`", TEXT)
    assert match
    assert encode_frame(encode_command(PingRequest())) == bytes.fromhex(match[1])
    assert encode_frame(encode_command(PingReply(capabilities=0x0659))) == bytes.fromhex(match[2])
    place = f"**endpoint 0x{BIOBOT_ENDPOINT:02X}** with **profile 0x{BIOBOT_PROFILE:04X}** and **cluster 0x{BIOBOT_CLUSTER:04X}**"
    assert place in TEXT
