"""The result of a survey as a factor graph, for a graph of one's own.

Hand poses that err are variables there, with what is known of them as priors; the estimate counts their
errors in the weights of the readings instead, which is the same to first order.
"""

from collections import defaultdict

import numpy as np

from ..estimation.survey import SurveyEstimate
from ..estimation.survey_rows import Item, blocks_of
from ..factors.of_blocks import BlockGraph, graph_of_blocks
from ..factors.poses_of_stop import poses_of_stop
from ..model.families import POSE
from ..model.weighting import without_exact_axes
from ..quantities import NEGLIGIBLE


def survey_graph(found: SurveyEstimate) -> BlockGraph:
    """Return the graph of what counts of a survey, with the noise that was found, and its solution."""
    state = found.ended()
    used = found.rows.counted(found.used)
    unknown, sigmas, covariance = found.rows.unknown(), state.sigmas(), state.pose_covariance()
    if not covariance.any():
        blocks, _ = blocks_of(used, sigmas, state.values)
        return graph_of_blocks([*blocks, *state.beside()], state.values, unknown)
    at_stop: dict[int, list[Item]] = defaultdict(list)  # a factor has the poses of one stop
    for item in used:
        at_stop[item.stop].append(item)
    blocks = [one for here in at_stop.values() for one in blocks_of(here, sigmas, state.values)[0]]
    unknown[POSE.name] = True
    graph = graph_of_blocks([*blocks, *state.beside()], state.values, unknown)
    common = without_exact_axes(covariance, found.rows.length)
    own = state.own_covariance() + NEGLIGIBLE * common
    stations_of: dict[int, list[int]] = defaultdict(list)
    for station, stop in enumerate(found.rows.stops.tolist()):
        stations_of[stop].append(station)
    for stop, stations in stations_of.items():
        keys = [graph.keys[POSE.name, station, 0] for station in stations]
        C = np.kron(np.ones((len(keys), len(keys))), common[stop])
        for i, station in enumerate(stations):
            C[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] += own[station]
        recorded = [graph.values.atPose3(key) for key in keys]
        graph.graph.push_back(poses_of_stop(keys, recorded, C))
    return graph
