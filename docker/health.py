"""Ask a service of this container whether it does its work: exit status 0 yes, 1 no; what it says goes to standard output.

    health.py http://127.0.0.1:8000/readyz    its own HTTP answers 200
    health.py /tmp/simulator.ready            each tcp: address of this ready file is listened on

The standard library alone, so that a check costs a start of Python and no more.
"""

import ssl
import sys
import urllib.error
import urllib.request
from pathlib import Path

_TIMEOUT_S = 5
_LISTENING = "0A"  # state of a socket in /proc/net/tcp, proc_net_tcp.txt of the kernel's documentation


def ask(url: str) -> bool:
    """Ask over HTTP. A certificate is not looked at: it names what others call the service, and here it is asked on loopback."""
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    try:
        with urllib.request.urlopen(url, timeout=_TIMEOUT_S, context=context) as answer:
            print(answer.read(2000).decode(errors="replace"))
            return bool(answer.status == 200)
    except urllib.error.HTTPError as error:
        print(error.code, error.read(2000).decode(errors="replace"))
    except OSError as error:
        print(f"{url} does not answer: {error}")
    return False


def are_up(ready_file: Path) -> bool:
    """Say whether the addresses of a ready file are listened on, without connecting: a line has room for one."""
    try:
        addresses = ready_file.read_text().split()
    except OSError as error:
        print(f"{ready_file}: {error.strerror}: not ready yet")
        return False
    sockets = [line.split() for table in ("tcp", "tcp6") for line in Path("/proc/net", table).read_text().splitlines()[1:]]
    ports = {int(fields[1].rpartition(":")[2], 16) for fields in sockets if fields[3] == _LISTENING}
    closed = [address for address in addresses if address.startswith("tcp:") and int(address.rpartition(":")[2]) not in ports]
    print(f"nobody listens on {', '.join(closed)}" if closed else f"up: {', '.join(addresses)}")
    return bool(addresses) and not closed


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("give one URL, or one ready file of biobot-sim")
    sys.exit(0 if (ask(sys.argv[1]) if "://" in sys.argv[1] else are_up(Path(sys.argv[1]))) else 1)
