"""A fleet of one make: who is worn, who carries a wrong load

    python benchmarks/fleet.py --folder DIR [--robots 6,12,24] [--jobs 2] [--seed S]

Twenty-four UR10s, links as in their URDF and identified, friction of each joint 5 % off from robot to robot. All lack the same in
their file: friction that falls from standstill on at the shoulder's lift (Stribeck). Three have a worn joint, whose dry friction is
half as much again from the second of three days on; two carry 2 kg that nobody told of. Logs, two runs of two periods of 5 s to
identify on and one that validates, are made in `hidden_effects/`, which shares no effect code with the package.

The largest fleet runs on a local Dask cluster, one of whose workers is killed on the way. For each robot: what stands out, and
whether that is right: of a worn one friction of its joint and nothing of others, since the second day; of a loaded one parameters of
the last link and nothing of others; of the rest nothing. Then seconds over the number of robots, by the clock and of processors
(which other programs disturb less). Logs that lie in the folder are used again.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import independent as ind
import numpy as np
from hidden_effects.arms import subject
from hidden_effects.motions import Experiment
from hidden_effects.physics import Hidden, Plant
from hidden_effects.scene import coloured

import rx90b_flex as rf
from rx90b_flex.signals import Recording
from rx90b_flex.signals.recording import write_campaign

RATE_HZ, CUTOFF_HZ, PERIOD_S, PERIODS = 250.0, 20.0, 5.0, 2
ROLES = ("identification", "identification", "validation")
DAYS = ("2026-03-02", "2026-03-09", "2026-03-16")
SPREAD = 0.05  # of friction, from robot to robot
TORQUE_NOISE, POSITION_NOISE = 0.004, 2e-6  # of a joint's root mean square torque; rad
WEAR = 1.5  # times the dry friction
LOAD = Hidden("payload", (), {"mass": 1.0}, {"centre": [0.03, -0.02, 0.06]})
FALLING = Hidden("stribeck_friction", (1,), {"torque": 1.0}, {"velocity": 0.15, "power": 1.0})
WORN = {4: 2, 11: 2, 17: 0}  # robot -> joint; two of them the same
LOADED = {7: 2.0, 20: 2.0}  # robot -> kg
LAST_LINK = "wrist_3_link"


def write_robot(folder: Path, number: int, seed: int) -> Path:
    """One robot's campaign."""
    rng = np.random.default_rng([seed, number])
    of_make = subject("ur10")
    arm = of_make.arm
    coulomb, viscous = (
        np.array(x) * (1 + SPREAD * rng.normal(size=len(x))) for x in (of_make.coulomb, of_make.viscous)
    )
    hidden = [(FALLING, 6.0 * (1 + SPREAD * rng.normal()))]
    if number in LOADED:
        hidden.append((LOAD, LOADED[number]))
    plant = Plant(arm, "tool0", "tanh_10", coulomb, viscous, (3e-4, 2e-3), tuple(hidden))
    worn = coulomb.copy()
    if number in WORN:
        worn[WORN[number]] *= WEAR
    runs = [
        logged(rng, plant if day == 0 else replace(plant, coulomb=worn), f"run_{day + 1}", role, DAYS[day])
        for day, role in enumerate(ROLES)
    ]
    folder.mkdir(parents=True, exist_ok=True)
    friction = [{"type": t, "joint": j} for j in arm.joints for t in ("coulomb_friction", "viscous_friction")]
    return write_campaign(folder, ind.write_robot(folder, arm, friction, False), runs, cutoff_hz=CUTOFF_HZ)


def logged(rng: np.random.Generator, plant: Plant, name: str, role: str, day: str) -> Recording:
    """One recording of a motion that is drawn."""
    q, torque = plant.logged(Experiment.draw(rng, plant.arm.model, PERIOD_S, False), RATE_HZ, PERIODS)
    noise = TORQUE_NOISE * np.sqrt((torque**2).mean(axis=0)) * coloured(rng, q.shape, "white")
    return Recording(
        name=name,
        role=role,  # type: ignore[arg-type]
        time=np.arange(len(q)) / RATE_HZ,
        sample_rate_hz=RATE_HZ,
        joints=plant.arm.joints,
        position=q + POSITION_NOISE * rng.normal(size=q.shape),
        torque=torque + noise,
        period_s=PERIOD_S,
        date=day,
    )


@dataclass
class Killer:
    """Kills one process of a cluster once so many robots are done."""

    after: int
    killed: int = 0

    def __call__(self, text: str, _part: float) -> None:
        done = text.split(" of ")[0]
        if not self.killed and done.isdigit() and int(done) == self.after:
            self.killed = next(iter(workers()), 0)
            if self.killed:
                os.kill(self.killed, signal.SIGKILL)
        print(f"  {text}", flush=True)


def workers() -> list[int]:
    """Processes of the local cluster."""
    from distributed import get_client

    return sorted(int(pid) for pid in get_client().run(os.getpid).values())


def processor_s() -> float:
    """Time of processors that this process and those it has waited for took, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def right(number: int, places: Sequence[tuple[str, str]], since: Sequence[str | None]) -> bool:
    """Whether what stands out of a robot is what is wrong with it."""
    joints = subject("ur10").arm.joints
    if number in WORN:
        friction = {p for t, p in places if "friction" in t}
        return friction == {joints[WORN[number]]} == {p for _, p in places} and DAYS[1] in since
    if number in LOADED:
        return bool(places) and {p for _, p in places} == {LAST_LINK}
    return not places


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--robots", default="6,12,24", help="sizes of the fleets")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sizes = sorted(int(x) for x in options.robots.split(","))
    began = time.perf_counter()
    campaigns = [options.folder / f"ur10_{k + 1:02d}" / "campaign.toml" for k in range(sizes[-1])]
    for k, campaign in enumerate(campaigns):
        if not campaign.exists():
            write_robot(campaign.parent, k, options.seed)
    print(f"logs of {len(campaigns)} robots: {time.perf_counter() - began:.0f} s", flush=True)
    seconds, worked = {}, {}
    for size in sizes:
        out = options.folder / f"fleet_{size}"
        shutil.rmtree(out, ignore_errors=True)
        killer = Killer(size // 3 if size == sizes[-1] else -1)
        began, used = time.perf_counter(), processor_s()
        fleet = rf.close_loop_many(campaigns[:size], jobs=options.jobs, out=out, progress=killer)
        seconds[size], worked[size] = time.perf_counter() - began, processor_s() - used
    count = 0
    for k, robot in enumerate(fleet):
        out_by = fleet.standing_out(robot.name)
        good = right(k, [(p.type, p.place) for p, _ in out_by], [v.since for _, v in out_by])
        count += good
        truth = (
            f"worn {subject('ur10').arm.joints[WORN[k]]}" if k in WORN else f"{LOADED[k]:g} kg" if k in LOADED else ""
        )
        said = "; ".join(
            f"{p.type} {p.place} {p.parameter} {v.value:.3g} (make {p.summary.mean:.3g}) {v.since or ''}"
            for p, v in out_by
        )
        found = ", ".join(e.label for e in robot.found)
        print(f"{'right' if good else 'WRONG'}  {robot.name}  {truth:28s} {robot.verdict}: {found}  |  {said}")
    print(
        f"right on {count} of {len(fleet)}; worker {killer.killed} killed, {len(fleet.compared)} of {len(fleet)} robots compared"
    )
    make = [p for p in fleet.parameters if p.type == FALLING.kind]
    for p in make:
        over = p.summary
        interval = f"{over.mean:.4g} [{over.low:.4g}, {over.high:.4g}]"
        interval += f", between {over.between_std:.2g} [{over.between_low:.2g}, {over.between_high:.2g}]"
        print(f"make: {p.type} {p.place} {p.parameter}: {interval}, {p.present} of {len(p.values)} robots")
    for size, taken in seconds.items():
        print(
            f"{size} robots: {taken:.0f} s, {taken / size:.1f} s a robot; "
            f"of processors {worked[size]:.0f} s, {worked[size] / size:.1f} s a robot"
        )


if __name__ == "__main__":
    main()
