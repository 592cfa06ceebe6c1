"""Beside the public package `best-linear-approximation` (Floren; PyPI, Python 3.12 and later): the same data, the same answer, how long.

    OMP_NUM_THREADS=1 python benchmarks/identification_public.py [--silverbox SNLS80mV.csv]

Closed loop: one pose, 14 records, 1279 lines, 5 outputs, 2 inputs, 10 periods of 2560. Open loop: the Silverbox record (Wigren and
Schoukens 2013), realisations of an odd multisine.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from identification_speed import OUTPUTS, PERIOD, PERIODS, REALISATIONS, best_of, records

from hil.identification import periodic_records, robust_bla

SAMPLES, LINES = 8192, np.arange(1, 2 * 1342, 2)
SAMPLE_RATE_HZ = 1e7 / 2**14
QUIET_V, GAP = 8e-3, 60  # blocks of the Silverbox record lie between runs of so many samples below that voltage
TRANSIENT = 400  # samples left out at the start of a block


def farthest(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Largest difference over the largest value."""
    return float(np.max(np.abs(ours - theirs)) / np.max(np.abs(theirs)))


def closed_loop(package) -> dict:  # type: ignore[no-untyped-def]
    many = records(REALISATIONS)

    def experiment_layout(signal: np.ndarray) -> np.ndarray:
        """(M, E, T, n) to (samples, n, E, M, periods)."""
        return np.ascontiguousarray(signal.reshape(REALISATIONS, 2, PERIODS, PERIOD, -1).transpose(3, 4, 1, 0, 2))

    y, u = experiment_layout(many.outputs), experiment_layout(many.inputs)
    w = experiment_layout(many.excitation)[..., 0]

    def theirs():  # type: ignore[no-untyped-def]
        return package.robust.closed_loop(w, u, y, 256.0, many.lines, independent_subexperiments=True, show_warnings=False)

    answer, reference = robust_bla(many), theirs()
    ratios = {kind: getattr(reference.G, kind).var / answer.standard_deviation(kind) ** 2 for kind in ("noise", "total")}
    return {
        "outputs": OUTPUTS,
        "G": farthest(answer.G, reference.G.value),
        **spread("noise", ratios["noise"]),
        **spread("total", ratios["total"]),
        "ours_s": best_of(lambda: robust_bla(many)),
        "theirs_s": best_of(theirs),
    }


def silverbox(package, path: Path) -> dict:  # type: ignore[no-untyped-def]
    V1, V2 = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 1), unpack=True)
    starts = multisine_starts(V1)
    data = np.array([(V1[k : k + SAMPLES], V2[k : k + SAMPLES]) for k in starts])  # (blocks, 2, samples)
    u, y = data[:, 0], data[:, 1]
    spectrum = np.zeros((len(starts), SAMPLES // 2 + 1), complex)
    spectrum[:, LINES] = np.exp(1j * np.angle(np.fft.rfft(u)[:, LINES]))
    r = np.fft.irfft(spectrum)  # the design behind the measured input: its phases, flat, since amplitudes as measured vary by a sixth
    ours = robust_bla(
        periodic_records(*(x[:, None, :, None] for x in (y, u, r)), period_samples=SAMPLES, sample_rate_Hz=SAMPLE_RATE_HZ, lines=LINES)
    )
    theirs = package.robust.known_reference(
        r.T[:, None], u.T[:, None, :, None], y.T[:, None, :, None], SAMPLE_RATE_HZ, LINES, show_warnings=False
    )
    total = theirs.G.total.var / ours.standard_deviation("total") ** 2
    return {"realisations": len(starts), "G": farthest(ours.G, theirs.G.value), **spread("total", total)}


def multisine_starts(voltage: np.ndarray) -> list[int]:
    """First sample after the transient of every block of multisine."""
    quiet = np.concatenate(([0], (np.abs(voltage) < QUIET_V).astype(int), [0]))
    edges = np.flatnonzero(np.diff(quiet))
    ends = [int(stop) for start, stop in zip(edges[::2], edges[1::2], strict=True) if stop - start > GAP]
    return [
        stop + TRANSIENT
        for stop, following in zip(ends, [*ends[1:], len(voltage)], strict=True)
        if SAMPLES + TRANSIENT < following - stop < 2 * SAMPLES
    ]


def spread(kind: str, ratio: np.ndarray) -> dict[str, float]:
    """A variance of theirs over ours: the factor between one realisation's and the mean's, and how far from constant it is."""
    return {
        f"{kind} variance, theirs over ours": float(np.median(ratio)),
        f"{kind} variance, farthest from that": float(np.ptp(ratio) / np.median(ratio)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--silverbox", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data" / "silverbox" / "SNLS80mV.csv"
    )
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "identification_public.json")
    arguments = parser.parse_args()
    try:
        import best_linear_approximation as package
    except (ImportError, SyntaxError) as error:
        raise SystemExit(f"best-linear-approximation is not installed, or this Python is too old for it: {error}") from None
    report = {"closed loop": closed_loop(package)}
    if arguments.silverbox.exists():
        report["silverbox"] = silverbox(package, arguments.silverbox)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
