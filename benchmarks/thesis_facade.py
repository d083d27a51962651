"""Chapters 4 and 5 of the thesis: the hybrid tests of a masonry façade, its prior range, and its NARX."""

from __future__ import annotations

import time
import tomllib
from pathlib import Path

import numpy as np
from facade import BOX, COORDINATES, MONITORED, el_centro, wall
from thesis_rows import Chapter, Clock, Row, figures_folder, joined

import structid as si
from structid.figures import hybrid as hybrid_figures
from structid.figures import passages as passage_figures
from structid.study.packaged import template
from structid.study.programmes.planned_programme import planned
from structid.study.programmes.programme_file import programme_file
from structid.surrogates.narx.structure.candidate_terms import prony_terms

LIMIT, STANDS_UNTIL = 0.13, 2.36
"""Runs that exceed this drift [m] before this time [s] are omitted from the NARX, as in the thesis."""
DESIGN = 200
"""Number of runs in the thesis's experimental design."""
MILESTONES = (1.25, 1.45, 1.75, 2.2, 2.4)
"""Milestones of test #5 in the thesis [s]."""
JOINTS = dict(normal_energy=12.0, normal_strength=0.18e6, tangential_energy=130.0, tangential_strength=0.27e6)
"""Mortar joints of the virtual specimen, in SI units."""

BRICKS = np.array(
    [
        [985.0, 22.7],
        [1195.9, 27.1],
        [1194.0, 27.1],
        [760.9, 17.4],
        [871.1, 19.9],
        [1099.9, 25.1],
        [1123.9, 25.7],
        [1001.7, 23.2],
        [1185.8, 27.1],
        [1108.4, 25.5],
    ]
)
"""Table 4.2: force [kN] and strength [MPa]."""
MORTAR = {"K": (15.36, 14.17, 15.48, 17.12, 15.25, 14.27), "S": (2.73, 2.65, 2.86, 2.95, 2.65, 2.43)}
"""Table 4.3: compressive strength [MPa]."""
MASONRY = np.array([[460.47, 5.20, 4.51], [421.89, 4.77, 4.01], [482.69, 5.45, 4.10]])
"""Table 4.4: force [kN], strength [MPa], modulus [GPa]."""


# --- chapter 4 ----------------------------------------------------------------------------------------------------


def materials() -> list[Row]:
    """Means of the material tests, computed from the single values."""
    force, strength = BRICKS.mean(axis=0)
    mortar = {name: np.array(values) for name, values in MORTAR.items()}
    dropped = {name: values[np.argsort(np.abs(values - values.mean()))[:-1]].mean() for name, values in mortar.items()}
    load, compressive, modulus = MASONRY.mean(axis=0)
    return [
        Row("T 4.1", "sizes and densities of a brick", why="data of the manufacturer; nothing to compute"),
        Row(
            "T 4.2",
            "bricks in compression",
            joined(["1052.7 kN", "24.1 MPa, sd 3.3"]),
            joined([f"{force:.1f} kN", f"{strength:.1f} MPa, sd {BRICKS[:, 1].std(ddof=1):.1f}"]),
            "–",
            "",
        ),
        Row(
            "T 4.3",
            "mortar in compression",
            joined(["K 14.90 MPa", "S 2.77 MPa"]),
            joined([f"{name} {values.mean():.2f} MPa" for name, values in mortar.items()]),
            joined([f"{name} {value:.2f} MPa" for name, value in dropped.items()]),
            "the printed means are over five of six values, without the most distant value",
        ),
        Row(
            "T 4.4, 4.5",
            "masonry",
            joined(["455.02 kN, 5.14 MPa", "E 4.21 GPa"]),
            joined([f"{load:.2f} kN, {compressive:.2f} MPa", f"E {modulus:.2f} GPa"]),
            "–",
            "the modulus is the default of `Masonry`; table 4.5 gives its unit as MPa",
        ),
    ]


def tests(clock: Clock, folder: Path, quick: bool) -> list[Row]:
    """The six tests on a virtual specimen, and the strains of a wall."""
    content = tomllib.loads(template("hybrid_facade"))
    del content["learning"]  # not part of the thesis
    if quick:
        content["test"] = content["test"][:1]
        content["record"]["trim"] = ["5 s", "6 s"]
    programme = planned(programme_file().model_validate(content), Path())
    began = time.perf_counter()
    found = programme.programme().run().tests
    seconds = time.perf_counter() - began
    clock("hybrid tests")
    first = next(iter(found.values()))
    horizontal = next(k for k, c in enumerate(first.description.channels) if c.unit == "m")
    curves = [
        (name, 1e3 * (t.datum[horizontal] + t.moves.measured[:, horizontal]), 1e-3 * t.moves.force[:, horizontal])
        for name, t in found.items()
    ]
    hybrid_figures.loops_of_tests(curves, ("displacement", "force"), ("mm", "kN"), save=folder / "hybrid_loops")
    largest = {name: float(np.abs(x).max()) for name, x, _ in curves}
    floor = first.description.channels[horizontal].name
    stands = [[(floor, t.moves.time, x)] for (_, x, _), t in zip(curves, found.values(), strict=True)]
    ends = [None if t.finished else float(t.moves.time[-1]) for t in found.values()]
    hybrid_figures.histories_of_tests(stands, list(found), "mm", ends, save=folder / "hybrid_histories")
    shaken = si.MasonryWall(**JOINTS, joint_law="damage-friction", friction=0.6)
    record = el_centro().trim(0.0, 0.3) if quick else el_centro()
    record.plot(folder / "record_of_the_wall")
    film = shaken.film(record)
    instants = [min(round(at / film.dt), len(film.drift) - 1) for at in MILESTONES]
    film.plot_strains(sorted(set(instants)), save=folder / "strains")
    clock("strains of a wall at milestones")
    spectrum = record.response_spectrum(np.array([0.1]), damping_ratio=0.03)
    return [
        Row(
            "T 4.6",
            "six tests, #1a to #5",
            "PGA 0.45 to 6.36 m/s²; #5 diverges at 2.41 s",
            joined(f"#{name} {largest[name]:.2g} mm" for name in found),
            f"{seconds:.0f} s in total",
            "a virtual specimen in the same programme; the thesis's specimen and its forces are not available",
        ),
        Row(
            "F 4.8",
            "record, and spectrum at 3 % damping",
            "6.36 m/s²",
            f"{record.pga:.2f} m/s²; S_a(0.1 s) {spectrum.pseudo_acceleration[0]:.1f} m/s²",
            "–",
            "El Centro; the picture shows the spectrum at 5 % damping",
        ),
        Row(
            "F 4.9, 4.10",
            "loops and displacements of the tests",
            published="see below",
            why="virtual specimen, which keeps its damage from test to test",
        ),
        Row(
            "F 4.11",
            "von Mises strains at T1 to T5 of test #5",
            "1.25, 1.45, 1.75, 2.2, 2.4 s",
            "see below",
            "–",
            "computed for the whole wall, as a camera would see it; the thesis's pictures are measured",
        ),
    ]


def hybrid_chapter(clock: Clock, quick: bool) -> Chapter:
    """Return all rows and pictures of chapter 4.

    Parameters
    ----------
    clock : Clock
        Prints the time of each part.
    quick : bool
        Whether the run is as short as possible.

    Returns
    -------
    Chapter
        Rows and pictures.
    """
    folder = figures_folder(quick)
    rows = [*materials(), *tests(clock, folder, quick)]
    drawn = (
        ("record_of_the_wall", "F 4.8: the record of the wall tests, and its spectrum."),
        ("hybrid_loops", "F 4.9: force against displacement of the virtual specimen in each test."),
        ("hybrid_histories", "F 4.10: displacements of the virtual specimen."),
        ("strains", "F 4.11: von Mises strain of the wall at times T1 to T5 of test #5."),
    )
    words = (
        "The tests were done in a laboratory, and their histories are not available. A virtual specimen undergoes the same "
        "programme. Figures 4.1 to 4.7 and 4.12 are sketches and photographs."
    )
    return Chapter("Chapter 4: hybrid tests", words, tuple(rows), drawn)


# --- chapter 5 ----------------------------------------------------------------------------------------------------


def passages(clock: Clock, folder: Path, quick: bool) -> list[Row]:
    """Figures 5.3 and 5.4: first passages over the prior range, and over its high-strength part."""
    space, record = si.ParameterSpace(**BOX), el_centro()
    runs = si.Campaign(wall("drift"), record, space.sample(64 if quick else 10_000, 1)).run()
    clock(f"{len(runs):,} walls")
    above = {"normal_strength": 1.0e6, "tangential_strength": 1.5e6}
    study = si.parameter_study(runs, "drift", (LIMIT,), above)
    [found] = study.passages
    points, units = np.asarray(runs.design.values) / space.factors, tuple(space.units.values())
    passage_figures.times(points, space.names, units, found.time, record.duration, save=folder / "passages")
    passage_figures.pairs(points, space.names, units, found.time, save=folder / "passages_pairs")
    inside = study.inside
    passage_figures.pairs(points[inside], space.names, units, found.time[inside], save=folder / "passages_strong")
    early = float(np.mean(found.time < STANDS_UNTIL))
    strength = np.asarray(runs.design.values)[found.passed][:, space.names.index("tangential_strength")]
    clock("passages")
    return [
        Row(
            "F 5.3",
            f"instability over the prior range, {len(runs):,} runs",
            "87 % before 2.36 s",
            f"{found.passed.mean():.1%} exceed {1e3 * LIMIT:.0f} mm, {early:.1%} before 2.36 s",
            f"none with τ_max above {strength.max() * 1e-6:.2f} MPa" if len(strength) else "none",
            "in the thesis, runs are unstable if the time integration does not converge; structid's runs all converge, and are "
            "unstable if the drift exceeds 5 % of the height",
        ),
        Row(
            "F 5.4",
            "instability for σ_max > 1 MPa and τ_max > 1.5 MPa",
            "none",
            f"{found.passed[inside].mean():.1%} of {inside.sum():,}",
            "–",
            "agrees",
        ),
    ]


def narx(clock: Clock, folder: Path, quick: bool) -> list[Row]:
    """Figures 5.5 to 5.10: one NARX structure for all stable runs, coefficients of each run by least squares."""
    design = si.ParameterSpace(**BOX, coordinates=COORDINATES).sample(30 if quick else 300, 1)
    shaken = wall(*MONITORED, "drift").simulate(design, el_centro())
    keep = np.flatnonzero(~(si.first_passage(shaken, "drift", LIMIT) < STANDS_UNTIL))[: 20 if quick else DESIGN]
    rows = []
    printed = dict(zip(MONITORED, (0.128, 0.179, 0.787), strict=True))
    for number, channel in enumerate(MONITORED):
        own = si.Histories(shaken.values[keep][:, :, [number]], shaken.dt, (channel,))
        runs = si.Runs.from_histories(design[keep], own, el_centro())
        terms = {channel: [str(t) for t in prony_terms(10, 5, outputs=("y",))]}
        most = 4 if quick else None
        fitted = si.PCNARX(
            terms=terms, training="per-experiment", selection="lars", most_terms=most, limit=np.inf, held_out=0.0
        ).fit(runs)
        found = fitted.validate_structure(runs, refined=False)
        found.plot(save=folder / f"facade_{channel}")
        finite = found.overall[np.isfinite(found.overall)]
        clock(f"NARX of {channel}: {found}")
        rows.append(
            Row(
                f"F 5.{5 + number}, 5.{8 + number}",
                f"NARX of {channel}, Prony terms, {len(runs)} runs",
                f"ε̄ {printed[channel]}",
                f"ε̄ {finite.mean():.2g}, median {np.median(found.overall):.2g}, {found.diverged} diverged, "
                f"{len(fitted.terms)} terms",
                joined(BEST[channel]),
                "another record and another criterion of stability; structid adds cross-channel terms and trains on "
                "the free run",
            )
        )
    return rows


BEST = {
    "ux_top_left": ("single runs 9.1e-05", "prior range 0.0012"),
    "uy_top_left": ("single runs 0.0045", "prior range 0.016"),
    "uy_top_right": ("single runs 0.0098", "prior range 0.028"),
}
"""Mean errors of single runs and median errors of one PC-NARX, from `benchmarks/facade_narx.py`, which takes 40 minutes."""


def facade_chapter(clock: Clock, quick: bool) -> Chapter:
    """Return all rows and pictures of chapter 5.

    Parameters
    ----------
    clock : Clock
        Prints the time of each part.
    quick : bool
        Whether the run is as short as possible.

    Returns
    -------
    Chapter
        Rows and pictures.
    """
    folder = figures_folder(quick)
    middle = si.ParameterSpace(**BOX).quantile(np.full(len(BOX), 0.5))
    model = wall("drift")
    model.plot_joint(middle, folder / "joint")
    model.plot(folder / "mesh")
    mesh = model.mesh
    clock("constitutive law of the joints, and mesh")
    rows = [
        Row(
            "F 5.1",
            "traction and separation of a joint",
            "as McGarry et al. (2014)",
            "see below",
            "fracture energies to 1e-8",
            "closed-form law; its fracture energies φ_n and φ_t are tested, the curves of the paper are not available",
        ),
        Row(
            "T 5.1",
            "priors of the joints",
            "U[1, 10]e3, U[0.87, 1.23]e6, U[0.5, 8]e5, U[0.3, 3.7]e6",
            "the same",
            "–",
            "",
        ),
        Row(
            "F 5.2",
            "the mesh",
            "15 blocks, 34 joints, 7 bars, 120 dof",
            f"{len(mesh.blocks)} blocks, {len(mesh.joints)} joints, {len(mesh.bars)} bars, {len(mesh.free)} free dof",
            "–",
            "the 120 dof include the supports",
        ),
        *passages(clock, folder, quick),
        *narx(clock, folder, quick),
    ]
    drawn = (
        ("joint", "F 5.1: traction of a joint against its opening and against its slip."),
        ("mesh", "F 5.2: the mesh."),
        ("passages", "F 5.3: time of first passage of 130 mm against each parameter."),
        ("passages_pairs", "F 5.3: time of first passage over pairs of parameters."),
        ("passages_strong", "F 5.4: time of first passage in the high-strength part of the prior range."),
        *(
            (f"facade_{c}", f"F 5.{5 + k}, 5.{8 + k}: free runs of the NARX of {c} at the points of its design.")
            for k, c in enumerate(MONITORED)
        ),
    )
    words = "El Centro with a PGA of 6.36 m/s²: 2.5 s sampled at 10 ms, integrated with a time step of 1 ms."
    return Chapter("Chapter 5: the façade", words, tuple(rows), drawn)
