"""Configuration: sources in order, faults all at once."""

from enum import Enum
from typing import Annotated, Literal

import msgspec
import pytest

from firmware_protocol.configuration import Unfit, load_configuration
from firmware_protocol.errors import ConfigurationError


class Serial(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    baud: Annotated[int, msgspec.Meta(gt=0)] = 115_200
    exclusive: bool = True


class Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    site: str = "demo"
    ports: tuple[str, ...] = ()
    serial: Serial = Serial()
    timeout_s: float = 1.0

    def __post_init__(self) -> None:
        if self.timeout_s < 0:
            msg = f"timeout_s is {self.timeout_s}, but must not be negative"
            raise ValueError(msg)


def load(**kwargs: object) -> Config:
    return load_configuration(Config, environment_prefix="BIOBOT_X", toml_name="x.toml", **kwargs)  # type: ignore[arg-type]  # forwarded


def test_defaults_stand_where_nothing_is_given() -> None:
    assert load() == Config()


def test_flags_win_over_environment_over_toml() -> None:
    toml = 'site = "a"\ntimeout_s = 2\n[serial]\nbaud = 1\nexclusive = false\n'
    environment = {"BIOBOT_X__SITE": "b", "BIOBOT_X__SERIAL__BAUD": "2", "OTHER": "z"}

    config = load(toml_text=toml, environment=environment, flags={"serial.baud": 3, "site": None})

    assert config == Config(site="b", timeout_s=2.0, serial=Serial(baud=3, exclusive=False))


def test_environment_text_becomes_lists_and_truth_values() -> None:
    config = load(environment={"BIOBOT_X__PORTS": "a, b", "BIOBOT_X__SERIAL__EXCLUSIVE": "false"})

    assert config.ports == ("a", "b")
    assert config.serial.exclusive is False


def test_all_faults_are_reported_together_with_their_source() -> None:
    toml = "colour = 1\ntimeout_s = 'soon'\n[serial]\nbaud = -1\nparity = 'E'\n"

    with pytest.raises(ConfigurationError) as caught:
        load(toml_text=toml, environment={"BIOBOT_X__NOPE": "1"})

    text = "\n".join(caught.value.problems)
    for part in (
        "x.toml: unknown key 'colour'",
        "timeout_s is 'soon'",
        "serial.baud is -1",
        "unknown key 'serial.parity'",
        "BIOBOT_X__NOPE",
    ):
        assert part in text
    assert len(caught.value.problems) == 5


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


class Painted(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    name: str
    colour: Colour | None = None
    sides: tuple[Literal["left", "right"], ...] = ()


def test_a_name_that_is_not_allowed_is_told_with_those_that_are_and_a_missing_key_with_its_file() -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_configuration(Painted, environment_prefix="X", toml_name="x.toml", toml_text='colour = "green"\nsides = ["up"]\n')
    missing, colour, sides = caught.value.problems
    assert missing == "x.toml: missing key 'name'"
    assert (colour.split("; ")[1], sides.split("; ")[1]) == ("wanted red or blue", "wanted left or right")
    with pytest.raises(ConfigurationError, match=r"^missing key 'name'$"):
        load_configuration(Painted, environment_prefix="X")


def test_a_rule_between_fields_is_reported_as_a_fault() -> None:
    with pytest.raises(ConfigurationError, match="must not be negative"):
        load(toml_text="timeout_s = -1.0")


@pytest.mark.parametrize("text", ["= 3", "serial = 3", "[serial\n"])
def test_broken_toml_is_a_configuration_error(text: str) -> None:
    with pytest.raises(ConfigurationError):
        load(toml_text=text)


def check(config: Config) -> list[Unfit]:
    return [
        Unfit(keys=("timeout_s", "serial.baud"), reason=f"timeout_s is {config.timeout_s}, too short for serial.baud"),
        Unfit(keys=("site",), reason="site: is far"),
    ]


def test_what_types_cannot_say_is_told_in_the_same_round_with_its_source() -> None:
    with pytest.raises(ConfigurationError) as caught:
        load(toml_text="timeout_s = 0.5\nports = 3\n", flags={"site": "x"}, flag_names={"site": "--where"}, check=check)

    unfit_type, too_short, far = caught.value.problems
    assert unfit_type.startswith("x.toml: ports is 3")
    assert too_short == "x.toml: timeout_s is 0.5, too short for serial.baud"
    assert far == "--where: site: is far"


def test_what_follows_from_an_unfit_value_alone_is_not_told() -> None:
    with pytest.raises(ConfigurationError) as caught:
        load(toml_text="timeout_s = 0.5\n[serial]\nbaud = -1\n", check=check)

    assert len(caught.value.problems) == 2
    assert "serial.baud is -1" in caught.value.problems[0]
    assert caught.value.problems[1] == "site: is far"


def test_faults_of_other_sources_are_told_beside_a_file_that_is_no_toml() -> None:
    with pytest.raises(ConfigurationError) as caught:
        load(toml_text="= 3", environment={"BIOBOT_X__TIMEOUT_S": "soon"}, check=check)

    assert ["not valid TOML" in problem for problem in caught.value.problems] == [True, False]
