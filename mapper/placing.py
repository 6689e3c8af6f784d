"""Place encounters on a map that are not among its points, by how far each is from the points: landmarks, and whatever is asked for."""

import numpy as np

from mapper.types import FloatArray

_N_NEAR = 8


def place_among(to_points: FloatArray, distances: FloatArray, coordinates: FloatArray) -> FloatArray:
    """Place further encounters beside points that have their places.

    Parameters
    ----------
    to_points
        Distances from each of k further encounters to the m points, shape (k, m) [unit of the map], finite.
    distances, coordinates
        Of the points: shapes (m, m) and (m, 2), m at least 1.

    Returns
    -------
    FloatArray
        Shape (k, 2). Where the points were placed by classical scaling, a further one at the distances of a point gets its place.

    Notes
    -----
    The linear map that takes a point's squared distances to its place in classical scaling is applied to the further ones [dST04]. What it
    misses of the points' places, in a picture made in another way, is interpolated between the nearest points by inverse squared distance.
    """
    centre = coordinates.mean(axis=0)
    linear = np.linalg.pinv(coordinates - centre)
    means = (distances**2).mean(axis=1)

    def scale(rows: FloatArray) -> FloatArray:
        return np.asarray(centre - 0.5 * (rows**2 - means) @ linear.T)

    missed = coordinates - scale(distances)
    n_near = min(_N_NEAR, len(distances))
    near = np.argpartition(to_points, n_near - 1, axis=1)[:, :n_near]
    squared = np.take_along_axis(to_points, near, axis=1) ** 2
    # A further encounter that is a point gets all the weight there.
    weights = 1.0 / (squared + np.finfo(np.float64).eps * (1.0 + squared.max(axis=1, keepdims=True)))
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(scale(to_points) + (weights[:, :, None] * missed[near]).sum(axis=1))
