"""The frozen configuration: what a TOML file, the environment and the flags may say."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from firmware_protocol.configuration import Unfit, load_configuration
from firmware_protocol.contract.keys import check_name
from firmware_protocol.contract.sessions import TlsTable, ZenohTable
from firmware_protocol.errors import ConfigurationError, KeyExpressionError
from firmware_protocol.first_use import prepare
from mapper.types import Method, MetricKind, ProfileNorm, Recipe

ENVIRONMENT_PREFIX = "BIOBOT_MAPPER"
MAX_WINDOW_S = 1e9
"""Thirty years: with a whole record of 146 at most, no sum of instants leaves 64 bits."""

# METHOD of [Dir16]: elapsed time, 10 neighbours, the 0.9 quantile, 150 points, the complex drawn at half the diameter.
_PAPER = Recipe(
    method=Method.PAPER,
    metric=MetricKind.ENCOUNTER,
    profile_norm=ProfileNorm.MAX,
    moving_time=False,
    bracketed=False,
    placed=False,
    smoothing_share=0.0,
    max_candidates=0,
    outlier_k=10,
    outlier_q=0.9,
    n_points=150,
    encounters_per_point=0,
    n_anchors=20,
    betti_rules=None,
    epsilon_share=0.5,
    speed_mps=None,
)
_DEFAULT = replace(
    _PAPER,
    method=Method.DEFAULT,
    metric=MetricKind.LANDMARK_PROFILE,
    profile_norm=ProfileNorm.MAX,
    moving_time=True,
    bracketed=True,
    placed=True,
    smoothing_share=0.004,
    smoothing_passes=2,
    max_candidates=20_000,
    n_points=400,
    encounters_per_point=10,
    epsilon_share=None,
    replicates=2,
)

# As many as n_points may ask for.
_MIN_CANDIDATES = 1_000


class RecipeConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The method and its parameters; what is not given is as ``method`` has it.

    Keys
    ----
    method
        The whole recipe: paper, as in [Dir16], or default, by landmark profiles.
    metric
        How encounters are compared: encounter, by the time between them, or landmark_profile, by their times to all landmarks.
    profile_norm
        How the differences of two landmark profiles become one number: max, the largest, or rms, the root mean square.
    moving_time
        What lies between two encounters of a biobot is the time that it walked, in place of all that passed.
    bracketed
        Profiles are the middle of their bounds, and badly bounded encounters are outliers; else outlier_k finds those.
    placed
        Bracketed encounters are placed in the plane along the tracks of biobots, and those placed best are compared.
    smoothing_share
        Bracketed profiles are averaged over this share of the encounters around each.
    smoothing_passes
        How often they are averaged, one mean after the other.
    max_candidates
        Encounters that may become points, taken evenly in the order of time; 0: all.
    outlier_k, outlier_q
        An encounter whose k-th neighbour is further than this quantile of all such distances is left out; 1 keeps all.
    n_points
        Points that the complex is built of; fewer where encounters_per_point says so.
    encounters_per_point
        Encounters that must stand behind each point; 0: none.
    n_anchors
        Encounters, far apart, that serve as references where a part of the map has too few landmarks.
    epsilon_share
        The complex is drawn at this share of the diameter; without it, at the scale that shows the holes best.
    speed_mps
        Walking speed [m/s]: lengths are then metres, else seconds.
    replicates
        Parts of the time that are mapped too, to say how sure the map is; 0 says nothing of that, and takes half the time.
    """

    method: Method = Method.DEFAULT
    metric: MetricKind | None = None
    profile_norm: ProfileNorm | None = None
    moving_time: bool | None = None
    bracketed: bool | None = None
    placed: bool | None = None
    smoothing_share: Annotated[float, Meta(ge=0, le=0.1)] | None = None
    smoothing_passes: Annotated[int, Meta(ge=1, le=100)] | None = None
    max_candidates: Annotated[int, Meta(ge=0, le=10_000_000)] | None = None
    outlier_k: Annotated[int, Meta(ge=1, le=1000)] | None = None
    outlier_q: Annotated[float, Meta(gt=0, le=1)] | None = None
    n_points: Annotated[int, Meta(ge=4, le=1000)] | None = None
    encounters_per_point: Annotated[int, Meta(ge=0, le=1_000_000)] | None = None
    n_anchors: Annotated[int, Meta(ge=3, le=1000)] | None = None
    epsilon_share: Annotated[float, Meta(ge=0, le=1)] | None = None
    speed_mps: Annotated[float, Meta(gt=0)] | None = None
    replicates: Annotated[int, Meta(ge=0, le=10)] | None = None

    def __post_init__(self) -> None:
        """Refuse what limits alone let pass: a speed that is no number, and fewer candidates than points to be picked from them."""
        if self.max_candidates is not None and 0 < self.max_candidates < _MIN_CANDIDATES:
            raise ValueError(f"max_candidates is {self.max_candidates}, but must be 0 for no limit, or at least {_MIN_CANDIDATES}")
        if self.speed_mps is not None and not isfinite(self.speed_mps):
            raise ValueError(f"speed_mps is {self.speed_mps}, but must be a finite number of metres per second")


prepare(RecipeConfig)


class ServiceConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How ``biobot-mapper serve`` is connected, and what of all encounters it maps.

    Keys
    ----
    name
        What gateways know the mapper by, which keep what it does not have yet; without it, a random one that stays with the store.
    site
        The first name in the keys of the bus.
    connect, listen
        Zenoh endpoints; a gateway on the same machine listens on the one that is connected to by default.
    store
        The file of records; without it they are in memory alone, and gateways' journals fill it again at each start.
    host, port
        Address of the page; port 0 takes a free one.
    allow_remote
        Let other machines in, which a host other than a loopback address needs. Whoever reads then needs a token too.
    anonymous_reading
        Whoever is on this machine may look without a token; to command always needs one.
    tokens
        The file of tokens (biobot-mapper tokens); without it, mapper-tokens.json beside the store, or in the working directory.
    certificate, key
        PEM files of the page's own certificate, its chain with it, and of the key to it: the page is then served by https alone.
    min_interval_s
        A new map is begun no earlier than this after the one before.
    window_s
        Only encounters not over this long before the end of the newest one count; without it, all do. Those under way then begin there.
    log_level
        DEBUG, INFO, WARNING or ERROR.
    """

    name: str | None = None
    site: str = "local"
    connect: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    listen: tuple[str, ...] = ()
    store: str | None = None
    host: str = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65_535)] = 8080
    allow_remote: bool = False
    anonymous_reading: bool = True
    tokens: str | None = None
    certificate: str | None = None
    key: str | None = None
    min_interval_s: Annotated[float, Meta(ge=0.05, le=3600)] = 1.0
    window_s: Annotated[float, Meta(ge=0.001, le=MAX_WINDOW_S)] | None = None
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = "INFO"

    def __post_init__(self) -> None:
        """Refuse a site that cannot stand in a key, and a window that is no number, which limits alone let pass."""
        if self.window_s is not None and not isfinite(self.window_s):
            raise ValueError(f"window_s is {self.window_s}, but must be a finite number of seconds; leave it out to map all encounters")
        try:
            check_name(self.site, what="site")
            if self.name is not None:
                check_name(self.name, what="mapper")
        except KeyExpressionError as error:
            raise ValueError(str(error)) from error


class HistoryConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which maps of the past ``biobot-mapper serve`` keeps.

    Keys
    ----
    all_s
        Every finished map of so long; of what is older, one a minute.
    minutes_s
        One a minute of so long; of what is older, one in ten minutes.
    ten_minutes_s
        One in ten minutes of so long; of what is older, one an hour.
    max_mb
        They take no more than this, compressed [MB]: the oldest go.
    """

    all_s: Annotated[int, Meta(ge=0, le=86_400)] = 300
    minutes_s: Annotated[int, Meta(ge=0, le=31_536_000)] = 7_200
    ten_minutes_s: Annotated[int, Meta(ge=0, le=31_536_000)] = 86_400
    max_mb: Annotated[float, Meta(ge=1, le=100_000)] = 100.0

    def __post_init__(self) -> None:
        """Refuse times that do not ascend: each begins where the one before ends."""
        if not self.all_s <= self.minutes_s <= self.ten_minutes_s:
            raise ValueError(
                f"all_s, minutes_s and ten_minutes_s are {self.all_s}, {self.minutes_s} and {self.ten_minutes_s}, but must not descend"
            )


class AlertsConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """From where on ``biobot-mapper serve`` tells of something.

    Keys
    ----
    lost_s
        A biobot that was not heard for so long, though its gateway works, is lost: several times the period of its status.
    battery_mv, battery_critical_mv
        A battery below this is low, and all but empty.
    hole_probability
        A new hole at least so likely is told, once three maps in a row show it.
    """

    lost_s: Annotated[float, Meta(ge=1, le=86_400)] = 60.0
    battery_mv: Annotated[int, Meta(ge=0, le=20_000)] = 2400
    battery_critical_mv: Annotated[int, Meta(ge=0, le=20_000)] = 2200
    hole_probability: Annotated[float, Meta(ge=0, le=1)] = 0.8

    def __post_init__(self) -> None:
        """Refuse a critical voltage above the low one."""
        if self.battery_critical_mv > self.battery_mv:
            raise ValueError(f"battery_critical_mv is {self.battery_critical_mv}, but must be at most battery_mv, {self.battery_mv}")


class LimitsConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How often the holder of a token may ask; beyond that the answer is 429. Stops have no limit, nor has reading on this machine.

    Keys
    ----
    reads_per_s, reads_burst
        Requests that change nothing: so many a second in the long run, and so many at once.
    writes_per_s, writes_burst
        The same of those that change something.
    """

    reads_per_s: Annotated[float, Meta(ge=1, le=1e6)] = 50.0
    reads_burst: Annotated[float, Meta(ge=1, le=1e6)] = 500.0
    writes_per_s: Annotated[float, Meta(ge=0.1, le=1e6)] = 10.0
    writes_burst: Annotated[float, Meta(ge=1, le=1e6)] = 100.0


class MapperConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that one configuration file of the mapper may say; ``biobot-mapper run`` heeds ``recipe`` alone.

    Keys
    ----
    recipe, serve, limits, history, alerts, tls, zenoh
        Tables of their own.
    """

    recipe: RecipeConfig = RecipeConfig()
    serve: ServiceConfig = ServiceConfig()
    history: HistoryConfig = HistoryConfig()
    alerts: AlertsConfig = AlertsConfig()
    limits: LimitsConfig = LimitsConfig()
    tls: TlsTable = TlsTable()
    zenoh: ZenohTable = ZenohTable()


def load_mapper_config(
    path: Path | None,
    *,
    environment: Mapping[str, str],
    flags: Mapping[str, object],
    check: Callable[[MapperConfig], Iterable[Unfit]] | None = None,
) -> MapperConfig:
    """Build the configuration: defaults, then the TOML file, then ``BIOBOT_MAPPER__...`` variables, then flags.

    Parameters
    ----------
    path
        The TOML file, or None for none.
    flags
        Dotted key to value; None means "not given".
    check
        Finds what types cannot say, such as files that are not there.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or any source has an unknown key or an unfit value; all are listed.
    """
    text = None
    if path is not None:
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            raise ConfigurationError([f"{path}: cannot be read: {reason}; give the path of a TOML file"]) from error
    return load_configuration(
        MapperConfig,
        toml_text=text,
        toml_name=str(path),
        environment=environment,
        environment_prefix=ENVIRONMENT_PREFIX,
        flags=flags,
        check=check,
    )


def tokens_path(serve: ServiceConfig) -> Path:
    """Return the file of tokens."""
    if serve.tokens is not None:
        return Path(serve.tokens)
    return (Path() if serve.store is None else Path(serve.store).parent) / "mapper-tokens.json"


def make_recipe(config: RecipeConfig) -> Recipe:
    """Fill what is not given with the parameters of the method named."""
    recipe = _PAPER if config.method is Method.PAPER else _DEFAULT
    given = {name: getattr(config, name) for name in config.__struct_fields__ if getattr(config, name) is not None}
    return replace(recipe, **given)
