"""The rigid-body equations of a tree as expressions: joint-space inertia and bias, motion of points, poses of bodies.

Recursive Newton-Euler and composite-rigid-body algorithms (Featherstone 2008, Secs. 5.3 and 6.2), written with three-dimensional vectors in
the bodies' own frames. Notation: R rotation from body to parent, r origin of the body in its parent's frame, s joint axis, ω and α angular
velocity and acceleration, a linear acceleration of the body's origin less gravity, m mass, h first moment of mass and J inertia about the
body's origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from virtual_bus.plant import vectors
from virtual_bus.plant.parameters import AXES, INERTIA_ENTRIES
from virtual_bus.plant.symbols import Graph, Node
from virtual_bus.plant.vectors import Matrix, Vector
from virtual_bus.settings import Body, Imu, PlantSettings

WORLD = -1
ROUNDING = 1e-15  # entries of a rotation this close to 0 or ±1 are meant to be it: cos(90 deg) is not exactly 0 in floating point


@dataclass(frozen=True)
class Link:
    """One moving body with everything welded to it. Link i moves with joint i."""

    parent: int
    is_revolute: bool
    axis: Vector  # s
    rotation: Matrix  # R(q)
    origin: Vector  # r(q)
    mass: Node
    moment: Vector  # h
    inertia: Matrix  # J


@dataclass(frozen=True)
class Placement:
    """Where a body's frame stands in the link that carries it."""

    link: int
    rotation: Matrix
    origin: Vector


@dataclass(frozen=True)
class Motion:
    """Motion of a link's frame, in the link's frame."""

    omega: Vector
    alpha: Vector
    acceleration: Vector  # of the origin, less gravity: what an accelerometer there feels


def clean_rotation(rotation: np.ndarray) -> np.ndarray:
    """Return the rotation with entries that are 0 or ±1 up to rounding made exactly so."""
    nearest = np.round(rotation)
    return np.where(np.abs(rotation - nearest) < ROUNDING, nearest, rotation)


class PlantEquations:
    """Expressions of one plant. Inputs: `q[i]`, `v[i]`, `a[i]` per joint and `p[k]` per parameter, in the order of `parameter_names`."""

    def __init__(self, settings: PlantSettings, parameter_names: tuple[str, ...]) -> None:
        self.graph = Graph()
        self.settings = settings
        self._index = {name: k for k, name in enumerate(parameter_names)}
        joints = settings.tree.joints
        self.positions = [self.graph.input(f"q[{i}]") for i in range(len(joints))]
        self.speeds = [self.graph.input(f"v[{i}]") for i in range(len(joints))]
        self.accelerations = [self.graph.input(f"a[{i}]") for i in range(len(joints))]
        self.links: list[Link] = []
        self.placements: dict[str, Placement] = {"world": Placement(WORLD, *self._at_rest())}
        self._gravity = self._parameter_vector("gravity", "", "m_s2")
        self._build_links()

    # ---- parameters ------------------------------------------------------------------------------------------------------------

    def parameter(self, name: str) -> Node:
        """Return the run-time parameter of that name, or a structural zero when the plant has none."""
        return self.graph.input(f"p[{self._index[name]}]", is_parametric=True) if name in self._index else self.graph.zero

    def _parameter_vector(self, owner: str, quantity: str, unit: str) -> Vector:
        prefix = f"{owner}.{quantity}_" if quantity else f"{owner}."
        x, y, z = (self.parameter(f"{prefix}{letter}_{unit}") for letter in AXES)
        return x, y, z

    def _at_rest(self) -> tuple[Matrix, Vector]:
        return vectors.constant_matrix(self.graph, np.eye(3)), vectors.constant_vector(self.graph, np.zeros(3))

    # ---- the tree -----------------------------------------------------------------------------------------------------------------

    def _build_links(self) -> None:
        for body in self.settings.tree.bodies:
            parent = self.placements[body.parent]
            orientation = vectors.constant_matrix(self.graph, clean_rotation(body.orientation))
            position = self._parameter_vector(body.name, "position", "m")
            rotation = vectors.product(parent.rotation, orientation)
            origin = vectors.add(parent.origin, vectors.apply(parent.rotation, position))
            mass, moment, inertia = self._body_inertia(body)
            if body.joint is None:
                self.placements[body.name] = Placement(parent.link, rotation, origin)
                if parent.link != WORLD:
                    self._weld(parent.link, rotation, origin, mass, moment, inertia)
                continue
            number = len(self.links)
            q = self.positions[number]
            axis = vectors.constant_vector(self.graph, clean_rotation(body.joint.axis))
            if body.joint.kind == "revolute":
                rotation = vectors.product(rotation, self._turn(axis, q))
            else:
                origin = vectors.add(origin, vectors.apply(rotation, vectors.scale(q, axis)))
            self.links.append(Link(parent.link, body.joint.kind == "revolute", axis, rotation, origin, mass, moment, inertia))
            self.placements[body.name] = Placement(number, *self._at_rest())

    def _turn(self, s: Vector, angle: Node) -> Matrix:
        """Return the rotation about axis s by Rodrigues' formula, cos I + (1 − cos) s sᵀ + sin [s].

        It is arranged so that a coordinate axis leaves exact ones and zeros.
        """
        cos, sin = self.graph.cos(angle), self.graph.sin(angle)
        versine = 1.0 - cos

        def diagonal(i: int) -> Node:
            return s[i] * s[i] + cos * (1.0 - s[i] * s[i])

        def off_diagonal(i: int, j: int, signed: Node) -> Node:
            return versine * (s[i] * s[j]) + sin * signed

        return (
            (diagonal(0), off_diagonal(0, 1, -s[2]), off_diagonal(0, 2, s[1])),
            (off_diagonal(1, 0, s[2]), diagonal(1), off_diagonal(1, 2, -s[0])),
            (off_diagonal(2, 0, -s[1]), off_diagonal(2, 1, s[0]), diagonal(2)),
        )

    def _body_inertia(self, body: Body) -> tuple[Node, Vector, Matrix]:
        """Return mass, first moment and inertia of one body about its own origin."""
        zero = self.graph.zero
        mass = self.parameter(f"{body.name}.mass_kg")
        center = self._parameter_vector(body.name, "center_of_mass", "m")
        entry = {label: self.parameter(f"{body.name}.inertia_{label}_kg_m2") for label, _, _ in INERTIA_ENTRIES}
        about_center = (
            (entry["xx"], entry["xy"], entry["xz"]),
            (entry["xy"], entry["yy"], entry["yz"]),
            (entry["xz"], entry["yz"], entry["zz"]),
        )
        inertia = vectors.shifted_inertia(about_center, mass, (zero, zero, zero), center)
        return mass, vectors.scale(mass, center), inertia

    def _weld(self, number: int, rotation: Matrix, origin: Vector, mass: Node, moment: Vector, inertia: Matrix) -> None:
        link = self.links[number]
        moved = _seen_from_parent(rotation, origin, mass, moment, inertia)
        self.links[number] = Link(
            link.parent, link.is_revolute, link.axis, link.rotation, link.origin,
            link.mass + moved[0], vectors.add(link.moment, moved[1]), vectors.add_matrices(link.inertia, moved[2]),
        )  # fmt: skip

    # ---- motion -------------------------------------------------------------------------------------------------------------------

    def motions(self, with_accelerations: bool) -> list[Motion]:
        """Return the motion of every link; without joint accelerations, its part from speeds and gravity."""
        rest = vectors.constant_vector(self.graph, np.zeros(3))
        base = Motion(rest, rest, vectors.scale(-self.graph.one, self._gravity))
        motions: list[Motion] = []
        for i, link in enumerate(self.links):
            parent = base if link.parent == WORLD else motions[link.parent]
            r, s, v = link.origin, link.axis, self.speeds[i]
            omega = vectors.apply_transposed(link.rotation, parent.omega)
            alpha = vectors.apply_transposed(link.rotation, parent.alpha)
            centripetal = vectors.cross(parent.omega, vectors.cross(parent.omega, r))
            acceleration = vectors.apply_transposed(
                link.rotation, vectors.add(parent.acceleration, vectors.cross(parent.alpha, r), centripetal)
            )
            joint_speed = vectors.scale(v, s)
            coriolis = vectors.cross(omega, joint_speed)
            joint_acceleration = vectors.scale(self.accelerations[i], s) if with_accelerations else rest
            if link.is_revolute:
                alpha = vectors.add(alpha, coriolis, joint_acceleration)
                omega = vectors.add(omega, joint_speed)
            else:
                acceleration = vectors.add(acceleration, vectors.scale(self.graph.constant(2.0), coriolis), joint_acceleration)
            motions.append(Motion(omega, alpha, acceleration))
        return motions

    def bias(self) -> list[Node]:
        """Return the joint effort that gravity and velocities ask for at zero joint accelerations (recursive Newton-Euler)."""
        motions = self.motions(with_accelerations=False)
        forces: list[Vector] = []
        moments: list[Vector] = []
        for link, motion in zip(self.links, motions, strict=True):
            w, h = motion.omega, link.moment
            force = vectors.add(
                vectors.scale(link.mass, motion.acceleration),
                vectors.cross(motion.alpha, h),
                vectors.cross(w, vectors.cross(w, h)),
            )
            moment = vectors.add(
                vectors.apply(link.inertia, motion.alpha),
                vectors.cross(w, vectors.apply(link.inertia, w)),
                vectors.cross(h, motion.acceleration),
            )
            forces.append(force)
            moments.append(moment)
        efforts = [self.graph.zero] * len(self.links)
        for i in reversed(range(len(self.links))):
            link = self.links[i]
            efforts[i] = vectors.dot(link.axis, moments[i] if link.is_revolute else forces[i])
            if link.parent != WORLD:
                force, moment = _wrench_in_parent(link, forces[i], moments[i])
                forces[link.parent] = vectors.add(forces[link.parent], force)
                moments[link.parent] = vectors.add(moments[link.parent], moment)
        return efforts

    def inertia(self) -> dict[tuple[int, int], Node]:
        """Return the joint-space inertia M(q), armature included (composite rigid bodies).

        Its entries are (i, j) with j <= i; those that are absent are zero.
        """
        mass = [link.mass for link in self.links]
        moment = [link.moment for link in self.links]
        inertia = [link.inertia for link in self.links]
        entries: dict[tuple[int, int], Node] = {}
        for i in reversed(range(len(self.links))):
            link = self.links[i]
            if link.is_revolute:
                force, torque = vectors.cross(link.axis, moment[i]), vectors.apply(inertia[i], link.axis)
            else:
                force, torque = vectors.scale(mass[i], link.axis), vectors.cross(moment[i], link.axis)
            entries[i, i] = vectors.dot(link.axis, torque if link.is_revolute else force) + self._armature(i)
            below, j = link, link.parent
            while j != WORLD:
                force, torque = _wrench_in_parent(below, force, torque)
                below = self.links[j]
                entries[i, j] = vectors.dot(below.axis, torque if below.is_revolute else force)
                j = below.parent
            if link.parent != WORLD:
                moved = _seen_from_parent(link.rotation, link.origin, mass[i], moment[i], inertia[i])
                mass[link.parent] = mass[link.parent] + moved[0]
                moment[link.parent] = vectors.add(moment[link.parent], moved[1])
                inertia[link.parent] = vectors.add_matrices(inertia[link.parent], moved[2])
        return entries

    def _armature(self, i: int) -> Node:
        joint = self.settings.tree.joints[i]
        return self.parameter(f"{joint.name}.armature_{'kg_m2' if joint.kind == 'revolute' else 'kg'}")

    # ---- points and poses -----------------------------------------------------------------------------------------------------------

    def imu(self, imu: Imu) -> list[Node]:
        """Return specific force and angular rate (6 expressions) in the sensor's frame.

        They depend on joint positions, speeds and accelerations.
        """
        placement = self.placements[imu.body]
        rotation = vectors.product(placement.rotation, vectors.constant_matrix(self.graph, clean_rotation(imu.orientation)))
        if placement.link == WORLD:
            rest = vectors.constant_vector(self.graph, np.zeros(3))
            motion = Motion(rest, rest, vectors.scale(-self.graph.one, self._gravity))
        else:
            motion = self.motions(with_accelerations=True)[placement.link]
        sensor = self._parameter_vector(imu.name, "position", "m")
        r = vectors.add(placement.origin, vectors.apply(placement.rotation, sensor))
        force = vectors.add(
            motion.acceleration, vectors.cross(motion.alpha, r), vectors.cross(motion.omega, vectors.cross(motion.omega, r))
        )
        return [*vectors.apply_transposed(rotation, force), *vectors.apply_transposed(rotation, motion.omega)]

    def pose(self, body: str) -> list[Node]:
        """Return position (3) and rotation by rows (9) of a body's frame in the world."""
        placement = self.placements[body]
        rotation, origin = placement.rotation, placement.origin
        number = placement.link
        while number != WORLD:
            link = self.links[number]
            rotation = vectors.product(link.rotation, rotation)
            origin = vectors.add(link.origin, vectors.apply(link.rotation, origin))
            number = link.parent
        return [*origin, *rotation[0], *rotation[1], *rotation[2]]


def _wrench_in_parent(link: Link, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
    """Return a force and moment about the link's origin, in the parent's frame and about the parent's origin."""
    force = vectors.apply(link.rotation, force)
    return force, vectors.add(vectors.apply(link.rotation, moment), vectors.cross(link.origin, force))


def _seen_from_parent(rotation: Matrix, origin: Vector, mass: Node, moment: Vector, inertia: Matrix) -> tuple[Node, Vector, Matrix]:
    """Return mass, first moment and inertia of a body, in the frame and about the origin of what it is attached to."""
    turned = vectors.apply(rotation, moment)
    shifted = vectors.shifted_inertia(vectors.congruence(rotation, inertia), mass, turned, origin)
    return mass, vectors.add(turned, vectors.scale(mass, origin)), shifted
