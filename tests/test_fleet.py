"""Claims about fleets: statistics over robots, resumption, refused campaigns, the same for any workers, nothing lost by kills."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import independent as ind
import numpy as np
import pandas as pd
import pytest
from scipy import optimize, stats
from test_cli import CUTOFF_HZ, DECLARED, RATE_HZ, Command, edit, tree
from test_interrupts import COMMAND, ENVIRONMENT, FULL, killed

import rx90b_flex as rf
from rx90b_flex.fleet import fleet as fleet_module
from rx90b_flex.fleet.fleet import robot_names
from rx90b_flex.fleet.make import parameters
from rx90b_flex.fleet.second_fit import SecondFit, second_fit
from rx90b_flex.fleet.statistics import CHANGED, STANDS_OUT, change, p_value_beside, p_values, spread, summary
from rx90b_flex.robot import load_robot
from rx90b_flex.signals import load_campaign

# ---- statistics -----------------------------------------------------------------------------------------------------


def restricted_likelihood(between: float, y: np.ndarray, s: np.ndarray) -> float:
    """Of contrasts that the mean does not touch, from their covariance: the definition."""
    k = len(y)
    contrasts = np.linalg.svd(np.ones((1, k)))[2][1:]
    covariance = contrasts @ np.diag(s**2 + between) @ contrasts.T
    return float(stats.multivariate_normal.logpdf(contrasts @ y, np.zeros(k - 1), covariance))


@pytest.mark.parametrize("seed", range(6))
def test_the_spread_between_robots_is_where_the_likelihood_of_contrasts_is_largest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = np.exp(rng.uniform(-1.0, 1.0, 9))
    y = 5.0 + 1.5 * rng.normal(size=9) + s * rng.normal(size=9)
    best = optimize.minimize_scalar(
        lambda t: -restricted_likelihood(t, y, s), bounds=(0.0, 30.0), method="bounded", options={"xatol": 1e-10}
    )
    found = spread(y, s)
    assert found.between == pytest.approx(best.x, abs=1e-4)
    w = 1.0 / (s**2 + found.between)
    assert found.mean == pytest.approx(np.average(y, weights=w), rel=1e-9)


def test_of_robots_that_are_equally_certain_mean_interval_and_spread_are_those_of_a_sample() -> None:
    y = np.array([1.0, 3.0, 2.0, 5.0, 4.5])
    found = summary(y, np.full(5, 0.1))
    half = stats.t.ppf(0.975, 4) * y.std(ddof=1) / np.sqrt(5)
    assert (found.mean, found.low, found.high) == pytest.approx((y.mean(), y.mean() - half, y.mean() + half))
    assert found.between_std == pytest.approx(np.sqrt(y.var(ddof=1) - 0.01))
    limits = np.sqrt(4 * y.var(ddof=1) / stats.chi2.ppf([0.975, 0.025], 4) - 0.01)
    assert (found.between_low, found.between_high) == pytest.approx(tuple(limits))


@pytest.mark.parametrize("between", [0.0, 0.5, 2.0])
def test_intervals_of_the_mean_and_of_the_spread_between_robots_hold_the_truth_as_often_as_they_say(
    between: float,
) -> None:
    rng, runs = np.random.default_rng(3), 400
    missed = np.zeros(2)
    for _ in range(runs):
        s = np.exp(rng.uniform(-1.0, 1.0, 12))
        found = summary(7.0 + between * rng.normal(size=12) + s * rng.normal(size=12), s)
        assert found.between_low is not None and found.between_high is not None
        missed += [not found.low <= 7.0 <= found.high, not found.between_low <= between <= found.between_high]
    assert (missed <= stats.binom.ppf(0.999, runs, 0.05)).all()


def test_a_robot_beside_others_that_are_equally_certain_is_students_test() -> None:
    others = np.array([1.0, 3.0, 2.0, 5.0, 4.5])
    t = (9.0 - others.mean()) / (others.std(ddof=1) * np.sqrt(1.0 + 1.0 / 5))
    degrees = 4 * (1.0 + 1.0 / 5) ** 2  # the mean's variance is known no worse, in Satterthwaite's sum
    expected = 2.0 * stats.t.sf(t, degrees)
    assert p_value_beside(9.0, 0.1, others, np.full(5, 0.1)) == pytest.approx(expected, rel=1e-6)
    assert p_value_beside(9.0, 0.1, others[:2], np.full(2, 0.1)) == 1.0


def test_three_robots_of_twenty_four_do_not_hide_each_other() -> None:
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(60):
        s = 0.3 * np.exp(rng.uniform(-1.0, 1.0, 24))
        y = rng.normal(size=24) + s * rng.normal(size=24)
        y[[3, 8, 20]] += 10.0
        _, out = p_values(y, s, tests=1000)
        found += np.flatnonzero(out).tolist() == [3, 8, 20]
    assert found >= 57


@pytest.mark.parametrize("between", [0.0, 1.0])
def test_of_a_sound_make_no_more_robots_stand_out_than_is_said(between: float) -> None:
    rng, alarms, runs = np.random.default_rng(1), 0, 150
    for _ in range(runs):
        s = np.exp(rng.uniform(-1.0, 1.0, 24))
        alarms += bool(p_values(between * rng.normal(size=24) + s * rng.normal(size=24), s, tests=24)[1].any())
    assert alarms <= stats.binom.ppf(0.999, runs, STANDS_OUT)


def test_the_day_of_a_change_is_found_and_none_where_nothing_changed() -> None:
    rng, steady, covariance = np.random.default_rng(2), 0, 0.01 * (np.eye(6) + 0.5)
    for _ in range(200):
        noise = rng.multivariate_normal(np.zeros(6), covariance)
        assert change(noise, covariance) is None or (steady := steady + 1)
        changed = change(noise + np.where(np.arange(6) >= 4, 1.0, 0.0), covariance)
        assert changed is not None and changed.at == 4
    assert steady <= stats.binom.ppf(0.999, 200, CHANGED)


# ---- names and dates ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["a/x.toml", "b/y.toml"], ("x", "y")),
        (["a/campaign.toml", "b/campaign.toml"], ("a", "b")),
        (["1/a/campaign.toml", "2/a/campaign.toml", "2/b/campaign.toml"], ("1_a", "2_a", "2_b")),
        (["a/x.toml", "b/x.toml", "b/y.toml"], ("a_x", "b_x", "b_y")),
        (["fleet.json.toml", "y.toml"], ("robot_fleet.json", "y")),
    ],
)
def test_a_robot_is_called_what_tells_its_campaign_from_the_others(paths: list[str], names: tuple[str, ...]) -> None:
    assert robot_names([Path("/data") / p for p in paths]) == names


def write_robot(folder: Path, seed: int, *, coulomb: tuple[float, ...] = (2.0, 2.0), offset: float = 0.7) -> Path:
    """An arm of two joints with a constant torque at the elbow that its file does not declare; one recording a dry friction."""
    folder.mkdir(parents=True)
    arm, rng = ind.two_joints(folder), np.random.default_rng(seed)
    runs = []
    for k, dry in enumerate(coulomb):
        torques = [ind.friction((dry, 1.0), (3.0, 1.5)), ind.hidden("torque_offset", 1, {"torque": offset})]
        m = ind.harmonics(rng, 2, period_s=6.0, rate_hz=RATE_HZ)
        role = "validation" if k == len(coulomb) - 1 else "identification"
        runs.append(ind.run(arm, role, m, torques, ind.white(rng, len(m.time), (0.2, 0.08))))
    return ind.write_files(folder, arm, DECLARED, runs, cutoff_hz=CUTOFF_HZ)


def test_a_recording_has_the_day_that_its_campaign_states_or_its_clock(tmp_path: Path) -> None:
    campaign = write_robot(tmp_path / "data", 1)
    assert [r.date for r in load_campaign(campaign).recordings] == [None, None]
    edit(campaign, 'role = "identification"', 'role = "identification"\ndate = 2026-03-02')
    log = pd.read_csv(tmp_path / "data" / "log_2.csv")
    log["time"] += 1772496000.0  # 3 March 2026, UTC
    log.to_csv(tmp_path / "data" / "log_2.csv", index=False)
    read = load_campaign(campaign)
    assert [r.date for r in read.recordings] == ["2026-03-02", "2026-03-03"]
    edit(campaign, "date = 2026-03-02", 'date = "yesterday"')
    with pytest.raises(ValueError, match=r"campaign\.toml: \[\[recording\]\] 1 date: found 'yesterday'"):
        load_campaign(campaign)


DAYS = ("2026-03-01", "2026-03-08", "2026-03-15", "2026-03-22")


def dated_fit(folder: Path, seed: int, coulomb: tuple[float, ...]) -> SecondFit:
    campaign = load_campaign(write_robot(folder, seed, coulomb=coulomb))
    dated = tuple(dataclasses.replace(r, date=d) for r, d in zip(campaign.recordings, DAYS, strict=True))
    return second_fit(dataclasses.replace(campaign, recordings=dated), load_robot(campaign.robot_source), [], [], [], 5)


def test_a_robot_that_changed_between_two_days_is_fitted_apart_before_and_after(tmp_path: Path) -> None:
    fit = dated_fit(tmp_path / "data", 3, (2.0, 2.0, 3.0, 3.0))
    (told,) = (t for t in fit.effects if t.effect.label == "shoulder.coulomb_friction")
    assert (fit.until, fit.since) == ("2026-03-08", "2026-03-15") and fit.earlier is not None
    (then,) = (t for t in fit.earlier.effects if t.effect.label == "shoulder.coulomb_friction")
    assert [abs(x.parameters[0].value - y) < 4 * x.parameters[0].std for x, y in ((then, 2.0), (told, 3.0))] == [
        True,
        True,
    ]


@pytest.fixture(scope="module")
def unchanged(tmp_path_factory: pytest.TempPathFactory) -> dict[str, SecondFit]:
    """Four robots with the same friction on every day."""
    folder = tmp_path_factory.mktemp("unchanged")
    return {f"r{k}": dated_fit(folder / f"r{k}", k, (2.0, 2.0, 2.0, 2.0)) for k in range(4)}


@pytest.mark.parametrize(
    ("dry", "told"), [((2.0, 2.0, 3.0, 3.0), ("2026-03-15", None)), ((3.0, 2.0, 2.0, 2.0), (None, "2026-03-01"))]
)
def test_what_changed_is_compared_as_it_is_now_and_stands_out_since_a_day_or_until_one(
    dry: tuple[float, ...], told: tuple[str | None, str | None], unchanged: dict[str, SecondFit], tmp_path: Path
) -> None:
    fits = {**unchanged, "worn": dated_fit(tmp_path / "worn", 9, dry)}
    out = [(p, v) for p in parameters(fits) for v in p.values if v.stands_out]
    ((p, worn),) = out
    assert (p.type, p.place, p.parameter, worn.robot) == ("coulomb_friction", "shoulder", "torque", "worn")
    assert (worn.since, worn.until) == told
    assert worn.before is not None and (worn.before, worn.value) == pytest.approx((dry[0], dry[-1]), abs=0.15)
    assert p.summary.count == (4 if told[0] else 5) and p.summary.mean == pytest.approx(2.0, abs=0.1)


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    return Command(monkeypatch, capfd)


# ---- a fleet --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Five robots, of which the third has twice the dry friction; and a campaign whose log is missing."""
    folder = tmp_path_factory.mktemp("campaigns")
    out = [write_robot(folder / f"r{k}", k, coulomb=(4.0, 4.0) if k == 2 else (2.0, 2.0)) for k in range(5)]
    broken = write_robot(folder / "r5", 5)
    (folder / "r5" / "log_1.csv").unlink()
    return [*out, broken]


@pytest.fixture(scope="module")
def done(campaigns: list[Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[rf.Fleet, Path]:
    out = tmp_path_factory.mktemp("fleet") / "out"
    return rf.close_loop_many(campaigns, out=out), out


@pytest.mark.slow
def test_a_fleet_says_what_is_common_who_stands_out_and_who_was_refused(done: tuple[rf.Fleet, Path]) -> None:
    fleet, out = done
    assert [o.verdict for o in fleet] == ["explained"] * 5 + ["refused"]
    assert "log_1.csv" in fleet[5].reason and "\n" not in fleet[5].reason
    assert {name for name in ("r0", "r1", "r2", "r3", "r4") if fleet.standing_out(name)} == {"r2"}
    p, value = fleet.standing_out("r2")[0]
    assert (p.type, p.place, p.parameter) == ("coulomb_friction", "shoulder", "torque")
    assert p.summary.count == 4 and p.summary.low < 2.0 < p.summary.high and value.value == pytest.approx(4.0, abs=0.1)
    (offset,) = (p for p in fleet.parameters if p.type == "torque_offset")
    assert offset.place == "elbow" and offset.present == 5 and offset.summary.low < 0.7 < offset.summary.high
    for name in ("r0", "r1", "r2", "r3", "r4"):
        assert {"closed_loop.json", "report.html", "robot.toml"} <= {x.name for x in (out / name).iterdir()}
    assert not (out / "r5").exists()


@pytest.mark.slow
def test_table_json_and_page_of_a_fleet_say_the_same(done: tuple[rf.Fleet, Path]) -> None:
    fleet, out = done
    table = pd.read_csv(out / "fleet.csv")
    assert list(table.robot.unique()) == [o.name for o in fleet]
    assert len(table) == sum(len(p.values) for p in fleet.parameters) + 1
    assert set(table[table.stands_out == True].robot) == {"r2"}  # noqa: E712
    assert "log_1.csv" in table[table.verdict == "refused"].reason.item()
    content = json.loads((out / "fleet.json").read_text())
    assert content["schema"] == 1 and [r["name"] for r in content["robots"]] == [o.name for o in fleet]
    assert [r["name"] for r in content["robots"] if r["stands_out"]] == ["r2"]
    for p, written in zip(fleet.parameters, content["parameters"], strict=True):
        assert written["make"]["mean"] == p.summary.mean and len(written["values"]) == len(p.values)
    page = (out / "fleet.html").read_text()
    assert page.rstrip().endswith("</html>") and "log_1.csv" in page and "1 of 5 robots stand out: r2." in page
    assert "http" not in page.split("<main>")[1]
    assert "r2" in fleet._repr_html_() and len(fleet.to_pandas()) == len(table)


@pytest.mark.slow
def test_what_is_there_is_kept_and_the_rest_is_done(
    campaigns: list[Path], done: tuple[rf.Fleet, Path], tmp_path: Path
) -> None:
    first, out = done[1], tmp_path / "out"
    shutil.copytree(first, out)
    shutil.rmtree(out / "r1")
    (out / "r2" / "closed_loop.json").write_text("{")  # damaged: made again
    for path in out.glob("fleet.*"):
        path.unlink()
    kept = (out / "r0" / "closed_loop.json").stat().st_mtime_ns
    said: list[str] = []
    rf.close_loop_many(campaigns, out=out, progress=lambda text, part: said.append(text))
    assert said[0] == "3 of 6 robots"
    assert tree(out) == tree(first)
    assert (out / "r0" / "closed_loop.json").stat().st_mtime_ns == kept


@pytest.mark.slow
def test_a_campaign_that_has_changed_is_done_again_if_that_is_allowed_and_the_others_are_kept(
    campaigns: list[Path], done: tuple[rf.Fleet, Path], tmp_path: Path
) -> None:
    folder, out = tmp_path / "campaigns", tmp_path / "out"
    shutil.copytree(campaigns[0].parents[1], folder)
    shutil.copytree(done[1], out)
    mine = [folder / c.parent.name / c.name for c in campaigns[:5]]
    mine[3].write_text(mine[3].read_text() + "\n# changed\n")
    before = tree(out)
    with pytest.raises(ValueError, match=r"plan\.json.*--overwrite"):
        rf.close_loop_many(mine, out=out)
    assert tree(out) == before
    times = {n: (out / n / "closed_loop.json").stat().st_mtime_ns for n in ("r0", "r3")}
    rf.close_loop_many(mine, out=out, overwrite=True)
    assert (out / "r0" / "closed_loop.json").stat().st_mtime_ns == times["r0"]
    assert (out / "r3" / "closed_loop.json").stat().st_mtime_ns > times["r3"]
    assert tree(out / "r3") == tree(done[1] / "r3")


@pytest.mark.slow
def test_the_command_goes_on_and_says_what_was_refused(
    campaigns: list[Path],
    done: tuple[rf.Fleet, Path],
    tmp_path: Path,
    command: Command,
) -> None:
    out = tmp_path / "out"
    shutil.copytree(done[1], out)
    ended = command("close-loop", *campaigns, "--out", out)
    assert ended.status == 1 and not ended.err
    assert "1 of 5 robots stand out: r2." in ended.out and "r5: refused: " in ended.out
    assert tree(out) == tree(done[1])


def test_a_link_to_a_campaign_is_no_other_robot(campaigns: list[Path], tmp_path: Path) -> None:
    link = tmp_path / "linked"
    link.symlink_to(campaigns[0].parent)
    with pytest.raises(ValueError, match=r"linked.*is given 2 times"):
        rf.close_loop_many([link / campaigns[0].name, campaigns[0]], out=tmp_path / "out")
    assert list(tmp_path.iterdir()) == [link]


def test_wrong_words_and_campaigns_none_of_which_can_be_used_are_one_line(
    campaigns: list[Path],
    tmp_path: Path,
    command: Command,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fleet_module, "ANSWERS_S", 0.5)
    one, two, broken, out = *campaigns[:2], campaigns[5], tmp_path / "out"
    for words, said in (
        ((one, "--jobs", 0), "--jobs is 0"),
        ((one, "--dask", "tcp://127.0.0.1:1"), "--dask goes with several campaigns"),
        ((one, two, "--jobs", 0), "--jobs is 0"),
        ((one, two, "--jobs", 2, "--dask", "tcp://127.0.0.1:1"), "--jobs and --dask"),
        ((one, two, "--dask", "tcp://127.0.0.1:1"), "no scheduler answers"),
        ((one, two, "--robot", "ur10"), "--robot goes with"),
        ((one, one), "is given 2 times"),
        ((broken, tmp_path / "nothing.toml"), "log_1.csv"),
    ):
        ended = command("close-loop", *words, "--out", out)
        assert ended.status == 2 and ended.err.count("\n") == 1 and said in ended.err, ended
        assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_an_interrupt_keeps_the_robots_that_were_done_and_says_so(campaigns: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    with subprocess.Popen(
        [*COMMAND, *fleet_command(campaigns[:2], out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=ENVIRONMENT,
    ) as run:
        while run.poll() is None and not (out / "r0" / "closed_loop.json").exists():
            time.sleep(0.01)
        run.send_signal(signal.SIGINT)
        _, said = run.communicate(timeout=60)
    assert run.returncode == 130 and said.count(b"\n") == 1 and b"r" in said and b"kept" in said, said
    assert (out / "r0" / "report.html").exists() and not (out / "fleet.json").exists()


# ---- kills, a full disk, two at once --------------------------------------------------------------------------------


def fleet_command(campaigns: list[Path], out: Path, jobs: int = 1) -> list[str]:
    return ["close-loop", *map(str, campaigns), "--out", str(out), "--jobs", str(jobs)]


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_fleet_that_is_killed_at_random_instants_goes_on_and_ends_as_one_that_was_not(
    campaigns: list[Path], done: tuple[rf.Fleet, Path], tmp_path: Path, jobs: int
) -> None:
    out, began = tmp_path / "results" / "out", time.perf_counter()
    subprocess.run(
        [*COMMAND, *fleet_command(campaigns, tmp_path / "first", jobs)], capture_output=True, env=ENVIRONMENT
    )
    lasted = time.perf_counter() - began
    rng = np.random.default_rng(jobs)
    for instant in rng.uniform(0.1, 0.9, 3) * lasted:
        killed(fleet_command(campaigns, out, jobs), float(instant), signal.SIGKILL)
        for closed in out.glob("*/closed_loop.json"):
            assert {n: c for n, c in tree(closed.parent).items() if not n.startswith(".")} == tree(
                done[1] / closed.parent.name
            )
        if (out / "fleet.json").exists():
            assert (out / "fleet.json").read_bytes() == (done[1] / "fleet.json").read_bytes()
            shutil.rmtree(out)
    ended = subprocess.run(
        [*COMMAND, *fleet_command(campaigns, out, jobs)], capture_output=True, env=ENVIRONMENT, text=True
    )
    assert ended.returncode == 1, ended.stderr
    assert tree(out) == tree(done[1])
    assert [p.name for p in out.parent.iterdir()] == ["out"]


@pytest.mark.slow
def test_a_worker_that_is_killed_loses_nothing(
    campaigns: list[Path], done: tuple[rf.Fleet, Path], tmp_path: Path
) -> None:
    victims: list[int] = []

    def kill(text: str, _part: float) -> None:
        from distributed import get_client

        if text.startswith(("1 of", "comparing, 1 of")):
            victims.append(min(get_client().run(os.getpid).values()))
            os.kill(victims[-1], signal.SIGKILL)

    rf.close_loop_many(campaigns, jobs=2, out=tmp_path / "out", progress=kill)
    assert len(victims) == 2 and tree(tmp_path / "out") == tree(done[1])


@pytest.mark.long
@pytest.mark.slow
def test_a_scheduler_of_somebody_elses_does_the_same(
    campaigns: list[Path], done: tuple[rf.Fleet, Path], tmp_path: Path
) -> None:
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, dashboard_address=None) as cluster:
        rf.close_loop_many(campaigns, dask=cluster.scheduler_address, out=tmp_path / "out")
    assert tree(tmp_path / "out") == tree(done[1])


@pytest.mark.slow
def test_a_disk_that_is_full_at_any_size_of_file_is_one_line_and_the_fleet_goes_on_when_there_is_room(
    campaigns: list[Path], done: tuple[rf.Fleet, Path], tmp_path: Path
) -> None:
    sizes = sorted({p.stat().st_size for p in done[1].glob("*") if p.is_file()})
    sizes += sorted({p.stat().st_size for p in (done[1] / "r0").iterdir()})
    states: list[dict[str, bytes | None]] = []
    for k, size in enumerate(sizes[::3]):
        out = tmp_path / str(k) / "out"
        shutil.copytree(done[1], out)
        for name in ("r0", "fleet.json", "fleet.csv", "fleet.html"):
            (shutil.rmtree if name == "r0" else os.unlink)(out / name)
        ended = subprocess.run(
            [sys.executable, "-c", FULL, str(size - 1), *fleet_command(campaigns, out)],
            capture_output=True,
            text=True,
            env={**ENVIRONMENT, "PYTHONDONTWRITEBYTECODE": "1"},
            check=False,
        )
        assert ended.returncode == 2 and ended.stderr.count("\n") == 1 and "out" in ended.stderr, ended.stderr
        assert not list(tmp_path.rglob(".*")) and not (out / "fleet.json").exists()
        if tree(out) not in states:  # it goes on from each state in which a full disk leaves a folder
            states.append(tree(out))
            rf.close_loop_many(campaigns, out=out)
            assert tree(out) == tree(done[1])


@pytest.mark.slow
def test_two_fleets_with_one_folder_at_once_leave_one_result(
    campaigns: list[Path], done: tuple[rf.Fleet, Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    start: Callable[[], subprocess.Popen[bytes]] = lambda: subprocess.Popen(  # noqa: E731
        [*COMMAND, *fleet_command(campaigns, out)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=ENVIRONMENT
    )
    both = [start(), start()]
    for run in both:
        _, said = run.communicate(timeout=600)
        assert run.returncode == 1, said
    assert tree(out) == tree(done[1])
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
