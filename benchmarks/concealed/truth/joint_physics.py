"""Physics at a joint, in equations of the benchmark's own. One row of the effects table is one effect.

A row has a kind, the joint it acts on (`dof`), another joint where the kind needs one, parameters `p` and states `z`. `add_efforts` is
called once a step at the step's middle: positions and speeds there, accelerations of the step before. With h = 0 it gives the static
efforts.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

PARAMETERS, STATES = 16, 16

# Friction laws: p = [law, travel, elements, level parameters...]; sliding levels on Prandtl elements (Maxwell slip).
FRICTION = 1
CONSTANT_LEVEL, BY_DIRECTION, ARCTANGENT, BY_LOAD, BY_POSITION, WEAR, WINDOW, BY_OTHER_SPEED, BY_ACCELERATION = range(9)
VISCOUS, DRAG, WARMING = 2, 3, 4
IMBALANCE, HOSE, LOAD, SHAKE, COGGING = 5, 6, 7, 8, 9
CONTACT_GAP, PIECEWISE_SPRING, ADDED_MODE, STOP = 10, 11, 12, 13
COUPLING, POSE_INERTIA, TRANSMISSION = 14, 15, 16
TIME_GAIN, SLOSH, PULSE, MAGNETIC, RELAXATION, FOLDBACK, PARAMETRIC = 20, 21, 22, 23, 24, 25, 26

KNOTS = 48
"""Knots per period of tabulated ripple."""


@njit(cache=True)
def tabulated(turns, a1, phi1, a2, phi2, a3):
    """A periodic table of KNOTS values, linear between them."""
    x = (turns - math.floor(turns)) * KNOTS
    left = math.floor(x)
    value = 0.0
    for side in range(2):
        angle = 2.0 * math.pi * (left + side) / KNOTS
        weight = x - left if side else 1.0 - (x - left)
        value += weight * (a1 * math.cos(angle + phi1) + a2 * math.cos(2.0 * angle + phi2) + a3 * math.cos(3.0 * angle))
    return value


@njit(cache=True)
def slip(z, travel, elements, step):
    """Share of the sliding level that the elements carry, -1 to 1; their travels are spread evenly about `travel`."""
    total = 0.0
    for i in range(elements):
        reach = travel * (2.0 * i + 1.0) / elements
        z[i] = min(max(z[i] + step, -reach), reach)
        total += z[i] / reach
    return total / elements


@njit(cache=True)
def friction(dof, other, p, z, q, v, a, t, h, load):
    law, elements = int(p[0]), int(p[2])
    share = slip(z, p[1], elements, h * v[dof])
    speed = abs(v[dof])
    if law == CONSTANT_LEVEL:
        level = p[3]
    elif law == BY_DIRECTION:
        level = p[3] + p[4] * speed if share > 0.0 else p[5] + p[6] * speed
    elif law == ARCTANGENT:
        scale = p[4] if share > 0.0 else p[4] * p[5]
        level = p[3] * (1.0 - 2.0 / math.pi * math.atan((speed / scale) ** 1.5))
    elif law == BY_LOAD:
        level = p[3] * math.sqrt(load * load + p[4] * p[4])
    elif law == BY_POSITION:
        level = max(0.0, 0.5 * p[3] * (1.0 + tabulated(p[4] * q[dof] / (2.0 * math.pi), 1.0, p[5], 0.0, 0.0, p[6])))
    elif law == WEAR:
        z[STATES - 1] += h * speed
        level = p[3] * (1.0 - math.exp(-z[STATES - 1] / p[4]))
    elif law == WINDOW:
        level = p[3] if p[4] < t < p[5] else 0.0
    elif law == BY_OTHER_SPEED:
        level = p[3] * abs(v[other])
    else:
        z[STATES - 1] += min(1.0, h / p[4]) * (abs(a[dof]) - z[STATES - 1])
        level = p[3] * z[STATES - 1]
    return -level * share


@njit(cache=True)
def contact(depth, rate, stiffness, restitution):
    """Hunt and Crossley 1975: a contact whose loss grows with depth and which never pulls."""
    if depth <= 0.0:
        return 0.0
    return max(0.0, stiffness * depth * (1.0 + restitution * rate))


@njit(cache=True)
def flank(depth, rate, stiffness, restitution, half_gap):
    """A contact whose loss grows no deeper than half the gap is wide: it goes to nothing with the gap, also under a preload."""
    if depth <= 0.0:
        return 0.0
    return max(0.0, stiffness * (depth + min(depth, half_gap) * restitution * rate))


@njit(cache=True)
def spring_and_damper(ahead, rate, mass, stiffness, damping, h):
    """Pull of a mass that is carried along, in the step's middle, by the midpoint rule: `rate` is the step's first. The spring is as much
    stiffer as makes the rule's frequency the mass's own.
    """
    half = 0.5 * h * math.sqrt(stiffness / mass)
    warped = stiffness * (math.tan(half) / half) ** 2 if half > 0.0 else stiffness
    return (warped * ahead + damping * rate) / (1.0 + 0.25 * h * h * warped / mass + 0.5 * h * damping / mass)


@njit(cache=True)
def carried(z, deceleration, h):
    """Move a mass, z its place and speed, over a step by the deceleration in its middle (leapfrog)."""
    z[0] += h * (z[1] - 0.5 * h * deceleration)
    z[1] -= h * deceleration


@njit(cache=True)
def add_efforts(kinds, dofs, others, parameters, states, q, v, a, t, h, load, drive, applied, armature):
    """Add every effect's efforts at its joints; write the inertias that vary with pose to `armature`."""
    for e in range(kinds.shape[0]):
        kind, j, o, p, z = kinds[e], dofs[e], others[e], parameters[e], states[e]
        if kind == FRICTION:
            applied[j] += friction(j, o, p, z, q, v, a, t, h, load[j])
        elif kind == VISCOUS:
            applied[j] -= p[0] * v[j] * (1.0 - p[1] * abs(v[j]))
        elif kind == DRAG:
            applied[j] -= p[0] * math.copysign(abs(v[j]) ** p[1], v[j])
        elif kind == WARMING:  # two thermal masses: film and housing; a fluid whose fluidity grows linearly
            force = p[0] / (1.0 + p[1] * z[0]) * v[j]
            z[0] += h * (p[2] * force * v[j] - (z[0] - z[1])) / p[3]
            z[1] += h * (p[4] * (z[0] - z[1]) - z[1]) / p[5]
            applied[j] -= force
        elif kind == IMBALANCE:
            applied[j] -= p[0] * (math.sin(q[j] + p[1]) + p[2] * math.sin(3.0 * q[j]))
        elif kind == HOSE:
            x = (q[j] - p[2]) / p[1]
            applied[j] -= p[0] * p[1] * math.sinh(min(max(x, -5.0), 5.0)) if p[3] == 0.0 or p[3] * x > 0.0 else 0.0
        elif kind == LOAD:
            applied[j] += p[0] * (1.0 + p[1] * math.exp(-t / 8.0))
        elif kind == SHAKE:
            angle = 2.0 * math.pi * p[1] * t + p[2]
            applied[j] += p[0] * (math.sin(angle) + p[3] * math.sin(2.0 * angle))
        elif kind == COGGING:
            applied[j] += tabulated(p[0] * q[j] / (2.0 * math.pi), p[1], p[2], p[3], p[4], p[5])
        elif kind == CONTACT_GAP:  # p: stiffness and damping of the spring that is there, half the gap, loss
            x, w = q[j] - p[4], v[j]
            applied[j] += p[0] * x - flank(x - p[2], w, p[0], p[3], p[2]) + flank(-x - p[2], -w, p[0], p[3], p[2])
        elif kind == PIECEWISE_SPRING:
            x = q[j] - p[2]
            applied[j] -= p[0] * (max(0.0, x - p[1]) + min(0.0, x + p[1]))
        elif kind == ADDED_MODE:  # z: how far the added inertia is ahead of the joint's start, and its speed
            pull = spring_and_damper(z[0] + 0.5 * h * z[1] - (q[j] - z[2]), z[1] - v[j], p[0], p[1], p[2], h)
            carried(z, pull / p[0], h)
            applied[j] += pull
        elif kind == STOP:
            applied[j] -= p[3] * contact(p[3] * (q[j] - p[0]), p[3] * v[j], p[1], p[2])
        elif kind == COUPLING:
            bend = p[0] * (math.cos(q[o] + p[1]) + p[2] * math.cos(2.0 * q[o]))
            slope = -p[0] * (math.sin(q[o] + p[1]) + 2.0 * p[2] * math.sin(2.0 * q[o]))
            applied[j] -= bend * a[o] + slope * v[o] * v[o]
            applied[o] -= bend * a[j]
        elif kind == POSE_INERTIA:
            extra = p[0] * (0.5 * (1.0 + math.cos(q[o] + p[1])) + p[2] * (1.0 - math.cos(2.0 * q[o])))
            slope = p[0] * (-0.5 * math.sin(q[o] + p[1]) + 2.0 * p[2] * math.sin(2.0 * q[o]))
            armature[j] = p[3] + extra
            applied[j] -= slope * v[o] * v[j]
            applied[o] += 0.5 * slope * v[j] * v[j]
        elif kind == TRANSMISSION:  # j is the spring behind o; p: stiffness, damping, cycles, amplitudes
            turns, small = p[2] * q[o] / (2.0 * math.pi), 1e-4
            rest = tabulated(turns, p[3], p[4], p[5], p[6], 0.0)
            slope = (tabulated(turns + small, p[3], p[4], p[5], p[6], 0.0) - rest) / small * p[2] / (2.0 * math.pi)
            pull = p[0] * rest + p[1] * slope * v[o]
            applied[j] += pull
            applied[o] += slope * (p[0] * (q[j] - rest) + p[1] * (v[j] - slope * v[o]))
        elif kind == TIME_GAIN:
            applied[j] += drive[j] * p[0] * math.sin(2.0 * math.pi * t / p[1])
        elif kind == SLOSH:  # a swinging mass whose spring softens like a pendulum's, with quadratic damping
            spring = p[1] * p[1] * p[2] * math.sin((z[0] + 0.5 * h * z[1] - (q[j] - z[2])) / p[2])
            rate = z[1] - v[j]
            rate -= 0.5 * h * (spring + p[3] * rate * abs(rate))
            pull = p[0] * (spring + p[3] * rate * abs(rate))
            carried(z, pull / p[0], h)
            applied[j] += pull
        elif kind == PULSE:  # set off by passing a position upwards
            z[1] *= math.exp(-h / p[2])
            if z[0] < p[0] <= q[j] and h > 0.0:
                z[1] = 1.0
            z[0] = q[j]
            applied[j] += p[1] * z[1]
        elif kind == MAGNETIC:  # part of the effort follows the current through a play
            z[0] = min(max(z[0], drive[j] - p[1]), drive[j] + p[1])
            applied[j] += p[0] * (z[0] - drive[j])
        elif kind == RELAXATION:
            z[0] += h * (v[j] - z[0] / p[1])
            applied[j] -= p[0] * z[0]
        elif kind == FOLDBACK:  # a drive that gives less for a while after it gave much
            z[0] = p[2] if abs(drive[j]) > p[1] else max(0.0, z[0] - h)
            z[1] += min(1.0, h / 0.02) * ((1.0 if z[0] > 0.0 else 0.0) - z[1])
            applied[j] -= p[0] * z[1] * drive[j]
        elif kind == PARAMETRIC:
            applied[j] -= p[0] * math.sin(2.0 * math.pi * p[1] * t) * q[j]


def standing_states(kinds, dofs, states, q, drive):
    """States of a machine that has stood at q under `drive`: bristles unbent, added masses at rest, memories filled."""
    start = np.zeros_like(states)
    for e, kind in enumerate(kinds):
        if kind in (ADDED_MODE, SLOSH):
            start[e, 2] = q[dofs[e]]
        elif kind == PULSE:
            start[e, 0] = q[dofs[e]]
        elif kind == MAGNETIC:
            start[e, 0] = drive[dofs[e]]
    return start


def static_efforts(kinds, dofs, others, parameters, q, load, drive):
    """Efforts on every joint of a machine that stands at q, before anything shakes it."""
    zero, applied, armature = np.zeros_like(q), np.zeros_like(q), np.zeros_like(q)
    calm = parameters.copy()
    calm[kinds == SHAKE, 0] = 0.0
    states = standing_states(kinds, dofs, np.zeros((len(kinds), STATES)), q, drive)
    add_efforts(kinds, dofs, others, calm, states, q, zero, zero, 0.0, 0.0, load, drive, applied, armature)
    return applied
