"""What a recording did not shake may hide, and a verdict that finds nothing says so."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.observed.shaken import shaken_up_to_Hz, what_may_hide
from hil.recording import Channel, Recording

TIME_S = np.arange(5120) / 256.0


def recording(**channels: np.ndarray) -> Recording:
    return Recording(
        {
            "time": Channel("s", TIME_S),
            **{name: Channel("rad" if name.startswith("reference") else "A", values) for name, values in channels.items()},
        },
        {},
    )


def multisine(highest_Hz: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    return sum(np.cos(2.0 * np.pi * (f * TIME_S + rng.random())) for f in np.arange(1.0, highest_Hz + 0.5, 1.0))


def test_a_jog_shakes_up_to_its_own_frequency_and_a_multisine_to_its_band() -> None:
    jog = np.sin(2.0 * np.pi * 0.2 * TIME_S)
    still = np.zeros(len(TIME_S))
    assert shaken_up_to_Hz({"jog": recording(reference_roll=jog, excitation_roll=still)}) == pytest.approx(0.2, abs=0.11)
    both = {"jog": recording(reference_roll=jog), "multisine": recording(reference_roll=jog, excitation_roll=multisine(40.0))}
    assert shaken_up_to_Hz(both) == pytest.approx(40.0, abs=0.5)


def test_without_reference_and_excitation_the_command_says_what_was_shaken() -> None:
    assert shaken_up_to_Hz({"foreign": recording(command_roll=multisine(12.0))}) == pytest.approx(12.0, abs=0.5)


def test_the_sentence_says_what_could_hide_and_what_would_show_it() -> None:
    jog = recording(reference_roll=np.sin(2.0 * np.pi * 0.2 * TIME_S))
    said = what_may_hide({"jog": jog})
    assert said.startswith("these recordings shake the machine up to 0.")
    assert "a resonance above may hide, until a multisine beyond it is recorded" in said
    still = recording(reference_roll=np.full(len(TIME_S), 0.3), excitation_roll=np.zeros(len(TIME_S)))
    assert what_may_hide({"still": still}).startswith("these recordings shake nothing: any resonance may hide")
