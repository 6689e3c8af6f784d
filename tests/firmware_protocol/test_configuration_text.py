"""The printed default configuration says what the code does."""

import json
import tomllib
from enum import Enum
from typing import Annotated

import jsonschema_rs
import msgspec
import pytest

from firmware_protocol.configuration import load_configuration
from firmware_protocol.configuration_text import configuration_keys, default_toml, meanings
from gateway.config import GatewayConfig
from mapper.config import MapperConfig

OURS = [GatewayConfig, MapperConfig]


@pytest.mark.parametrize("config", OURS)
def test_loading_what_is_printed_gives_the_defaults(config: type[msgspec.Struct]) -> None:
    text = default_toml(config, title="All of it.")

    assert load_configuration(config, toml_text=text, environment_prefix="X") == config()
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize("config", OURS)
def test_every_key_is_printed_once_and_those_that_are_not_given_as_comments(config: type[msgspec.Struct]) -> None:
    printed: list[str] = []
    table = ""
    for line in default_toml(config, title="t").splitlines():
        if line.startswith("["):
            table = line.strip("[]") + "."
        key = line.removeprefix("# ").split(" =")
        if len(key) == 2 and "  # " in line:
            printed.append(table + key[0])

    assert sorted(printed) == sorted(one.name for one in configuration_keys(config))


@pytest.mark.parametrize("config", OURS)
def test_what_is_printed_is_valid_by_the_schema(config: type[msgspec.Struct]) -> None:
    schema = msgspec.json.schema(config)
    jsonschema_rs.meta.validate(schema)
    jsonschema_rs.validate(schema, tomllib.loads(default_toml(config, title="t")))
    with pytest.raises(jsonschema_rs.ValidationError):
        jsonschema_rs.validate(schema, {"no-such-key": 1})


class Colour(Enum):
    RED = "red"


class Inner(msgspec.Struct, frozen=True, kw_only=True):
    """A table with "quotes".

    Keys
    ----
    text
        What ``it`` says.
    """

    text: str = 'a "quoted" \\ text\n'


class Outer(msgspec.Struct, frozen=True, kw_only=True):
    """All.

    Keys
    ----
    needed
        A key that must be given.
    low, high
        Two that belong together.
    """

    needed: int
    low: Annotated[int, msgspec.Meta(ge=0, le=9)] = 0
    high: Colour | None = None
    inner: Inner = Inner()


def test_meaning_type_limits_and_default_stand_with_each_key() -> None:
    text = default_toml(Outer, title="Title.")

    assert text.splitlines()[0] == "# Title."
    for line in (
        "# needed =   # int; must be given",
        "# low, high: Two that belong together.\nlow = 0  # int ≥ 0, ≤ 9\n# high =   # red; not given by default",
        '[inner]\n# A table with "quotes".\n\n# What `it` says.\ntext = "a \\"quoted\\" \\\\ text\\n"  # str',
    ):
        assert line in text
    assert tomllib.loads(text)["inner"]["text"] == Inner().text
    assert json.loads(json.dumps(tomllib.loads(text))) == {"low": 0, "inner": {"text": Inner().text}}
    assert meanings(Outer)["high"] == (("low", "high"), "Two that belong together.")


def test_a_key_that_no_docstring_explains_is_an_error() -> None:
    class Silent(msgspec.Struct):
        """Say nothing."""

        depth: int = 1

    with pytest.raises(ValueError, match="Silent: the section Keys of its docstring says nothing of depth"):
        default_toml(Silent, title="t")
