"""The nonparametric frequency response of section 6.6.2's campaign: time, accuracy, bands, beside public estimators.

Reads a campaign that is there, or simulates one into the folder. `pyFRF` (H1, H2) is used where it can be imported
(`pip install --no-deps --target DIR pyfrf tqdm sdypy-sep005`, DIR on PYTHONPATH), `best-linear-approximation` where an interpreter of
Python 3.12 or later is given that has it.

    python benchmarks/frf.py --folder campaign_662   --python312 venv312/bin/python  # 96 runs of 9 periods
"""

from __future__ import annotations

import argparse
import importlib
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

import rx90b_flex as rf
from rx90b_flex.excitation import crest_factor
from rx90b_flex.identify.frf import MeasuredResponse, confidence_radius, estimate_frequency_response
from rx90b_flex.signals import Campaign, load_campaign
from rx90b_flex.simulate import Noise, load_cs8, run_campaign, section_662, static_start

BAND_HZ = (8.0, 80.0)
Result = TypeVar("Result")
BEST_LINEAR = """
import sys, time
import numpy as np
from best_linear_approximation.robust import closed_loop
given = np.load(sys.argv[1])
r, u, y, lines = (given[name] for name in ("r", "u", "y", "lines"))
began = time.perf_counter()
result = closed_loop(r, u, y, float(given["rate"]), lines, show_warnings=False)
seconds = time.perf_counter() - began
np.savez(sys.argv[2], value=result.G.value, std=result.G.total.std, seconds=seconds)
"""


def timed(job: Callable[[], Result]) -> tuple[Result, float]:
    """What the job returns, and the seconds it took."""
    start = time.perf_counter()
    return job(), time.perf_counter() - start


def coverage(campaign: Campaign, parts: int) -> np.ndarray:
    """Part of the lines at which each entry's 95 % band of one part of the realisations holds the mean of the others, (n, n)."""
    whole = estimate_frequency_response(campaign, band_hz=BAND_HZ)
    names = [{p.recording for p in whole.places if p.realisation % parts == i} for i in range(parts)]
    each = [
        estimate_frequency_response([r for r in campaign.identification if r.name in some], band_hz=BAND_HZ)
        for some in names
    ]
    others = [np.mean([x.value for x in each if x is not own], axis=0) for own in each]
    widened = np.sqrt(1.0 + 1.0 / (parts - 1))  # the others' mean is not exact either
    inside = [np.abs(r.value - o) < widened * confidence_radius(r) for r, o in zip(each, others, strict=True)]
    return np.asarray(np.mean(inside, axis=(0, 1)))


def spectra(campaign: Campaign, response: MeasuredResponse) -> dict[str, np.ndarray]:
    """Half differences of the sign pairs in time, (realisations, experiments, periods, samples, joints), and the feed-forward."""
    by_name = {r.name: r for r in campaign.identification}
    place = {(p.realisation, p.experiment, p.sign): by_name[p.recording] for p in response.places}
    count, inputs = 1 + max(k[0] for k in place), 1 + max(k[1] for k in place)
    samples = next(iter(place.values())).period_samples or 1

    def half(field: str) -> np.ndarray:
        waves = [
            [0.5 * (getattr(place[m, k, 1], field) - getattr(place[m, k, -1], field)) for k in range(inputs)]
            for m in range(count)
        ]
        x = np.array(waves)
        return x.reshape(count, inputs, -1, samples, x.shape[-1])

    return {name: half(name) for name in ("torque", "position", "feedforward_torque")}


def pyfrf(data: dict[str, np.ndarray], lines: np.ndarray, rate: float, estimator: str) -> np.ndarray:
    """H1 or H2 by pyFRF from every period as one measurement, acceleration over torque, (F, n, n)."""
    module = importlib.import_module("pyFRF")
    u, y = (np.moveaxis(data[x].reshape(-1, *data[x].shape[-2:]), 1, 2) for x in ("torque", "position"))
    frf = module.FRF(round(rate), u.copy(), y.copy(), exc_type="f", resp_type="d", window="none")
    value = np.moveaxis(getattr(frf, f"get_{estimator}")(), -1, 0)
    return -((2.0 * np.pi * rate * lines / data["torque"].shape[-2])[:, None, None] ** 2) * value[lines]


def best_linear(
    data: dict[str, np.ndarray], lines: np.ndarray, rate: float, python: str
) -> tuple[np.ndarray, np.ndarray, float]:
    """Closed-loop estimate of best-linear-approximation: acceleration over torque, its standard deviation, (F, n, n), and the time.

    In an interpreter of its own, since it needs Python 3.12.
    """
    # its layout: samples, channels, experiments, realisations, periods
    u, y, r = (np.transpose(data[x], (3, 4, 1, 0, 2)) for x in ("torque", "position", "feedforward_torque"))
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "given.npz", Path(folder) / "found.npz"
        np.savez(given, u=u, y=y, r=r[..., 0], lines=lines, rate=rate)
        subprocess.run([python, "-c", BEST_LINEAR, str(given), str(found)], check=True)
        value, std, seconds = (np.load(found)[name] for name in ("value", "std", "seconds"))
    factor = (2.0 * np.pi * rate * lines / data["torque"].shape[-2])[:, None, None] ** 2
    return -factor * value, factor * std, float(seconds)


def main() -> None:
    """Print times, accuracy and coverage."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--folder", type=Path, required=True, help="of the campaign; simulated where it holds none")
    arguments.add_argument("--jobs", type=int, default=2)
    arguments.add_argument("--python312", help="interpreter that can import best_linear_approximation")
    options = arguments.parse_args()

    robot = rf.load_robot("rx90b_3dof")
    file = options.folder / "campaign.toml"
    if not file.exists():
        plan = section_662(robot, load_cs8(), noise=Noise(torque=0.1, position=1e-6, velocity=1e-4))
        result, seconds = timed(lambda: run_campaign(plan, options.folder, jobs=options.jobs))
        assert not result.failed, result.failed[0]
        print(f"simulated {len(result.done)} runs in {seconds:.0f} s")

    campaign, reading = timed(lambda: load_campaign(file))
    response, estimating = timed(lambda: estimate_frequency_response(campaign, band_hz=BAND_HZ))
    torque = campaign.recordings[0].feedforward_torque
    assert torque is not None
    print(f"crest factor of the feed-forward {crest_factor(torque)[0]:.3f}")
    print(
        f"read in {reading:.2f} s, estimated in {estimating:.2f} s: {len(response.hz)} lines, {response.periods} periods"
    )
    for remark in response.remarks:
        print(f"remark: {remark}")

    pose, speed = np.array(response.pose), np.full(3, 0.11)
    q, v, _ = static_start(robot, pose, speed)
    truth = robot.linearize(q, v).frf(response.hz)
    data = spectra(campaign, response)
    lines = np.round(response.hz * data["torque"].shape[-2] / campaign.sample_rate_hz).astype(int)
    estimates = {"this": response.value, "this, arithmetic": response.arithmetic_mean, "this, H1": response.h1}
    seconds = {}
    for estimator in ("H1", "H2"):
        try:
            name = f"pyFRF {estimator}"
            estimates[name], seconds[name] = timed(lambda e=estimator: pyfrf(data, lines, campaign.sample_rate_hz, e))  # type: ignore[misc]
        except ImportError:
            print("pyFRF cannot be imported")
    if options.python312:
        name = "best-linear-approximation"
        estimates[name], std, seconds[name] = best_linear(data, lines, campaign.sample_rate_hz, options.python312)
        print(f"{name}: its standard deviation over this one's, median {np.median(std / response.std()):.2f}")
    print(
        "median relative difference from the robot linearised at 0.11 rad/s (friction's best linear approximation differs from it)"
    )
    for name, value in estimates.items():
        off = np.median(np.abs(value - truth) / np.abs(truth), axis=0)
        apart = np.median(np.abs(value - response.value) / response.std())
        took = f", {seconds[name]:.2f} s" if name in seconds else ""
        print(
            f"  {name:26s} diagonal {np.diag(off).round(3)}, largest entry {off.max():.3f}; {apart:.2g} deviations from this{took}"
        )
    inside = coverage(campaign, 4)
    print(
        f"95 % bands of a quarter of the realisations hold the others' mean in {100 * inside.mean():.1f} % of lines and entries"
    )
    print(f"  by entry from {100 * inside.min():.1f} to {100 * inside.max():.1f} %")


if __name__ == "__main__":
    main()
