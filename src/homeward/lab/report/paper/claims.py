"""Claims of the paper, tested against the results."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from homeward.lab.studies.paper.cases import DEAD_RECKONING, PI_HT
from homeward.lab.studies.paper.layouts import (
    AS_SET,
    BOUND,
    FAULTY,
    LONG,
    LONG_FAULTY,
    STUDIED,
    Outcome,
    Reading,
)
from homeward.lab.studies.paper.reproduction import (
    PRINTED,
    TO_PAPER_UNITS,
    LayoutStudy,
    beats_printed,
    better_shares,
)
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CaseName
from homeward.lab.studies.study.statistics import root_mean_square
from homeward.runs.report.words import count, listing, percent

Readings = Mapping[tuple[CaseName, Reading], Outcome]
MAJORITY = 0.5
"""A claim that holds in a larger share of layouts holds in most of them."""
UNLIKELY = 0.05
"""The paper prints one run: a start from which fewer runs are below a printed error is unlikely."""
MIN_LAYOUTS = 20
"""With fewer layouts, shares of them are not evidence."""


class Claim(NamedTuple):
    """One sentence of the paper under one reading."""

    claim: str
    reading: str
    decision: str
    figure: str
    """Numbers that the decision follows from."""
    command: str
    """Command for this reading only."""


def reading_words(reading: Reading, case: CaseName) -> str:
    """Return a reading as words: "exact start, Q 2 x 2, stop at 5 cm, two faults"."""
    words = [start_words(reading), f"Q {'2 x 2' if reading.meaning_of_Q == 'input' else 'n x n'}"]
    if case != "4":
        words.append(f"stop at {100 * reading.stop_radius:g} cm")
    if case == "2":
        words.append(count(reading.faults, "fault"))
    if case == "4":
        words.append(f"{reading.circle_turn_rate:g} rad/s")
    if any(reading.disturbance):
        words.append("twist noise {:g} m/s, {:g} rad/s".format(*reading.disturbance))
    return ", ".join(words)


AXES: dict[str, tuple[str, Callable[[Reading], str]]] = {
    "initial_error": ("start", lambda r: start_words(r).removeprefix("start error ")),
    "meaning_of_Q": ("Q", lambda r: "2 x 2" if r.meaning_of_Q == "input" else "n x n"),
    "stop_radius": ("stop", lambda r: f"{100 * r.stop_radius:g} cm"),
    "faults": ("faults", lambda r: f"{r.faults}"),
    "disturbance": ("motion", lambda r: "twist noise" if any(r.disturbance) else "as commanded"),
    "circle_turn_rate": ("turn rate", lambda r: f"{r.circle_turn_rate:g} rad/s"),
}
"""Fields of a reading: name and value in words."""


def deciding_table(study: LayoutStudy) -> list[list[str]]:
    """Return for each filter the readings under which it beats the EKF, by each open quantity.

    A filter beats the EKF if R, theta and alpha all have smaller errors in most layouts. The
    quantity whose values differ most in the share of readings decides the claim.
    """
    rows = [
        ["case", "filter < EKF", "readings", *(name for name, _ in AXES.values()), "decided by"]
    ]
    for case, name in product(STUDIED, rivals(1)):
        wins = {
            reading: bool(np.all(better_shares(study.grid[case, reading], name, "EKF") > MAJORITY))
            for reading in study.settings.readings(case)
        }
        cells, spread = [], {}
        for axis, words in AXES.values():
            values: dict[str, list[bool]] = {}
            for reading, won in wins.items():
                values.setdefault(words(reading), []).append(won)
            shares = [np.mean(won) for won in values.values()]
            spread[axis] = float(np.ptp(shares))
            text = [f"{value}: {sum(won)} of {len(won)}" for value, won in values.items()]
            cells.append("; ".join(text) if len(values) > 1 else "")
        decisive = max(spread, key=spread.__getitem__)
        found = f"{sum(wins.values())} of {len(wins)}"
        rows.append([case, name, found, *cells, decisive if spread[decisive] else "none"])
    return rows


def start_words(reading: Reading) -> str:
    """Return the start of a reading as words."""
    R, theta, alpha = reading.initial_error
    if not any(reading.initial_error):
        return "exact start"
    return f"start error {100 * R:g} cm, {theta:g}, {alpha:g} rad"


def rivals(M: float | str) -> dict[str, str]:
    """Return the filters that the paper compares with the EKF, with descriptions."""
    own = "M of ones (as printed)" if M == 1 else "M = H'" if M == "HT" else f"M = {M}"
    return {
        "A-EKF (one)": "the A-EKF of one parameter (the first wrong one)",
        "A-EKF (all)": "the A-EKF of all",
        "PI-EKF": f"the PI-EKF with {own}",
        PI_HT: "the PI-EKF with M = H'",
    }


def conclusions(readings: Readings, M: float | str) -> list[str]:
    """Return in three sentences what holds, under which reading, and why.

    With fewer than `MIN_LAYOUTS` layouts they have errors, and no shares of layouts.

    `readings` are one or more of Cases 2 and 4, that of the settings first; `M` that of "PI-EKF".
    """
    called = rivals(M)
    few = next(iter(readings.values())).rmse.shape[1]
    moved = {reading: o for (case, reading), o in readings.items() if case == "2"}
    printed = next(iter(moved))
    shares = {(r, n): better_shares(o, n, "EKF") for r, o in moved.items() for n in called}
    wins = {n: sum(bool(np.all(shares[r, n] > MAJORITY)) for r in moved) for n in called}
    best, name = max(
        ((r, n) for r in moved for n in ("PI-EKF", PI_HT)), key=lambda k: shares[k].min()
    )
    counts = [f"{words} under {wins[n]} of {len(moved)}" for n, words in called.items()]
    if few < MIN_LAYOUTS:
        reading, outcome = next(iter(moved.items()))
        errors = listing([f"{median(outcome, n)[0]:.2g} cm ({n})" for n in ("EKF", *called)])
        return [
            f"Only {count(few, 'layout')}: use --runs {MIN_LAYOUTS} or more for shares of layouts.",
            f"Median error of R in Case 2 (landmarks moved), {reading_words(reading, '2')}: "
            + f"{errors}.",
            _why(readings, reading, PI_HT, called[PI_HT]),
        ]
    what = (
        "What holds: in Case 2 (moved landmarks), errors of R, theta and alpha are smaller than "
        f"the EKF's in most layouts with {listing(counts)} "
        f"{'reading' if len(moved) == 1 else 'readings'}."
    )
    which = (
        f"Best reading: {called[name]} under {reading_words(best, '2')} is better than the EKF in "
        f"{triple(shares[best, name])} of the layouts, and below all three printed errors in "
        f"{percent(beats_printed(moved[best], '2', name))}; {called['PI-EKF']} under "
        f"{reading_words(printed, '2')} in {triple(shares[printed, 'PI-EKF'])} and in "
        f"{percent(beats_printed(moved[printed], '2', 'PI-EKF'))}."
    )
    return [what, which, _why(readings, best, name, called[name])]


def _why(readings: Readings, best: Reading, name: str, called: str) -> str:
    """Compare with dead reckoning under the best reading, and with disturbed motion."""

    def errors(outcome: Outcome) -> tuple[float, ...]:
        return tuple(float(median(outcome, n)[0]) for n in (DEAD_RECKONING, name, "EKF"))

    alone, ours, ekf = errors(readings["2", best])
    words = (
        f"Why: there, the median error of R is {alone:.2g} cm for dead reckoning (no bearings), "
        f"{ours:.2g} cm for {called}, and {ekf:.2g} cm for the EKF"
    )
    if alone < min(ours, ekf):
        words += (
            ": odometry alone is better than both filters, so less weight of the bearings helps"
        )
    disturbed = (r for case, r in readings if case == "4" and any(r.disturbance))
    same = next((r for r in disturbed if r[:2] == best[:2]), None)  # of the same start and Q
    if same is not None:
        there = readings["4", same]
        alone, ours, ekf = errors(there)
        speed, turn = same.disturbance
        words += (
            f". With disturbed motion ({speed:g} m/s and {turn:g} rad/s a sample, Case 4) it is "
            f"{alone:.2g} cm for dead reckoning, {ekf:.2g} cm for the EKF and {ours:.2g} cm "
            f"for {called}"
        )
        if there.rmse.shape[1] >= MIN_LAYOUTS:
            share = triple(better_shares(there, name, "EKF"))
            words += f", which is better than the EKF in {share}"
    return words + "."


def claims(study: LayoutStudy) -> list[Claim]:
    """Test all claims of the paper that results can test."""
    table = [*_start_claims(study)]
    for start in study.starts:
        table += [*_order_claims(study, start), *_convergence_claims(study, start)]
    return sorted(table, key=lambda c: c.claim)


def _start_claims(study: LayoutStudy) -> Iterator[Claim]:
    """Test whether a start error allows the printed R, which is that of a single run."""
    cases: tuple[CaseName, ...] = ("2", "4")
    for start, case in product(study.starts, cases):
        reading = study.reading(case, initial_error=start)
        printed = PRINTED[case]["PI-EKF"][0]
        shares = [
            float(np.mean(study.grid[case, reading].of(name)[:, 0] * 100 < printed))
            for name in ("PI-EKF", PI_HT)
        ]
        bound = 100 * root_mean_square(study.bounds[case, reading].of(BOUND)[:, 0])
        yield Claim(
            "The printed R of the PI-EKF is that of a run",
            f"Case {case}, {start_words(reading)}",
            "unlikely" if max(shares) < UNLIKELY else "possible",
            f"{percent(shares[0])} (M of ones) and {percent(shares[1])} (M = H') of the runs "
            f"are below {printed:g} cm; the bound on the RMSE over all runs is {bound:.2g} cm",
            command(study, reading),
        )


def _order_claims(study: LayoutStudy, start: Any) -> Iterator[Claim]:
    """Test the order of errors, with and without moved landmarks."""
    sentences: list[tuple[str, CaseName, str, Sequence[str]]] = [
        ("The PI-EKF is better than the EKF (Table 2)", "2", "", ("PI-EKF", PI_HT)),
        ("The A-EKF is better than the EKF (Table 2)", "2", "", ("A-EKF (one)", "A-EKF (all)")),
        ("PI-EKF in absence of faults (Table 3)", "1", "its caption, ", ("PI-EKF", PI_HT)),
        ("PI-EKF in absence of faults (Table 3)", "4", "its text, ", ("PI-EKF", PI_HT)),
    ]
    for claim, case, where, names in sentences:
        reading = study.reading(case, initial_error=start)
        for name in names:
            shares = better_shares(study.grid[case, reading], name, "EKF")
            beaten = beats_printed(study.grid[case, reading], case, name)
            figure = f"in {triple(shares)} of layouts; {percent(beaten)} below all printed"
            under = f"{where}Case {case}, {name}, {start_words(reading)}"
            yield Claim(claim, under, decide(shares), figure, command(study, reading))


def _convergence_claims(study: LayoutStudy, start: Any) -> Iterator[Claim]:
    """Test the claims on convergence and homing."""
    circle, precise, home = (study.reading(c, initial_error=start) for c in ("4", "1", "2"))
    clean, faulty = study.grid["4", circle], study.varied[FAULTY, "4", start]
    circles = {0: (clean, study.varied[LONG, "4", start])}
    circles[2] = faulty, study.varied[LONG_FAULTY, "4", start]
    single = study.varied[AS_SET, "3 (one fault)", start]
    medians = [median(single, name) for name in ("EKF", "A-EKF (one)")]
    yield Claim(
        "One wrong parameter is estimated easily (Case 3)",
        f"Case 3, A-EKF (one), {start_words(home)}",
        decide(better_shares(single, "A-EKF (one)", "EKF")),
        f"R {medians[0][0]:.2g} cm (EKF), {medians[1][0]:.2g} cm (A-EKF); smaller errors in "
        f"{triple(better_shares(single, 'A-EKF (one)', 'EKF'))} of layouts",
        command(study, study.reading("3 (one fault)", initial_error=start)),
    )
    for name in ("EKF", "A-EKF (all)", "PI-EKF", PI_HT):
        for faults, outcomes in circles.items():
            early, late = (_final(o, name) for o in outcomes)
            falls = np.mean(late < early[: len(late)], axis=0)
            ends = (np.median(e, axis=0) * TO_PAPER_UNITS for e in (early, late))
            words = " and ".join("{:.2g} cm, {:.2g}, {:.2g} rad".format(*end) for end in ends)
            seconds = f"{study.settings.paper.assumed.circle_time:g} and 200 s"
            large = ", even with large perturbations of the parameters" if faults else ""
            claim = f"It converges asymptotically{large}"
            under = f"Case 4, {name}, {start_words(circle)}, {count(faults, 'wrong home bearing')}"
            figure = f"errors after {seconds}: {words}; smaller in {triple(falls)} of layouts"
            change = {"circle_time": 200, "circle_faults": faults}
            long = command(study, circle, {"assumed": change})
            yield Claim(claim, under, decide(falls), figure, long)

        outcome = study.grid["2", home]
        radius = 2 * home.stop_radius
        share = np.array([np.mean(outcome.final_distance[outcome.names.index(name)] < radius)])
        figure = f"true end within {100 * radius:g} cm of home in {percent(share[0])} of layouts"
        under = f"Case 2, {name}, {start_words(home)}"
        holds = "holds" if share[0] == 1 else "does not hold"
        yield Claim("Homing is guaranteed", under, holds, figure, command(study, home))
        if name == "EKF":
            claim = "The conventional EKF fails under uncertainty"
            yield Claim(claim, under, decide(1 - share), figure, command(study, home))

        if any(start):
            first = 0.6745 * np.array(start)  # the median size of a normal error
            last = _final(study.grid["1", precise], name)
            nearer = np.mean(last < first, axis=0)[[0, 2]]
            figure = "R {:.2g} cm and alpha {:.2g} rad at the start, {:.2g} and {:.2g} at the end"
            both = np.array([first, np.median(last, axis=0)]) * TO_PAPER_UNITS
            yield Claim(
                "It converges when precise information is given",
                f"Case 1, {name}, {start_words(precise)}",
                decide(nearer),
                figure.format(*both[:, [0, 2]].ravel())
                + f" in the median; below it in {triple(nearer)}",
                command(study, precise),
            )


def decide(shares: np.ndarray) -> str:
    """Return the decision on a claim that holds in shares of the layouts."""
    most = shares > MAJORITY
    if np.all(shares > 0.95):
        return "holds"
    if most.all():
        return "holds in most layouts"
    return "holds in part" if most.any() else "does not hold"


def command(study: LayoutStudy, reading: Reading, change: Mapping[str, Any] | None = None) -> str:
    """Return the command for one reading."""
    tree = study.settings.read(reading).model_dump(mode="json")
    for section, values in (change or {}).items():
        tree[section] |= values
    usual = PaperSettings().model_dump(mode="json")
    words = ["homeward study paper"]
    for section in ("printed", "assumed"):
        for key, value in tree[section].items():
            if value != usual[section][key]:
                text = value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
                words.append(f"--set '{section}.{key}={text}'")
    return " ".join(words)


def median(outcome: Outcome, name: str) -> np.ndarray:
    """Return the median RMSE of R [cm], theta, alpha [rad], (3,)."""
    return np.asarray(np.median(outcome.of(name), axis=0) * TO_PAPER_UNITS)


def _final(outcome: Outcome, name: str) -> np.ndarray:
    return np.asarray(outcome.final[outcome.names.index(name)])


def triple(shares: np.ndarray) -> str:
    """Return shares as "87, 83 and 87 %"."""
    return listing([f"{100 * s:.0f}" for s in shares]) + " %"
