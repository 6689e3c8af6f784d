"""What is wrong with the configuration of ``serve`` beyond its types: endpoints, certificates, and the store's place on the disk."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from firmware_protocol.configuration import Unfit
from firmware_protocol.contract.sessions import endpoint_problem
from mapper.access import TokenFileError, read_tokens
from mapper.config import MapperConfig, tokens_path
from mapper.errors import StoreError
from mapper.page_tls import check_page_tls
from mapper.store_file import expect_fit_file
from mapper.tls_files import check_tls_files


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
