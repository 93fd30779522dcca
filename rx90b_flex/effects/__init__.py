"""Effects: what a robot has beyond its rigid tree. One class is one effect type; the catalogue finds them by itself."""

from rx90b_flex.effects.at_rest import RestSites, RestSizes
from rx90b_flex.effects.effect import Effect
from rx90b_flex.effects.hints import LeftOver, Sites
from rx90b_flex.effects.motion import Coordinates, JointMotion, Motion, TreeMotion
from rx90b_flex.effects.parameters import Parameter
from rx90b_flex.effects.tables import catalogue, effect_from_table, effect_to_table
from rx90b_flex.files.keys import close_match

__all__ = [
    "Coordinates",
    "Effect",
    "JointMotion",
    "LeftOver",
    "Motion",
    "Parameter",
    "RestSites",
    "RestSizes",
    "Sites",
    "TreeMotion",
    "catalogue",
    "close_match",
    "effect_from_table",
    "effect_to_table",
]
