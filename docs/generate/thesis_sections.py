"""The sections of the thesis that the map has rows for, and why some have no code of their own.

R. van der Maas, Advanced geometric calibration and control for medical X-ray systems, Eindhoven University of Technology.
"""

from __future__ import annotations

from typing import NamedTuple

CHAPTERS = {
    "2": "Model-based geometric calibration",
    "3": "Nonparametric identification of multivariable systems",
    "4": "Nonparametric identification of parameter-varying systems",
    "5": "Data-driven calibration by observers",
    "6": "Image-based measurement with markers",
    "7": "Reference shaping by time delays",
    "8": "Conclusions and recommendations",
    "B": "3D reconstruction",
}


class Section(NamedTuple):
    """A section, and the first and last number of the equations that stand in it; 0, 0 for none."""

    number: str
    title: str
    first: int = 0
    last: int = 0


SECTIONS = (
    Section("2.1", "Introduction"),
    Section("2.2", "Preliminaries and proposed procedure"),
    Section("2.2.1", "Influence of physical system parameters on 3D reconstruction quality", 1, 3),
    Section("2.2.2", "Currently applied calibration procedure", 4, 5),
    Section("2.2.3", "Proposed model-based calibration estimation"),
    Section("2.3", "Modeling and parameter identification", 6, 6),
    Section("2.3.1", "Kinematic modeling", 7, 12),
    Section("2.3.2", "Modeling of joint compliance", 13, 16),
    Section("2.3.3", "Flexible element modeling"),
    Section("2.3.4", "Parameter identification", 17, 21),
    Section("2.4", "Experimental results"),
    Section("2.4.1", "Parameter identification experiment"),
    Section("2.4.2", "3D Reconstruction validation"),
    Section("2.4.3", "3D Roadmapping overlay validation"),
    Section("2.5", "Conclusions"),
    Section("3.1", "Introduction"),
    Section("3.2", "System description and identification objective"),
    Section("3.2.1", "Interventional X-ray system"),
    Section("3.2.2", "Measurement and identification objective", 1, 7),
    Section("3.3", "Experiment design", 8, 9),
    Section("3.4", "Nonparametric identification approaches using periodic excitations"),
    Section("3.4.1", "Best linear approximation by averaging", 10, 23),
    Section("3.4.2", "Local parametric approach", 24, 48),
    Section("3.5", "Experimental results"),
    Section("3.5.1", "Initial experiment"),
    Section("3.5.2", "Excitation signal optimization"),
    Section("3.5.3", "Final experimental results"),
    Section("3.6", "Conclusion"),
    Section("4.1", "Introduction"),
    Section("4.2", "Problem description"),
    Section("4.2.1", "Linear parameter varying systems", 1, 3),
    Section("4.2.2", "Problem definition"),
    Section("4.3", "nD-LPM for periodic excitation signals"),
    Section("4.3.1", "Local polynomial method", 4, 19),
    Section("4.3.2", "nD local parametric approach for LPV systems", 20, 23),
    Section("4.3.3", "Closed-loop operating conditions", 24, 27),
    Section("4.3.4", "Covariance analysis", 28, 36),
    Section("4.3.5", "Implementation aspects", 37, 38),
    Section("4.4", "nD-LRM for periodic excitation signals", 39, 47),
    Section("4.5", "Arbitrary excitation signals", 48, 51),
    Section("4.6", "System description: medical X-ray system", 52, 54),
    Section("4.7", "Simulation results", 55, 55),
    Section("4.8", "Experimental results"),
    Section("4.9", "Conclusions"),
    Section("5.1", "Introduction"),
    Section("5.2", "Preliminaries and proposed approach"),
    Section("5.2.1", "Geometric calibration and parameters"),
    Section("5.2.2", "Model-based geometric calibration"),
    Section("5.2.3", "Problem description"),
    Section("5.2.4", "Proposed data-driven geometric calibration approach", 1, 3),
    Section("5.3", "Observer design"),
    Section("5.3.1", "Kalman filter", 4, 10),
    Section("5.3.2", "Extended Kalman filter", 11, 14),
    Section("5.3.3", "Unscented Kalman filter", 15, 26),
    Section("5.4", "Parametric modeling for state-estimations"),
    Section("5.4.1", "Parametric modeling", 27, 32),
    Section("5.4.2", "Modeling geometric nonlinearities", 33, 35),
    Section("5.4.3", "Initial parameter estimation", 36, 36),
    Section("5.5", "Experimental results", 37, 38),
    Section("5.6", "Conclusions and recommendations"),
    Section("6.1", "Introduction"),
    Section("6.2", "Problem description and proposed approach"),
    Section("6.2.1", "Problem statement", 1, 2),
    Section("6.2.2", "Proposed approach"),
    Section("6.3", "Image-based marker detection"),
    Section("6.3.1", "Modeling approach: projective geometry", 3, 9),
    Section("6.3.2", "Marker design"),
    Section("6.3.3", "Image processing: line and point detection", 10, 11),
    Section("6.4", "Application for medical imaging"),
    Section("6.4.1", "Case I: direct measurement of geometric parameters"),
    Section("6.4.2", "Case II: proposed image-based observer", 12, 12),
    Section("6.4.3", "Alternative applications"),
    Section("6.5", "Experimental results"),
    Section("6.6", "Conclusions and recommendations"),
    Section("7.1", "Introduction"),
    Section("7.2", "Time-delay filtering for periodic movements"),
    Section("7.2.1", "Second-order systems", 1, 17),
    Section("7.2.2", "General approach", 18, 30),
    Section("7.2.3", "Higher-order systems", 31, 32),
    Section("7.3", "Extensions and special cases"),
    Section("7.3.1", "Systems with zeros", 33, 34),
    Section("7.3.2", "First-order systems"),
    Section("7.3.3", "Robustness", 35, 36),
    Section("7.3.4", "Non-differentiable reference signals", 37, 38),
    Section("7.4", "Practical design case", 39, 40),
    Section("7.5", "Conclusions"),
    Section("8.1", "Conclusions"),
    Section("8.2", "Recommendations for ongoing research"),
    Section("B", "3D reconstruction theory: Radon transformation", 1, 19),
)
"""Chapters 2 to 8 and Appendix B (number "B")."""

ALSO = {
    "2.4.2": ("benchmarks/calibration_carm.py", "hil/reconstruction/wire_profiles.py"),
    "2.4.3": ("benchmarks/calibration_carm.py", "hil/calibration/use/roadmap.py"),
    "3.5": ("benchmarks/identification_sec35.py",),
    "3.5.2": ("hil/identification/design/excitation.py",),
    "4.7": ("benchmarks/identification_sec47.py",),
    "4.8": ("benchmarks/identification_sec48.py",),
    "5.2.1": ("hil/imaging/geometry.py:ConeBeam",),
    "5.2.2": ("hil/calibration/kinematic/geometric_model.py:GeometricModel",),
    "5.5": ("benchmarks/calibration_states.py", "benchmarks/calibration_side_by_side.py"),
    "6.4.2": ("hil/calibration/data_driven/parameter_filter.py",),
    "6.5": ("benchmarks/imaging_markers.py", "benchmarks/imaging_repeats.py"),
    "6.6": ("benchmarks/imaging_patients.py",),
    "7.3.4": ("benchmarks/shapers_figures.py",),
    "7.4": ("benchmarks/shapers_figures.py",),
}
"""Places that implement or repeat a section without naming it: numerical examples and experiments are benchmarks."""

_INTRODUCTION = "motivation and literature; nothing to implement"
_CONCLUSIONS = "conclusions of the chapter; nothing to implement"
_PROBLEM = "statement of the problem; its methods are in the sections that follow"

DECLINED = {
    "2.1": _INTRODUCTION,
    "2.5": _CONCLUSIONS,
    "3.1": _INTRODUCTION,
    "3.5.1": "a first experiment on the thesis's machine; any first multisine takes its place",
    "3.6": _CONCLUSIONS,
    "4.1": _INTRODUCTION,
    "4.2": _PROBLEM,
    "4.2.1": _PROBLEM,
    "4.2.2": _PROBLEM,
    "4.9": _CONCLUSIONS,
    "5.1": _INTRODUCTION,
    "5.2.3": _PROBLEM,
    "5.6": _CONCLUSIONS,
    "6.1": _INTRODUCTION,
    "6.2": _PROBLEM,
    "6.2.1": _PROBLEM,
    "6.2.2": "outline of the approach; its parts are Secs. 6.3 and 6.4",
    "7.1": _INTRODUCTION,
    "7.5": _CONCLUSIONS,
}
"""Section to the reason why no code is its implementation."""
