"""Key expressions on Zenoh: build and parse (CONTRACT.md §2).

``biobot/@v1/{site}/{stream}/{gateway}[/{node}]``; a watermark has its mapper's name in the place of the node.
The version chunk begins with ``@``, so no wildcard crosses it and two versions never mix. ``*`` stands for "any" where a pattern is built.
"""

import re
from dataclasses import dataclass
from enum import Enum

from firmware_protocol.errors import KeyExpressionError
from firmware_protocol.units import NodeId

ANY = "*"

ROOT = "biobot/@v1"
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,62}\Z")


class Stream(Enum):
    """What is found under a key."""

    ENCOUNTERS = "encounters"
    MODES = "modes"
    MISSION = "mission"
    STATUS = "status"
    NEIGHBOURS = "neighbours"
    EVENTS = "events"
    COMMAND = "command"
    HISTORY = "history"
    RECORDINGS = "recordings"
    ALIVE = "alive"
    WATERMARK = "watermark"
    STAGES = "stages"
    STIMULATION = "stimulation"
    ORDERS = "orders"
    BEAT = "beat"
    """The name in the place of the gateway's is its commander's."""
    ECHO = "echo"
    """The name in the place of the gateway's is any service's, which looks there whether it is heard."""


_NODE = re.compile(r"[0-9]{1,20}\Z", re.ASCII)
_MAX_NODE = 2**64 - 1

_WITH_NODE = {Stream.STATUS, Stream.NEIGHBOURS, Stream.STIMULATION}


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """A parsed key expression."""

    site: str
    stream: Stream
    gateway: str
    node: NodeId | None = None
    mapper: str | None = None


def check_name(name: str, *, what: str) -> str:
    """Return ``name`` if it can be a site's or gateway's name, else raise ``KeyExpressionError``."""
    if not _NAME.match(name):
        raise KeyExpressionError(
            key=name, reason=f"a {what} name has 1 to 63 of the characters A-Z a-z 0-9 _ . - and begins with none of . -"
        )
    return name


def build_key(*, site: str, stream: Stream, gateway: str, node: NodeId | str | None = None, mapper: str | None = None) -> str:
    """Return the key expression of a stream.

    Parameters
    ----------
    site, gateway
        Names, or ``ANY``.
    node
        For ``STATUS``, ``NEIGHBOURS`` and ``STIMULATION``: a biobot, or ``ANY``. The gateway's own status has no node.
    mapper
        For ``WATERMARK``: a mapper's name, or ``ANY``.

    Raises
    ------
    KeyExpressionError
        A name has characters that a key expression may not have, or the stream has no nodes.
    """
    for name, what in ((site, "site"), (gateway, "gateway"), (mapper, "mapper")):
        if name is not None and name != ANY:
            check_name(name, what=what)
    key = f"{ROOT}/{site}/{stream.value}/{gateway}"
    if stream is Stream.WATERMARK or mapper is not None:
        if stream is not Stream.WATERMARK or mapper is None or node is not None:
            raise KeyExpressionError(key=key, reason="a watermark, and nothing else, has a mapper")
        return f"{key}/{mapper}"
    if node is None:
        return key
    if stream not in _WITH_NODE:
        raise KeyExpressionError(key=key, reason=f"stream {stream.value} has no node")
    return f"{key}/{node}"


def parse_key(key: str) -> Key:
    """Return the parts of a concrete key expression.

    Raises
    ------
    KeyExpressionError
        ``key`` is not one of this version's keys, or holds a wildcard.
    """
    root, _, rest = key.partition(ROOT + "/")
    parts = rest.split("/")
    if root or not 3 <= len(parts) <= 4:
        raise KeyExpressionError(key=key, reason=f"not of the form {ROOT}/SITE/STREAM/GATEWAY[/NODE]")
    site, stream_name, gateway = parts[:3]
    try:
        stream = Stream(stream_name)
    except ValueError as error:
        raise KeyExpressionError(key=key, reason=f"unknown stream {stream_name!r}") from error
    check_name(site, what="site")
    check_name(gateway, what="gateway")
    if stream is Stream.WATERMARK and len(parts) == 4:
        return Key(site=site, stream=stream, gateway=gateway, mapper=check_name(parts[3], what="mapper"))
    if stream is Stream.WATERMARK:
        raise KeyExpressionError(key=key, reason="a watermark has a mapper")
    if len(parts) == 3:
        return Key(site=site, stream=stream, gateway=gateway)
    if stream not in _WITH_NODE or not _NODE.match(parts[3]) or int(parts[3]) > _MAX_NODE:
        raise KeyExpressionError(key=key, reason=f"{parts[3]!r} is no node of stream {stream_name}")
    return Key(site=site, stream=stream, gateway=gateway, node=NodeId(int(parts[3])))
