"""What systemd is told, on real datagram sockets; the mapper's copy is held to the same laws."""

import asyncio
import os
import socket
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

import gateway.service_manager
import mapper.service_manager

KINDS = [gateway.service_manager.ServiceManager, mapper.service_manager.ServiceManager]
Kind = type[gateway.service_manager.ServiceManager] | type[mapper.service_manager.ServiceManager]


@pytest.fixture(params=["path", "abstract"])
def notify(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[str, socket.socket]]:
    """A socket as systemd has one, and its name in ``NOTIFY_SOCKET``."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@biobot-{uuid.uuid4()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(name if request.param == "path" else f"\0{name[1:]}")
        listener.settimeout(60)
        yield name, listener


@pytest.mark.parametrize("kind", KINDS)
def test_ready_status_and_stopping_are_said_and_a_status_only_when_it_changes(kind: Kind, notify: tuple[str, socket.socket]) -> None:
    name, listener = notify
    manager = kind.of({"NOTIFY_SOCKET": name})
    manager.ready()
    for text in ("1 of 2 radios up", "1 of 2 radios up", "2 of 2\nREADY=0 " + "x" * 500):
        manager.tell(text)
    manager.stopping()
    manager.close()
    manager.ready()
    heard = [listener.recv(4096).decode() for _ in range(4)]
    assert heard[:2] == ["READY=1", "STATUS=1 of 2 radios up"]
    assert heard[2].startswith("STATUS=2 of 2 READY=0 xxx"), "one line is one assignment"
    assert len(heard[2]) <= 220
    assert heard[3] == "STOPPING=1"
    listener.settimeout(0)
    with pytest.raises(BlockingIOError):
        listener.recv(4096)


@pytest.mark.parametrize("kind", KINDS)
def test_signs_of_life_come_thrice_a_period_while_the_loop_moves(kind: Kind, notify: tuple[str, socket.socket]) -> None:
    name, listener = notify
    environment = {"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "30000", "WATCHDOG_PID": str(os.getpid())}

    async def live() -> list[bytes]:
        listener.setblocking(False)
        loop = asyncio.get_running_loop()
        manager = kind.of(environment)
        watching = asyncio.ensure_future(manager.watch())
        heard = [await asyncio.wait_for(loop.sock_recv(listener, 4096), 60) for _ in range(4)]
        watching.cancel()
        manager.close()
        return heard

    assert asyncio.run(live()) == [b"WATCHDOG=1"] * 4


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "environment",
    [
        {},
        {"WATCHDOG_USEC": "1000"},
        {"NOTIFY_SOCKET": "/nowhere/at/all", "WATCHDOG_USEC": "0"},
        {"NOTIFY_SOCKET": "vsock:2:1", "WATCHDOG_USEC": "1000"},
        {"NOTIFY_SOCKET": "/nowhere/at/all", "WATCHDOG_USEC": "soon"},
        {"NOTIFY_SOCKET": "/nowhere/at/all", "WATCHDOG_USEC": "1000", "WATCHDOG_PID": "1"},
    ],
)
def test_without_a_service_manager_that_waits_for_them_there_are_no_signs_of_life(kind: Kind, environment: dict[str, str]) -> None:
    manager = kind.of(environment)
    manager.ready()
    manager.tell("x")
    asyncio.run(manager.watch())
    manager.close()
