"""The arrays of a scene."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Gaussians(NamedTuple):
    """N Gaussians as `rasterize` takes them, float32."""

    means: NDArray[np.float32]
    """[N, 3], scene units."""
    quats: NDArray[np.float32]
    """[N, 4], (w, x, y, z), of any norm above 0."""
    scales: NDArray[np.float32]
    """[N, 3], standard deviations, scene units."""
    opacities: NDArray[np.float32]
    """[N], 0 to 1."""
    sh: NDArray[np.float32]
    """[N, (degree+1)², 3], SH coefficients: `colors` of `rasterize` with `sh_degree`."""
