"""How often the intervals of `frf` hold the truth, on an arm of three flexible joints in MuJoCo under its own controller.

    python benchmarks/motor_arm.py --folder /tmp/arm --first 200 --campaigns 20

Each campaign is an arm drawn anew (`tests/mujoco_arm.py`; drives, springs and frictions within a quarter), a robot file that is wrong
by up to a fifth, and 18 runs of two periods about each pose (`--pose 0,90,30 --pose 0,50,80`; the first alone by default): in even
ones the arm's cascade is described and torques are fed forward, in odd ones motion alone excites one whose controller is not known.
Campaigns and results in the folder are used again; each is
written as one line to ``intervals.jsonl`` there. Prints, of each inertia and stiffness as measured and by replay, the largest error,
the median standard deviation, the errors over it and how many 95 % intervals hold.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from arm_campaigns import ONE_POSE, errors, recorded
from mujoco_arm import Arm

from rx90b_flex.identify.frf_command import FrfOptions, frf_json, identify_from_motors

FITS = {"as measured": "grey_box", "by replay": "replay"}


def campaign(seed: int, folder: Path, poses: tuple[str, ...] = ONE_POSE) -> dict[str, Any]:
    """Errors of one campaign and their stated standard deviations, logarithms, by fit and parameter."""
    arm, known, own = Arm.drawn(seed), seed % 2 == 0, folder / str(seed)
    path = own / "runs" / "campaign.toml"
    played = own / "played"
    if not played.exists():
        recorded(arm, own, by="torque" if known else "reference", known=known, poses=poses)
        played.touch()
    began = time.process_time()
    found = frf_json(identify_from_motors(path, FrfOptions(modes=(6,), bending_alike_std=0.0)))
    fits = {name: errors(arm, found[key]) for name, key in FITS.items() if found[key] is not None}
    delay = found["replay"]["torque_delay"]["value"] - arm.skew_s if found["replay"] is not None else None
    return {"seed": seed, "fits": fits, "skew_error_s": delay, "processor_s": time.process_time() - began}


def show(campaigns: list[dict[str, Any]]) -> None:
    """The table over all campaigns."""
    for name in FITS:
        fits = [c["fits"][name] for c in campaigns if name in c["fits"]]
        print(
            f"{name}, {len(fits)} campaigns: largest error | median standard deviation | rms error over it | intervals that hold"
        )
        every = []
        for parameter in fits[0]:
            off, std = np.array([fit[parameter] for fit in fits]).T
            every.append(np.abs(off / std))
            held, size = int((every[-1] < 1.96).sum()), np.sqrt(np.mean(every[-1] ** 2))
            largest, usual = 100 * np.abs(off).max(), 100 * np.median(std)
            print(f"  {parameter:28s} {largest:6.2f} % | {usual:6.2f} % | {size:4.2f} | {held} of {len(fits)}")
        print(f"  all: {np.mean(np.array(every) < 1.96):.1%} of {np.size(every)} intervals hold")
    skew = [abs(c["skew_error_s"]) for c in campaigns if c["skew_error_s"] is not None]
    print(
        f"skew: at most {1e6 * max(skew):.1f} us off; frf: {np.median([c['processor_s'] for c in campaigns]):.0f} s of a processor"
    )


def main() -> None:
    """Play, identify, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, required=True, help="for campaigns and results")
    parser.add_argument("--first", type=int, default=200, help="seed of the first campaign")
    parser.add_argument("--campaigns", type=int, default=20)
    parser.add_argument("--pose", action="append", help="degrees, one a joint; repeat for more poses")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    file = options.folder / "intervals.jsonl"
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    known = {found["seed"]: found for found in map(json.loads, lines)}
    seeds = range(options.first, options.first + options.campaigns)
    for seed in seeds:
        if seed not in known:
            known[seed] = campaign(seed, options.folder, tuple(options.pose or ONE_POSE))
            with file.open("a", encoding="utf-8") as out:
                out.write(json.dumps(known[seed]) + "\n")
    show([known[seed] for seed in seeds])


if __name__ == "__main__":
    main()
