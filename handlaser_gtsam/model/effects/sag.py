"""A plate that is curved: its edges farther from the sensor than its middle.

Another middle is another tilt and offset of the plate: no other unknown follows.
"""

from .effect import Everywhere, SeenStations


def members(stations: SeenStations) -> Everywhere:
    """Return the derivatives (N, 1), with the square of each spot's distance from the middle."""
    middles, largest = stations.plates
    square = ((stations.spots - middles[stations.readings.plane]) ** 2).sum(axis=1)
    return Everywhere((stations.linear.offset * square / largest)[:, None])
