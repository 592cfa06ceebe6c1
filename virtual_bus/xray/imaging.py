"""From transmission to a panel's image: focal spot, motion during the exposure, point spread, scatter, photons, dead pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from virtual_bus.xray.objects import Item
from virtual_bus.xray.render import Panel, View, transmission

SPOT = np.array([[0.25, 0.25], [-0.25, -0.25], [-0.25, 0.25], [0.25, -0.25]])
"""Points of a focal spot of unit diameter: four rays with a disc's second moment, 1/16 in either direction, centred on it."""


@dataclass(frozen=True)
class Optics:
    """What blurs and disturbs an image.

    Attributes
    ----------
    photons : float
        Mean count in a pixel that nothing shades.
    spot_m : float
        Size of the focal spot, across the beam.
    spread_m : float
        Standard deviation of the panel's point spread.
    scatter : float
        Scattered over unscattered photons where the beam is open.
    scatter_reach_m : float
        How far scatter spreads on the panel (standard deviation).
    dead : float
        Share of pixels that read nothing or everything in this image, half each (salt and pepper).
    """

    photons: float = 2000.0
    spot_m: float = 0.6e-3
    spread_m: float = 0.2e-3
    scatter: float = 0.1
    scatter_reach_m: float = 0.03
    dead: float = 1e-4


def expected(views: Sequence[View], panel: Panel, items: Sequence[Item], optics: Optics, rays: int = 3) -> np.ndarray:
    """Return the expected photons of every pixel, the mean over the views that an exposure passes through; no dead pixels.

    Parameters
    ----------
    views : sequence of View
        Evenly spaced over the exposure.
    panel : Panel
    items : sequence of Item
        Objects in the beam.
    optics : Optics
    rays : int
        Rays in a row and in a column of each pixel.

    Returns
    -------
    (rows, columns) array
    """
    total = np.zeros((panel.rows, panel.columns))
    for _, moved, share in from_the_spot(views, optics):
        total += share * transmission(moved, panel, items, rays)
    return read_out(total, panel, optics)


def from_the_spot(views: Sequence[View], optics: Optics) -> Iterator[tuple[int, View, float]]:
    """Yield the number of a view, the view from a point of the focal spot, and its share in the image."""
    spots = SPOT * optics.spot_m if optics.spot_m > 0.0 else np.zeros((1, 2))
    for k, view in enumerate(views):
        # The spot's points are shared out over the views where there are enough views: at any instant each point is as likely.
        chosen = spots if len(views) < len(spots) else spots[k % len(spots)][None]
        for point in chosen:
            moved = View(view.source_m + view.panel_rotation[:, :2] @ point, view.panel_m, view.panel_rotation)
            yield k, moved, 1.0 / (len(views) * len(chosen))


def read_out(total: np.ndarray, panel: Panel, optics: Optics) -> np.ndarray:
    """Return the expected photons of every pixel from the share of photons that reaches it: point spread and scatter."""
    if optics.spread_m > 0.0:
        total = gaussian_filter(total, optics.spread_m / panel.pitch_m, mode="nearest")
    if optics.scatter > 0.0:
        total = total + optics.scatter * gaussian_filter(total, optics.scatter_reach_m / panel.pitch_m, mode="nearest", truncate=2.0)
    return optics.photons * total


def exposed(mean: np.ndarray, optics: Optics, rng: np.random.Generator) -> np.ndarray:
    """Draw the (rows, columns) uint16 image of one exposure: Poisson counts, dead pixels, clipped at the panel's 16 bits."""
    image = rng.poisson(mean).astype(float)
    if optics.dead > 0.0:
        struck = rng.random(mean.shape)
        image[struck < 0.5 * optics.dead] = 0.0
        image[(struck >= 0.5 * optics.dead) & (struck < optics.dead)] = np.iinfo(np.uint16).max
    return np.clip(np.round(image), 0, np.iinfo(np.uint16).max).astype(np.uint16)
