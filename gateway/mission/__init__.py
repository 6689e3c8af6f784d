"""The exploration protocol of [Dir16] IV: dispersion, landmark selection, exploration, by itself and by order (docs/mission.md)."""

from gateway.mission.mission import Mission as Mission
from gateway.mission.planner import MissionPlanner as MissionPlanner
