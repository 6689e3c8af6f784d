"""The first token: made where there is no file of tokens yet, and told once, to a terminal or into a file; never to the log."""

import sys
from pathlib import Path
from typing import Final

from mapper.access.register import TokenRegister, add_token
from mapper.access.roles import Role
from mapper.access.token_file import read_tokens
from mapper.access.tokens import n_admins
from mapper.log import EventLog

_log = EventLog(__name__)

FIRST_NAME: Final = "admin"


def open_register(path: Path, *, token_file: Path | None) -> TokenRegister:
    """Open the tokens. Where there is no file of them, make one with an admin's token, if somebody is there to be told it.

    Parameters
    ----------
    token_file
        Write the first token there; None: to standard error, if that is a terminal.

    Raises
    ------
    TokenFileError
        The file of tokens, or ``token_file``, cannot be used.
    """
    if read_tokens(path) is None and (token_file is not None or sys.stderr.isatty()):
        _make_first(path, token_file=token_file)
    register = TokenRegister.open(path)
    if not n_admins(register.records):
        _log.warning(
            "access.no_admin",
            tokens=str(path),
            next_step=f"biobot-mapper tokens add NAME --role admin --tokens {path}; until then tokens are made and revoked here only",
        )
    return register


def _make_first(path: Path, *, token_file: Path | None) -> None:
    made = add_token(path, name=FIRST_NAME, role=Role.ADMIN, secret_file=token_file)
    if token_file is not None:
        _log.info("access.first_token", id=made.record.id, written_to=str(token_file))
        return
    _log.info("access.first_token", id=made.record.id)
    print(  # noqa: T201  # a person must see it, and no log may have it
        f"first token, of {FIRST_NAME}, shown this once (keep it; biobot-mapper tokens makes others):\n{made.text}",
        file=sys.stderr,
        flush=True,
    )
