"""Proximity logs from anywhere to encounters: which columns, which times, which ids; see docs/your-own-data.md."""

from mapper.reading.log import ProximityLog, read_log
from mapper.reading.node_names import NodeNames
from mapper.reading.options import ReadingOptions, Role, TimeUnit, parse_columns
from mapper.reading.stationary_ids import read_ids
from mapper.reading.values import read_time

__all__ = ["NodeNames", "ProximityLog", "ReadingOptions", "Role", "TimeUnit", "parse_columns", "read_ids", "read_log", "read_time"]
