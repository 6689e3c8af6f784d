"""What the mapper's web service is compared with: a Starlette application of one route that returns bytes, served in the same way.

``python -m studies.bare_server --body FILE --url-file FILE``.
"""

import argparse
import asyncio
import socket
from collections.abc import Sequence
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

PATH = "/api/v1/map"


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until a signal."""
    parser = argparse.ArgumentParser(prog="python -m studies.bare_server", description=__doc__)
    parser.add_argument("--body", type=Path, required=True, help="what is returned")
    parser.add_argument("--url-file", type=Path, required=True, help="written when it is up")
    options = parser.parse_args(arguments)
    body = options.body.read_bytes()

    async def answer(_request: Request) -> Response:
        return Response(body, media_type="application/json")

    application = Starlette(routes=[Route(PATH, answer)])
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", 0))
        listener.listen(512)
        # As `mapper.service` has it.
        config = uvicorn.Config(
            application, log_config=None, log_level="warning", access_log=False, server_header=False, lifespan="off", ws="none"
        )
        options.url_file.write_text(f"http://127.0.0.1:{listener.getsockname()[1]}\n")
        asyncio.run(uvicorn.Server(config).serve(sockets=[listener]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
