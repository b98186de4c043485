"""Looks for the streams that somebody asks for."""

from __future__ import annotations

import pylsl

from biosensor_common.lsl.predicates import (
    EVERYTHING,
    Predicate,
    all_of,
    any_of,
    equals,
    none_of,
    of_user,
)
from biosensor_common.quantities import ContentType
from lsl_to_ros.lsl.inlets import FROM_ROS

# An outlet that has just died is still reported by the resolver for so long.
FORGET_AFTER_S = 5.0
_ROS_BLOCK = "desc/ros"


def wanted_by(query: str) -> Predicate:
    """Return what a user asks for; all streams of an empty query."""
    return of_user(query) if query else EVERYTHING


def asks_for_ros(predicate: Predicate) -> bool:
    """Whether a predicate asks for streams that are made of topics."""
    return _ROS_BLOCK in predicate


def resolver(predicate: Predicate) -> pylsl.ContinuousResolver:
    """Look for what a predicate names, and for the counts of losses of all agents."""
    served = predicate if asks_for_ros(predicate) else all_of(predicate, none_of(FROM_ROS))
    counters = equals("type", ContentType.COUNTERS)
    return pylsl.ContinuousResolver(pred=any_of(served, counters), forget_after=FORGET_AFTER_S)
