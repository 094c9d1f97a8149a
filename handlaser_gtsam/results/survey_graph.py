"""The result of a survey as a factor graph, for a graph of one's own.

Hand poses that err are variables there, with what is known of them as priors; the estimate counts their
errors in the weights of the readings instead, which is the same to first order; before balls it counts
what they do on average to second order, too.
"""

from collections import defaultdict

import numpy as np
from scipy.linalg import block_diag

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
    for stop in np.unique(found.rows.stops).tolist():
        stations = np.flatnonzero(found.rows.stops == stop)
        keys = [graph.keys[POSE.name, station, 0] for station in stations.tolist()]
        C = np.kron(np.ones((len(keys), len(keys))), common[stop]) + block_diag(*own[stations])
        recorded = [graph.values.atPose3(key) for key in keys]
        graph.graph.push_back(poses_of_stop(keys, recorded, C))
    return graph
