"""How often 95 % intervals of identified parameters hold the truth, under white and under coloured noise

    python benchmarks/interval_coverage.py [--draws 200] [--arms ur10 panda] [--rates 250 100] [--periods 2 1] [--forms tanh_10]

Nothing is hidden: links and declared friction are identified, two recordings of whole periods of 10 s, the same motion in all
draws, with noise of its own on the torques in each. Data of `hidden_effects/`, made without the package. Prints, for each
setting and colour: intervals that hold over all parameters, over friction, over links, and for the worst parameter; the scatter of
estimates over their mean stated standard deviation; and the largest bias over the scatter (a wrong form of friction shows there).
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
from hidden_effects.arms import ROBOTS, declared_robot, link_values
from hidden_effects.counting import INTERVAL
from hidden_effects.friction import FORMS
from hidden_effects.scene import CUTOFF_HZ, PERIOD_S, Conditions, Scene, coloured

from rx90b_flex.identify.least_squares import Identification, identify
from rx90b_flex.identify.regression import Regression
from rx90b_flex.signals import Recording, lowpass

Array = np.ndarray
NAMES = {"coulomb_friction": "torque", "viscous_friction": "coefficient"}


def recordings(scene: Scene, rate_hz: float, periods: int) -> list[Recording]:
    """Logs of the two identification motions without noise."""
    out = []
    for i, run in enumerate(scene.experiments[:2]):
        position, torque = scene.plant.logged(run, rate_hz, periods)
        time = np.arange(len(torque)) / rate_hz
        out.append(Recording(f"run_{i}", "identification", time, rate_hz, scene.joints, position, torque))
    return out


def with_noise(clean: Regression, noise: list[Array]) -> Regression:
    """The same motion, differentiated once, with noise on its torques."""
    segments = []
    for segment, x in zip(clean.segments, noise, strict=True):
        passed = lowpass(x, CUTOFF_HZ, segment.recording.sample_rate_hz)
        thinned = passed[:: segment.factor * segment.working_factor][segment.kept]
        segments.append(dataclasses.replace(segment, torque=segment.torque + thinned))
    return clean._sharing(dataclasses.replace(clean, segments=tuple(segments)))


def estimated(model: Identification, scene: Scene) -> dict[str, tuple[float, float, float]]:
    """Value, standard deviation and truth of every parameter that the data determines."""
    out = {}
    true = {"coulomb_friction": scene.plant.coulomb, "viscous_friction": scene.plant.viscous}
    for i, effect in enumerate(model.effects):
        for e in model.estimates(i):
            if e.value is not None and e.std and e.name == NAMES.get(effect.type_name()):
                j = scene.joints.index(effect.joints[0])
                out[f"{effect.label}.{e.name}"] = (e.value, e.std, true[effect.type_name()][j])
    for e, x in zip(model.link_estimates(), link_values(scene.plant.arm).ravel(), strict=True):
        if e.value is not None and e.std:
            out[e.name] = (e.value, e.std, x)
    return out


def drawn(scene: Scene, clean: Regression, colour: str, draws: int, seed: int) -> tuple[list[str], Array]:
    """Names, and (draws, parameters, 3) of value, standard deviation, truth."""
    rows, names = [], []
    for k in range(draws):
        rng = np.random.default_rng([seed, k])
        noise = []
        for segment in clean.segments:
            recording = segment.recording
            size = (recording.samples, len(scene.joints))
            noise.append(scene.floor * coloured(rng, size, colour, recording.sample_rate_hz))
        model = identify(with_noise(clean, noise), clean.robot.effects, fit_links=True)
        found = estimated(model, scene)
        names = names or list(found)
        rows.append([found[n] for n in names])
    return names, np.array(rows)


def line(names: list[str], rows: Array) -> str:
    value, std, true = np.moveaxis(rows, 2, 0)
    hold = (np.abs(value - true) < INTERVAL * std).mean(axis=0)
    friction = np.array(["friction" in n for n in names])
    spread = value.std(axis=0, ddof=1)
    ratio = np.sqrt((spread**2 / (std**2).mean(axis=0)).mean())
    bias = np.abs(value.mean(axis=0) - true[0]) / spread
    worst = int(hold.argmin())
    return (
        f"all {100 * hold.mean():.1f} %, friction {100 * hold[friction].mean():.1f} %, links {100 * hold[~friction].mean():.1f} %, "
        f"worst {100 * hold[worst]:.0f} % ({names[worst]}); scatter over stated {ratio:.3f}; "
        f"largest bias {bias.max():.2f} ({names[int(bias.argmax())]})"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--arms", nargs="+", default=["ur10"], choices=list(ROBOTS))
    parser.add_argument("--forms", nargs="+", default=["tanh_10"], choices=list(FORMS))
    parser.add_argument("--rates", nargs="+", type=float, default=[250.0, 100.0])
    parser.add_argument("--periods", nargs="+", type=int, default=[2, 1])
    parser.add_argument("--colours", nargs="+", default=["white", "ar"], choices=["white", "ar"])
    parser.add_argument("--seed", type=int, default=0)
    o = parser.parse_args()
    for arm in o.arms:
        robot = declared_robot(arm, (), False)
        for form in o.forms:
            rng = np.random.default_rng([o.seed, *f"{arm}/{form}".encode()])
            scene = Scene.draw(rng, arm, form, Conditions(), False, False)
            for rate_hz in o.rates:
                for periods in o.periods:
                    clean = Regression.of(robot, recordings(scene, rate_hz, periods), CUTOFF_HZ)
                    for colour in o.colours:
                        text = line(*drawn(scene, clean, colour, o.draws, o.seed))
                        where = f"{arm}, {form}, 2 x {periods * PERIOD_S:g} s at {rate_hz:g} Hz, {colour}"
                        print(f"{where}: {text}", flush=True)


if __name__ == "__main__":
    main()
