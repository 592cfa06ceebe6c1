"""One row of a live calibration, compiled: the nominal geometry at the row's pose, the effect of each parameter there, and the sum.

The numbers are those of `QuasiStatic.rows` (a test in tests/hil/calibration compares the two), in microseconds instead of two milliseconds.
"""

from __future__ import annotations

import numpy as np

from controllers.compiled import exactly_called, exactly_compiled
from hil.imaging.nominal import body_frame, imaging_geometry, nominal_beam
from hil.machine import Machine


def chain_of(machine: Machine) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the axes, a point on each, and panel and focal spot, all at position zero in the world.

    Axes (n, 3); points (n, 3) from the isocentre [m]; (5, 3): the panel's axes by rows, its centre, the focal spot, from the isocentre.
    """
    geometry = imaging_geometry(machine)
    bodies = {each.joint.name: each for each in machine.plant.tree.bodies if each.joint is not None}
    zero = np.zeros((1, len(machine.axes)))
    axes, points = np.zeros((len(machine.axes), 3)), np.zeros((len(machine.axes), 3))
    for k, drive in enumerate(machine.plant.drives):
        body = bodies[drive.joint]
        assert body.joint is not None
        origin, rotation = body_frame(machine, body.name, zero)
        axes[k], points[k] = rotation[0] @ body.joint.axis, origin[0] - geometry.isocenter_m
    still = nominal_beam(machine, zero)
    ends = np.vstack([still.rotation[0].T, still.detector_in_phantom_m, still.source_in_phantom_m])
    return axes, points, np.ascontiguousarray(ends)


@exactly_called
def _turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return the rotation (3, 3) about a unit vector, by Rodrigues' formula."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    v = 1.0 - c
    return np.array([
        [c + x * x * v, x * y * v - z * s, x * z * v + y * s],
        [y * x * v + z * s, c + y * y * v, y * z * v - x * s],
        [z * x * v - y * s, z * y * v + x * s, c + z * z * v],
    ])  # fmt: skip


@exactly_called
def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Multiply (3, 3) by (3, n)."""
    out = np.zeros((3, b.shape[1]))
    for i in range(3):
        for j in range(b.shape[1]):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return out


@exactly_called
def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@exactly_called
def _turn_vector(rotation: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) of a small rotation (3, 3)."""
    s = 0.5 * np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    sine = np.sqrt(s[0] ** 2 + s[1] ** 2 + s[2] ** 2)
    if sine < 1e-12:
        return s
    turned: np.ndarray = s * (np.arctan2(sine, 0.5 * (rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1.0)) / sine)
    return turned


@exactly_compiled
def pose_rows(
    axes: np.ndarray,
    points: np.ndarray,
    ends: np.ndarray,
    gravity: np.ndarray,
    positions: np.ndarray,
    rows: np.ndarray,
    nominal: np.ndarray,
) -> None:
    """Compute the effect of each parameter at axis positions (n,), and the geometry there.

    Parameters
    ----------
    axes, points, ends
        Of `chain_of`.
    gravity : (3,) array
        In the world, over its size.
    rows : (9, p) array
        Overwritten: change of the nine deviations with each parameter, in `QuasiStatic`'s order.
    nominal : (6, 3) array
        Overwritten: the panel's axes in the world by columns, focal spot and isocentre in the panel's frame, gravity in it.
    """
    n = len(positions)
    rotation, shift = np.eye(3), np.zeros((3, 1))
    inner = np.zeros((n, 3, 3))
    for k in range(n):
        turn = _turn(axes[k], positions[k])
        point = points[k].copy().reshape(3, 1)
        shift = shift + _product(rotation, point - _product(turn, point))
        rotation = _product(rotation, turn)
        inner[k] = rotation
    panel = _product(rotation, ends[:3].T.copy())
    center = _product(rotation, ends[3].copy().reshape(3, 1)) + shift
    source = _product(rotation, ends[4].copy().reshape(3, 1)) + shift
    back = panel.T.copy()
    to_source, to_isocenter = _product(back, source - center)[:, 0], -_product(back, center)[:, 0]
    down = _product(back, gravity.copy().reshape(3, 1))[:, 0]
    nominal[:3], nominal[3], nominal[4], nominal[5] = panel, to_source, to_isocenter, down
    rows[:] = 0.0
    # tube and panel together: a shift takes the isocentre the other way, a turn about it turns the panel
    c, s = np.cos(positions[0]), np.sin(positions[0])
    for j in range(3):
        for i in range(3):
            along = back[i, j]
            rows[3 + i, j], rows[6 + i, 3 + j] = -along, along
            rows[3 + i, 6 + j], rows[6 + i, 9 + j] = -along * c, along * c
            rows[3 + i, 12 + j], rows[6 + i, 15 + j] = -along * s, along * s
    first = 18
    for k in range(n - 1):
        seen = _product(back, inner[k])
        for j in range(3):
            for i in range(3):
                rows[3 + i, first + j], rows[6 + i, first + 3 + j] = -seen[i, j], seen[i, j]
        first += 6
    # the panel alone, about its own centre; then the same by gravity's three components
    for j in range(3):
        unit = np.zeros(3)
        unit[j] = 1.0
        of_source, of_isocenter = -_cross(unit, to_source), -_cross(unit, to_isocenter)
        for i in range(3):
            for g in range(4):
                share, place = (1.0 if g == 0 else down[g - 1]), first + 6 * g
                rows[i, place + j] = rows[3 + i, place + j] = -unit[i] * share
                rows[i, place + 3 + j] = of_source[i] * share
                rows[3 + i, place + 3 + j] = of_isocenter[i] * share
                rows[6 + i, place + 3 + j] = unit[i] * share
    first += 24
    for j in range(3):
        for g in range(4):
            rows[j, first + 3 * g + j] = 1.0 if g == 0 else down[g - 1]


@exactly_compiled
def deviation_from_nominal(ends: np.ndarray, nominal: np.ndarray, estimate: np.ndarray, out: np.ndarray) -> None:
    """Compute the nine deviations (9,) of an observer's estimate (9,) from the geometry that `pose_rows` left in `nominal`.

    The observer's orientation (extrinsic x, y, z angles) is of the detector's frame at position zero, here it is of the world's.
    """
    x, y, z = estimate[6], estimate[7], estimate[8]
    about_x, about_y, about_z = (
        _turn(np.array([1.0, 0.0, 0.0]), x),
        _turn(np.array([0.0, 1.0, 0.0]), y),
        _turn(np.array([0.0, 0.0, 1.0]), z),
    )
    world = _product(ends[:3].T.copy(), _product(about_z, _product(about_y, about_x)))
    for i in range(3):
        out[i] = estimate[i] - nominal[3, i]
        out[3 + i] = estimate[3 + i] - nominal[4, i]
    out[6:9] = _turn_vector(_product(nominal[:3].T.copy(), world))


@exactly_compiled
def published(
    rows: np.ndarray,
    first: int,
    x: np.ndarray,
    covariance: np.ndarray,
    kept: float,
    renewed: np.ndarray,
    fast: np.ndarray,
    out: np.ndarray,
    together: np.ndarray,
) -> None:
    """Compute a row's deviations and variances (18,): parameters, faded error of the displacement, observer's fast part.

    Parameters
    ----------
    rows : (9, p) array
    first : int
        Column of the detector's own six offsets: its displacement moves the geometry as they do.
    x, covariance : (p + 6,), (p + 6, p + 6) arrays
        Of the filter, at its last image.
    kept : float
        Share of the displacement's error then that is left.
    renewed : (6,) array
        Variances of what has come to it since.
    fast : (9,) array
    together : (9, 9) array
        Overwritten: the deviations' covariance.
    """
    size = rows.shape[1]
    gradient, spread = np.zeros((9, size + 6)), np.zeros(size + 6)
    for i in range(9):
        for a in range(size):
            gradient[i, a] = rows[i, a]
        for j in range(6):
            gradient[i, size + j] = kept * rows[i, first + j]
    for i in range(9):
        value = fast[i]
        for a in range(size + 6):
            value += gradient[i, a] * x[a]
            spread[a] = 0.0
        for b in range(size + 6):
            if gradient[i, b] != 0.0:
                for a in range(size + 6):
                    spread[a] += covariance[a, b] * gradient[i, b]
        for k in range(i + 1):
            both = 0.0
            for j in range(6):
                both += rows[i, first + j] * rows[k, first + j] * renewed[j]
            for a in range(size + 6):
                both += gradient[k, a] * spread[a]
            together[i, k] = together[k, i] = both
        out[i], out[9 + i] = value, together[i, i]
