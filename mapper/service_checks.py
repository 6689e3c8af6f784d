"""What is wrong with the configuration of ``serve`` beyond its types: endpoints, certificates, and the store's place on the disk.

And what would be in the way of a mapper that were started now, though its configuration is well.
"""

import errno
import fcntl
import os
import socket
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

from firmware_protocol.configuration import Unfit
from firmware_protocol.contract.sessions import endpoint_problem, host_and_port
from mapper.access import TokenFileError, read_tokens
from mapper.config import MapperConfig, tokens_path
from mapper.errors import StoreError
from mapper.page_tls import check_page_tls
from mapper.store_file import expect_fit_file
from mapper.tls_files import check_tls_files

_PLACEHOLDER = "ROUTER"
"""Stands for a router's address in what `biobot-gateway certs issue` prints where it does not know one."""


def check_service(config: MapperConfig, *, tries_places: bool = False) -> Iterator[Unfit]:
    """Yield all that is wrong; ``tries_places``: the store that is there is read, and its directory written to for a moment."""
    serve = config.serve
    for key, endpoints in (("listen", serve.listen), ("connect", serve.connect)):
        for endpoint in endpoints:
            if reason := endpoint_problem(endpoint, listens=key == "listen"):
                yield Unfit(keys=(f"serve.{key}",), reason=f"serve.{key}: {reason}")
    yield from check_tls_files(config)[0]
    yield from check_page_tls(serve)
    if tries_places and (why := _why_no_tokens(tokens_path(serve))):
        yield Unfit(keys=("serve.tokens",), reason=f"serve.tokens: {why}")
    if tries_places and serve.store is not None and (why := _why_no_store(Path(serve.store))):
        yield Unfit(keys=("serve.store",), reason=f"serve.store: {why}")


def service_obstacles(config: MapperConfig) -> Iterator[str]:
    """Yield what depends on the moment, and is no fault of the configuration: it may be this very service that has it.

    Addresses that another program listens at, and a store that another process has open; nothing is made or locked for it.
    """
    serve = config.serve
    if why := _why_taken(serve.host, serve.port):
        yield f"serve.port: {serve.host}:{serve.port}: {why}; {_what_listens(serve.port)}, or name another with --port"
    for endpoint in serve.listen:
        address = host_and_port(endpoint)
        if address is not None and (why := _why_taken(*address)):
            yield f"serve.listen: {endpoint}: {why}; {_what_listens(address[1])}, or name another port"
    for endpoint in serve.connect:
        if (address := host_and_port(endpoint)) is not None and address[0] == _PLACEHOLDER:
            yield f"serve.connect: {endpoint}: {_PLACEHOLDER} stands for the router's address; put its name or address there"
    if serve.store is not None and (process := _holder_of(Path(serve.store))):
        yield f"serve.store {serve.store}: process {process} has it open; end it if it is not this service itself, or name another file"


def _why_taken(host: str, port: int) -> str:
    """Return why nothing can be listened on there now, or nothing. Port 0 takes a free one."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
    except OSError as error:
        return "another program has it" if error.errno == errno.EADDRINUSE else (error.strerror or str(error)).lower()
    return ""


def _what_listens(port: int) -> str:
    return f"end what listens there, if it is not this service itself (ss -ltnp 'sport = :{port}' names it)"


def _holder_of(path: Path) -> int:
    """Return the process that keeps SQLite's locks on a file, or 0: a mapper keeps some for as long as it has its store."""
    wanted = struct.pack("hhqqi", fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)  # fcntl(2): who would be in the way of a lock on all of it
    try:
        with path.open("rb") as file:
            kind, _, _, _, process = struct.unpack_from("hhqqi", fcntl.fcntl(file, fcntl.F_GETLK, wanted + bytes(8)))
    except OSError:
        return 0
    return 0 if kind == fcntl.F_UNLCK else int(process)


def _why_no_tokens(path: Path) -> str:
    try:
        read_tokens(path)
    except TokenFileError as error:
        return str(error)
    return ""


def _why_no_store(path: Path) -> str:
    try:
        expect_fit_file(path)
        # Tried, because permissions alone do not tell of a disk that is full or read-only; nothing is left behind.
        with tempfile.TemporaryFile(dir=path.parent) as probe:
            probe.write(b"\0")
            probe.flush()
    except StoreError as error:
        return str(error)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        return f"nothing can be written in {path.parent}: {reason}; make room, or name a file elsewhere"
    return ""
