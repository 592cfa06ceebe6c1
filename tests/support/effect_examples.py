"""One effect of every name on the C-arm, of a strength that shows, and a motion along which it does."""

from __future__ import annotations

import numpy as np

from hil.simulation import Inputs
from virtual_bus.settings import EffectSetting

POSE = np.radians([10.0, -20.0])
ROWS = 384

EXAMPLES = {
    setting.name: setting
    for setting in (
        EffectSetting("added_inertia", "roll", {"J": 12.0}),
        EffectSetting("asymmetric_friction", "roll", {"Fc_plus": 10.0, "Fc_minus": 4.0, "Fv_plus": 20.0, "Fv_minus": 5.0}),
        EffectSetting("axis_coupling", "propeller", {"J12": 20.0, "phi": 0.3}),
        EffectSetting("backlash", "roll", {"b": 1e-4, "flank": 0.0}),
        EffectSetting("base_motion", "ceiling_mount", {"A": 400.0, "f": 11.0, "phi": 0.4}),
        EffectSetting("bouc_wen_hysteresis", "roll", {"k": 500.0, "A": 1.0, "z_max": 0.01, "beta_share": 0.6, "n": 1.5}),
        EffectSetting("cable_spring", "propeller", {"kc": 120.0, "kc3": 300.0, "theta0": -0.2}),
        EffectSetting("clock_offset", "imu", {"t0": 0.006, "delta": 1e-3}),
        EffectSetting("cogging", "roll", {"Np": 0.1, "A1": 6.0, "phi1": 0.2, "A2": 3.0, "phi2": 0.0}),
        EffectSetting("constant_load", "roll", {"tau0": 15.0}),
        EffectSetting("coulomb_friction", "roll", {"Fc": 8.0}),
        EffectSetting("creep", "roll", {"k1": 400.0, "tau": 0.5}),
        EffectSetting("current_saturation", "roll", {"imax": 2.0, "droop": 3.0}),
        EffectSetting("delay", "roll", {"Td": 0.0063}),
        EffectSetting("drive_bandwidth", "propeller", {"fc": 60.0, "zeta": 0.8}),
        EffectSetting("encoder_eccentricity", "position_roll", {"a": 2e-4, "phi": 0.3, "b": 1e-5, "Nl": 40.0}),
        EffectSetting("encoder_quantization", "position_roll", {"q": 2e-4}),
        EffectSetting("end_stop", "roll", {"K": 2e4, "D": 50.0, "at_position": -0.37, "side": -1.0}),
        EffectSetting("gear_ratio", "roll", {"beta": 0.01}),
        EffectSetting("gravity_imbalance", "propeller", {"mgr": 60.0, "phi": 0.2}),
        EffectSetting("imu_bandwidth", "imu", {"fc": 15.0, "shape": 0.3}),
        EffectSetting("imu_misalignment", "imu", {"rx": 0.02, "ry": -0.01, "rz": 0.03}),
        EffectSetting(
            "imu_scale_bias", "imu", {"sx": 0.01, "sy": 0.0, "sz": -0.02, "bx": 0.1, "by": 0.0, "bz": 0.0, "sg": 0.01, "bg": 0.002}
        ),
        EffectSetting("joint_compliance", "roll", {"c": 2e-6, "d": 20.0}),
        EffectSetting("load_dependent_friction", "roll", {"Kl": 0.05}),
        EffectSetting("motor_load_friction", "roll", {"Km": 0.05}),
        EffectSetting("nonlinear_stiffness", "propeller", {"k3": 5e10, "bend": 0.0, "corner": 0.0, "k2": 0.0}),
        EffectSetting("payload", "detector", {"dm": 5.0}),
        EffectSetting("pose_dependent_dynamics", "propeller", {"dJ": 40.0, "phi": 0.1}),
        EffectSetting("position_dependent_damping", "roll", {"D1": 80.0, "D2": 100.0, "A": 40.0, "k": 30.0, "phi": 0.2}),
        EffectSetting("position_dependent_friction", "roll", {"Fc": 12.0, "k": 30.0, "phi": 0.1}),
        EffectSetting("power_law_friction", "roll", {"F1": 40.0, "p": 0.5}),
        EffectSetting("presliding_hysteresis", "roll", {"Fc": 8.0, "Fs_minus_Fc": 3.0, "vs": 0.01, "sigma0": 3e4, "sigma1": 50.0}),
        EffectSetting("quadratic_friction", "roll", {"Fv2": 300.0}),
        EffectSetting("rectified_sensor", "gyro_y", {"share": 1.0, "sign": 1.0}),
        EffectSetting("sample_dropout", "link_position_roll", {"p": 0.2, "length": 3.0, "seed": 7.0}),
        EffectSetting("shared_motor_friction", "propeller", {"Fc": 8.0, "Fv": 30.0, "c": 0.7}),
        EffectSetting("stribeck_friction", "roll", {"Fs_minus_Fc": 4.0, "vs": 0.02, "delta": 1.5}),
        EffectSetting("structural_mode", "roll", {"J": 6.0, "f": 17.0, "zeta": 0.02}),
        EffectSetting("supply_resistance", "roll", {"sag": 0.05, "ke": 1.0}),
        EffectSetting("temperature_dependent_friction", "roll", {"Fv0": 60.0, "a": 0.05, "R": 20.0, "tau": 3.0}),
        EffectSetting("thermal_bending", "roll", {"bend": 1e-3, "tau": 0.7, "warm_for": 0.2}),
        EffectSetting("torque_constant", "roll", {"eps": 0.05}),
        EffectSetting("torque_ripple", "roll", {"Np": 0.1, "A1": 0.05, "phi1": 0.2, "A2": 0.02, "phi2": 0.0}),
        EffectSetting("transmission_error", "roll", {"k": 0.05, "e1": 5e-5, "phi1": 0.1, "e2": 1e-5, "phi2": 0.0}),
        EffectSetting(
            "transmitted_load_friction", "roll", {"Km": 0.05, "Kg": 0.03, "Km_rest": 0.04, "Kg_rest": 0.02, "vs": 0.02, "delta": 1.8}
        ),
        EffectSetting("viscous_friction", "roll", {"Fv": 60.0}),
    )
}


def jog(sample_rate_Hz: float) -> Inputs:
    """Of both axes through a reversal, with noise on the commands."""
    time_s = np.arange(ROWS) / sample_rate_Hz
    sweep = np.outer(1.0 - np.cos(2.0 * np.pi * 0.9 * time_s), [0.02, -0.03]) + np.outer(np.sin(2.0 * np.pi * 0.7 * time_s), [0.02, 0.02])
    excitation = 0.3 * np.random.default_rng(4).standard_normal((ROWS, 2))
    return Inputs(POSE + sweep, excitation, np.zeros((ROWS, 2)), None, POSE)
