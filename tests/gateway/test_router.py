"""The router as systemd starts, reloads and stops it."""

import json
import os
import signal
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO

import pytest

from gateway.bus_session import open_client, open_service
from gateway.router import Router
from gateway.router_config import RouterConfig
from gateway.service_manager import ServiceManager
from studies.ports import free_port
from tests.gateway.certified import Certified

ROOT = Path(__file__).parents[2]


def until_event(lines: IO[str], event: str) -> dict[str, object]:
    """Read the log up to an event; the process's end ends it too."""
    for line in lines:
        told: dict[str, object] = json.loads(line)
        if told["event"] == event:
            return told
    pytest.fail(f"{event} was not logged")


@pytest.mark.e2e
def test_it_is_ready_reads_its_roster_again_at_sighup_and_says_who_is_connected(tmp_path: Path) -> None:
    certified = Certified(tmp_path / "ca")
    tls, viewer, port = certified.tls("*/router/main"), certified.tls("demo/viewer/bob"), free_port()
    visitor = certified.tls("demo/viewer/eve")
    command = [sys.executable, "-m", "gateway", "router", "--listen", f"tls/0.0.0.0:{port}", "--roster", str(certified.roster)]
    command += ["--tls-ca", str(tls.ca), "--tls-certificate", str(tls.certificate), "--tls-key", str(tls.key)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NOTIFY_SOCKET": str(tmp_path / "notify")}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60)
        with subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True) as router:
            assert router.stderr is not None
            assert manager.recv(4096) == b"READY=1"
            # Its health check is let in and is no news, nor is who comes for a moment: who is told to have joined is the next one.
            assert subprocess.run([*command, "--ping"], cwd=tmp_path, env=environment, check=False).returncode == 0
            open_client(connect=[f"tls/127.0.0.1:{port}"], tls=visitor).close()  # type: ignore[no-untyped-call]  # as in gateway.router
            with open_service(listen=[], connect=[f"tls/127.0.0.1:{port}"], tls=viewer):
                assert until_event(router.stderr, "router.joined")["name"] == "demo/viewer/bob"
                while manager.recv(4096) != b"STATUS=1 connected":
                    continue
                certified.roster.write_text("*/router/main\n")
                router.send_signal(signal.SIGHUP)
                assert until_event(router.stderr, "router.roster_read")["members"] == 1
                assert until_event(router.stderr, "router.stranger")["name"] == "demo/viewer/bob"
            certified.roster.write_text("demo/pope/bob\n")
            router.send_signal(signal.SIGHUP)
            assert "no role 'pope'" in str(until_event(router.stderr, "router.roster_unfit")["reason"])
            router.send_signal(signal.SIGTERM)
            router.stderr.read()
            assert router.wait(timeout=60) == 0
            while manager.recv(4096) != b"STOPPING=1":
                continue
    certified.roster.write_text("*/router/main\n")
    pinged = subprocess.run([*command, "--ping"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert pinged.returncode == 1
    assert f"tls/127.0.0.1:{port}: nobody listens there" in pinged.stderr


def test_a_router_that_nobody_speaks_to_gives_signs_of_life(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener, ThreadPoolExecutor(1) as threads:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(30)
        manager = ServiceManager(address=str(tmp_path / "notify"), watchdog_s=0.03)
        router = Router(RouterConfig(listen=(f"tcp/127.0.0.1:{free_port()}",)), manager=manager)
        running = threads.submit(router.run)
        try:
            n_signs = 0
            while n_signs < 3:
                n_signs += listener.recv(4096) == b"WATCHDOG=1"
        finally:
            router.stop()
            running.result(30)
            manager.close()
