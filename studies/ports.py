"""TCP ports of loopback for programs that are started a moment later: nobody else is given them in the meantime."""

import atexit
import contextlib
import socket

_kept = contextlib.ExitStack()
atexit.register(_kept.close)


def free_port() -> int:
    """Return a port on 127.0.0.1 that is free, and stays so for who asks for it by number.

    A socket of this process keeps it until the process ends, so the system gives it to no other program that asks for any port,
    nor to an outgoing connection. It never listens: with ``SO_REUSEADDR``, as Zenoh, asyncio and uvicorn set it, another socket may,
    and until then a connection is refused.
    """
    one = _kept.enter_context(socket.socket())
    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    one.bind(("127.0.0.1", 0))
    port: int = one.getsockname()[1]
    return port
