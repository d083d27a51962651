"""A masonry wall of blocks and cohesive joints under a ground motion, as a model."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jax import lax

from structid.core.errors import InputError, check_choice, fixed_and_free
from structid.core.hashing import digest
from structid.core.progress import Progress
from structid.core.validation import check_arguments
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import Excitation, check_one_signal
from structid.histories import Histories
from structid.mechanics.cohesive_laws import JOINT_LAWS, CohesiveLaw, cohesive_law
from structid.models.base import Map
from structid.models.hysteretic.hysteretic_parameters import check_free
from structid.models.masonry.equations.condensed import Condensed
from structid.models.masonry.equations.loaded_wall import frequencies, loaded
from structid.models.masonry.equations.one_by_one import runs_one_by_one
from structid.models.masonry.equations.static_wall import BeamedWall, StaticWall
from structid.models.masonry.equations.wall_channels import WallChannels, Works, check_wall_channels
from structid.models.masonry.equations.wall_motion import WallState, start, stepping
from structid.models.masonry.finite_elements.assembly import Assembly, Masonry
from structid.models.masonry.finite_elements.layout import FACADE, Wall
from structid.models.masonry.finite_elements.mesh import Mesh, mesh_of
from structid.models.masonry.wall_failure import name_failures, with_rows
from structid.models.masonry.wall_film import WallFilm
from structid.models.masonry.wall_parameters import OPTIONAL, PARAMETER_UNITS, check_priors_of, check_value
from structid.models.masonry.wall_pictures import drawn_joint, drawn_mesh, pictures_of
from structid.models.pictures import ModelPicture
from structid.models.traceable import TraceableModel, TracedExcitation
from structid.probability.space import ParameterSpace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WATCHED = ("support_lost", "weakest_joint")
"""Channels that determine whether a run is valid."""
CUTS = (4, 16, 64)
"""Numbers by which the step is divided, in turn, to repeat a run in which no equilibrium of the joints is found."""
MOST_BLOCKS_IN_LANES = 40
"""Largest number of blocks for compiled vector code, whose compile time grows with this number. Larger walls use sparse
factorisation."""


@check_arguments
@dataclass(frozen=True, eq=False)
class MasonryWall(TraceableModel):
    """A wall of linear plane-stress blocks, cohesive mortar joints and a loading beam, on a moving base.

    ::

        M u″ + C u′ + f(u) = p − M ι a_g,    C = a₀ M + a₁ K

    The vertical load p is applied first. K is the symmetric part of the tangent of the loaded wall, and a₀, a₁ give modes 1 and 3
    the damping ratio ζ. Joints follow a law of `structid.mechanics.cohesive_laws`. Displacements are small. Every step uses
    average acceleration with Newton iterations.

    Parameters
    ----------
    normal_energy, tangential_energy : float, optional
        Works of separation φ_n and sliding φ_t [N/m].
    normal_strength, tangential_strength : float, optional
        σ_max and τ_max [Pa].
    joint_law : {"smc-np2", "damage-friction"}
        SMC in separation and NP2 in over-closure, without memory; or SMC with damage, contact and friction.
    friction : float
        Friction coefficient μ of ``"damage-friction"``.
    damping_ratio : float
        ζ.
    wall : Wall
        Geometry and courses; by default the façade of the thesis.
    masonry : Masonry
        Materials and loads.
    characteristic_length : {"exponential", "xu-needleman"}
        δ_t = φ_t / (τ_max e), for which the work of sliding is φ_t; or the published φ_t / (τ_max √(e/2)).
    joint_points : {"ends", "gauss"}
        Positions of the two joints on a line.
    base_joint : bool
        Whether the wall stands on joints; otherwise its lowest nodes are fixed.
    step : float
        Longest integration step [s].
    free : sequence of str
        Names of the parameters that are given with every run, in the order of the columns.
    channels : sequence of str
        Channels to record: ``"ux_top_left"``, ``"uy_top_right"``, ``"ux_node_12"``, …; ``"drift"`` (of the top left corner from
        rest), ``"base_shear"``, ``"largest_opening"``, ``"largest_slip"``, ``"largest_penetration"``; ``"support_lost"``, which
        is 1 once a bed joint has slid by half its length or opened by half a block; ``"weakest_joint"``, the number of this
        joint in ``mesh.joints``; and the energies ``"kinetic_energy"``, ``"strain_energy"``, ``"joint_energy"``,
        ``"damping_energy"``, ``"input_energy"`` and ``"load_energy"``.

    Examples
    --------
    >>> import structid as si
    >>> wall = si.MasonryWall(normal_energy=5.5e3, normal_strength=1.05e6, tangential_energy=4e5, tangential_strength=2e6)
    >>> print(wall)
    MasonryWall: 15 blocks, 34 joints, f 2.632, 9.697, 16.56 Hz under its load
    """

    normal_energy: float | None = None
    normal_strength: float | None = None
    tangential_energy: float | None = None
    tangential_strength: float | None = None
    joint_law: str = "smc-np2"
    friction: float = 0.0
    damping_ratio: float = 0.03
    wall: Wall = FACADE
    masonry: Masonry = field(default_factory=Masonry)
    characteristic_length: str = "exponential"
    joint_points: str = "ends"
    base_joint: bool = False
    step: float = 1e-3
    free: tuple[str, ...] = ()
    channels: tuple[str, ...] = ("ux_top_left",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "free", check_free("MasonryWall", self.free, tuple(PARAMETER_UNITS)))
        check_choice("MasonryWall.joint_law", self.joint_law, JOINT_LAWS)
        check_choice("MasonryWall.characteristic_length", self.characteristic_length, ("exponential", "xu-needleman"))
        for name in PARAMETER_UNITS:
            value = getattr(self, name)
            if name in self.free and value is not None and name not in OPTIONAL:
                raise fixed_and_free(f"MasonryWall.{name}")
            if name not in self.free:
                check_value(name, value)
        if not self.step > 0.0:
            raise InputError("MasonryWall.step", f"{self.step:g}", "a positive time in seconds")
        object.__setattr__(self, "channels", check_wall_channels(self.mesh, self.channels))

    # --- geometry -----------------------------------------------------------------------------------------------

    @cached_property
    def mesh(self) -> Mesh:
        """Nodes, blocks, joints and bars."""
        return mesh_of(self.wall, self.joint_points, self.base_joint)

    @cached_property
    def condensed(self) -> Condensed:
        """Equations of motion, condensed to the jumps of the joints."""
        return Condensed(Assembly(self.mesh, self.masonry), JOINT_LAWS[self.joint_law])

    # --- response -----------------------------------------------------------------------------------------------

    def _values(self, theta: Any) -> dict[str, Any]:
        """Return every parameter by name: floats for fixed parameters, arrays over runs for free parameters."""
        values = {name: getattr(self, name) for name in PARAMETER_UNITS}
        return values | {name: theta[:, i] for i, name in enumerate(self.free)}

    def _law(self, values: dict[str, Any]) -> CohesiveLaw:
        return cohesive_law(
            values["normal_energy"],
            values["normal_strength"],
            values["tangential_energy"],
            values["tangential_strength"],
            self.characteristic_length,
            values["friction"],
        )

    def static_force(self, theta: Any) -> StaticWall:
        """Return the force of the wall on a rigid beam, which replaces the bars; see `TraceableModel.static_force`."""
        return StaticWall(self._beamed, self._law(self._values(theta)), theta.shape[0])

    @cached_property
    def _beamed(self) -> BeamedWall:
        return BeamedWall(self.mesh, self.masonry, JOINT_LAWS[self.joint_law])

    def time_loop(self, theta: Any, excitation: TracedExcitation) -> TimeLoop:
        """Return the loop over the record; see `TraceableModel.time_loop`."""
        values, runs, stages = self._values(theta), theta.shape[0], excitation.stages
        law, dt = self._law(values), excitation.dt / stages.shape[1]
        at_rest = loaded(self.condensed, law, runs, values["damping_ratio"])
        step = stepping(self.condensed, law, at_rest, dt)
        histories = WallChannels(self.condensed, self.channels, law, at_rest, dt)

        def substep(carried: tuple[WallState, Works], stage: Any) -> tuple[tuple[WallState, Works], None]:
            state, works = carried
            after = step(state, stage[2])
            return (
                after,
                histories.added(works, state, after, (stage[0], stage[2])) if histories.added_up else works,
            ), None

        def sample(carried: tuple[WallState, Works], row: Any) -> tuple[tuple[WallState, Works], Any]:
            observed = histories.observe(*carried, row[0, 0])
            if len(row) == 1:
                return substep(carried, row[0])[0], observed
            return lax.scan(substep, carried, row)[0], observed

        beginning = start(self.condensed, at_rest, stages[0, 0, 0]), histories.nothing(runs)
        return TimeLoop(beginning, sample, stages, excitation.dropped_samples, lambda carried: carried[0].converged)

    def run(
        self, theta: np.ndarray, excitation: Excitation, progress: Progress | None = None, map: Map | None = None
    ) -> Histories:
        """Run rows of parameters; see `TraceableModel.run`.

        If no equilibrium of the joints is found in a step, the run is repeated with shorter steps, down to 1/64 of the
        step. If a bed joint loses its support, the structure has failed from this time on.
        """
        watched = self._watched
        if len(self.mesh.blocks) > MOST_BLOCKS_IN_LANES:
            histories = self._one_by_one(theta, excitation, watched.channels, progress)
            return name_failures(histories, self.mesh, self.step / CUTS[-1], self.channels)
        histories = TraceableModel.run(watched, theta, excitation, progress, map)
        for cut in CUTS:
            lost = np.flatnonzero(~histories.done)
            if not len(lost):
                break
            finer = replace(watched, step=watched.step / cut)
            histories = with_rows(histories, lost, TraceableModel.run(finer, theta[lost], excitation))
        return name_failures(histories, self.mesh, self.step / CUTS[-1], self.channels)

    @cached_property
    def _watched(self) -> MasonryWall:
        """Copy of the wall that also records the channels for the check of runs; it is cached with its compiled code."""
        return replace(self, channels=tuple(dict.fromkeys((*self.channels, *WATCHED))))

    def _one_by_one(
        self, theta: np.ndarray, excitation: Excitation, channels: tuple[str, ...], progress: Progress | None
    ) -> Histories:
        """Compute runs of a wall with too many blocks for compiled vector code."""
        values = [self._values(row[None]) for row in theta]
        of_runs = [{name: float(np.ravel(value)[0]) for name, value in of_run.items()} for of_run in values]
        laws = [(self._law(of_run), of_run["damping_ratio"]) for of_run in of_runs]
        return runs_one_by_one(self.condensed, laws, channels, excitation, self.steps_in_sample(excitation), progress)

    def steps_in_sample(self, excitation: Excitation) -> int:
        """Count the integration steps in a sample; see `TraceableModel.steps_in_sample`."""
        return max(int(np.ceil(excitation.dt / self.step - 1e-9)), 1)

    # --- pictures -----------------------------------------------------------------------------------------------

    @check_arguments
    def film(self, excitation: Excitation, theta: np.ndarray | None = None) -> WallFilm:
        """Compute the motion of every node of the wall in one run.

        Parameters
        ----------
        excitation : Excitation
            A ground motion.
        theta : ndarray, shape (parameter,), optional
            Parameters in SI, in the order of `free`; optional if no parameter is free.

        Returns
        -------
        WallFilm
            Motion up to the end of the run.

        Raises
        ------
        InputError
            If no equilibrium of the wall at rest is found.
        """
        mesh = self.mesh
        moving = np.setdiff1d(np.arange(len(mesh.nodes)), mesh.fixed)
        points = [f"u{direction}_node_{node}" for node in moving for direction in "xy"]
        row = np.zeros((1, 0)) if theta is None else np.asarray(theta, dtype=float).reshape(1, -1)
        histories = self.recording("drift", "base_shear", *points).simulate(row, excitation)
        values = histories.values[0, np.isfinite(histories.values[0]).all(axis=1)]
        if not len(values):
            raise InputError("MasonryWall.film", f"the run failed: {histories.reasons[0]}", "a wall in equilibrium")
        displacements = np.zeros((len(values), len(mesh.nodes), 2))
        displacements[:, moving] = values[:, 2:].reshape(len(values), -1, 2)
        return WallFilm(mesh, excitation.dt, displacements, values[:, 0], values[:, 1])

    def pictures(self, theta: np.ndarray, excitation: Excitation) -> list[ModelPicture]:
        """Return pictures of the wall in one run; see `Model.pictures`."""
        return pictures_of(self.plot, cache(lambda: self.film(excitation, theta)))

    def plot(self, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the mesh: blocks with their numbers, joints, beam, supports, loads, recorded points.

        Parameters
        ----------
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        Figure
            Figure with one panel.
        """
        return drawn_mesh(self.condensed.assembly, self.channels, save)

    def plot_joint(self, theta: np.ndarray | None = None, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the joint law: traction against opening and against slip, with an unloading (figure 5.1 of the thesis).

        Parameters
        ----------
        theta : ndarray, shape (parameter,), optional
            Parameters in SI, in the order of `free`; optional if no parameter is free.
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        Figure
            Figure with two panels.
        """
        row = np.zeros((1, 0)) if theta is None else self.parameters(np.atleast_2d(theta))
        return drawn_joint(self._law(self._values(row)), JOINT_LAWS[self.joint_law], save)

    # --- model interface ----------------------------------------------------------------------------------------

    @property
    def loop_channels(self) -> dict[str, tuple[str, str, str]]:
        """Channel names of drift, base shear and joint energy; see `Model.loop_channels`."""
        return {"": ("drift", "base_shear", "joint_energy")}

    @property
    def kind_in_words(self) -> str:
        """Descriptive name of the model."""
        return "masonry wall"

    def recording(self, *channels: str) -> MasonryWall:
        """Return a copy of this wall that records other channels."""
        return replace(self, channels=channels)

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse any excitation except a ground motion."""
        check_one_signal("MasonryWall", excitation)
        if excitation.kind != "ground_motion":
            raise InputError("MasonryWall", f"a {excitation.kind}", "a GroundMotion")
        if self.step > excitation.dt * (len(excitation) - 1):
            raise InputError(
                "MasonryWall.step", f"{self.step:g} s", f"a step shorter than the record of {excitation.duration:g} s"
            )

    def check_priors(self, space: ParameterSpace) -> None:
        """Refuse priors with a wrong unit or with values that are not positive; see `Model.check_priors`."""
        check_priors_of(self.free, space)

    @property
    def content_hash(self) -> str:
        """Hash of all settings."""
        return digest("MasonryWall", {f.name: repr(getattr(self, f.name)) for f in fields(self)})

    def frequencies(self) -> np.ndarray:
        """Compute the natural frequencies of the loaded wall.

        Returns
        -------
        ndarray, shape (dof,)
            Frequencies [Hz] in ascending order.

        Raises
        ------
        InputError
            If parameters of the joints are free.
        """
        if self.free:
            raise InputError(
                "MasonryWall.frequencies", f"free parameters: {', '.join(self.free)}", "fixed joint parameters"
            )
        return frequencies(self.condensed, self._law(self._values(np.zeros((1, 0)))))

    def __str__(self) -> str:
        mesh = f"MasonryWall: {len(self.mesh.blocks)} blocks, {len(self.mesh.joints)} joints"
        if self.free:
            return f"{mesh}, free: {', '.join(self.free)}"
        return f"{mesh}, f {', '.join(f'{f:.4g}' for f in self.frequencies()[:3])} Hz under its load"
