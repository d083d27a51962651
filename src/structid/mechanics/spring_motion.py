"""Motion of masses on springs with a hysteretic law: one loop for ground motions, forces and imposed displacements."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from jax import lax

from structid.engine.array_module import namespace
from structid.engine.time_loop import State, TimeLoop
from structid.mechanics.hysteresis import LONGEST_STEP


class SpringMotion(ABC):
    """Masses with u″ = a(u, u′, f, x) on springs with the forces f, under a signal x.

    The force of a spring depends on the path of its deformation, not on time. In a step of the classical Runge–Kutta method every
    stage therefore moves the springs from their state at the beginning of the step. A spring whose deformation turns within the
    step first moves to the turning point.
    """

    kind: str
    """Kind of the excitation: ``"ground_motion"``, ``"force"`` or ``"displacement"``."""

    @abstractmethod
    def at_rest(self) -> tuple[State, Any, Any]:
        """Return the springs' state, the displacements and the velocities at the beginning."""

    @abstractmethod
    def moved(self, springs: State, deformation: Any) -> State:
        """Return the springs' state after a monotonic move to other deformations."""

    @abstractmethod
    def force(self, springs: State) -> Any:
        """Return the springs' forces [N]."""

    @abstractmethod
    def acceleration(self, u: Any, v: Any, force: Any, signal: Any) -> Any:
        """Return the acceleration of the masses, relative to the base."""

    @abstractmethod
    def deformation(self, motion: Any) -> Any:
        """Return the deformation of every spring from the displacements."""

    @abstractmethod
    def usable(self, state: State, step: float) -> Any:
        """Return a mask of the accurate runs, from the state after the last step."""

    @abstractmethod
    def observe(self, state: State, signal: Any) -> Any:
        """Return the channels at a sample, (channel, run)."""

    def time_loop(self, stages: Any, dt: float, lead_in: int) -> TimeLoop:
        """Return the loop over the samples; each row holds the signal at start, middle and end of every step."""
        substeps = stages.shape[1]
        step = dt / substeps
        one = self._imposed if self.kind == "displacement" else self._free

        def sample(state: State, row: Any) -> tuple[State, Any]:
            # The state is observed before the steps, so the first sample needs no extra row.
            observed = self.observe(state, self._signal(row[0], step))
            if substeps == 1:
                return one(state, row[0], step), observed
            state, _ = lax.scan(lambda s, stage: (one(s, stage, step), None), state, row)
            return state, observed

        springs, u, v = self.at_rest()
        if self.kind == "displacement":
            u = u + stages[0, 0, 0]
            springs = self.moved(springs, self.deformation(u))
        start = {"springs": springs, "u": u, "v": v, "work": 0.0 * self.force(springs), "longest": 0.0 * u}
        return TimeLoop(start, sample, stages, lead_in, lambda state: self.usable(state, step))

    def _signal(self, stage: Any, step: float) -> Any:
        """Return the signal at the start of a step: an imposed motion's velocity, or the excitation itself."""
        if self.kind == "displacement":
            return (-3.0 * stage[0] + 4.0 * stage[1] - stage[2]) / step
        return stage[0]

    def _imposed(self, state: State, stage: Any, step: float) -> State:
        """Return the state after an imposed move."""
        u = 0.0 * state["u"] + stage[2]
        return self._after(state, self.deformation(state["u"]), self.deformation(u)) | {"u": u}

    def _free(self, state: State, stage: Any, step: float) -> State:
        """Return the state after a Runge–Kutta step."""
        springs, u, v = state["springs"], state["u"], state["v"]

        def slope(u: Any, v: Any, force: Any, signal: Any) -> tuple[Any, Any]:
            return v, self.acceleration(u, v, force, signal)

        def stage_at(by: float, slopes: tuple[Any, Any], signal: Any) -> tuple[Any, Any]:
            at_u, at_v = u + by * slopes[0], v + by * slopes[1]
            return slope(at_u, at_v, self.force(self.moved(springs, self.deformation(at_u))), signal)

        k1 = slope(u, v, self.force(springs), stage[0])
        k2 = stage_at(0.5 * step, k1, stage[1])
        k3 = stage_at(0.5 * step, k2, stage[1])
        k4 = stage_at(step, k3, stage[2])
        after_u, after_v = (
            y + step / 6.0 * (a + 2.0 * (b + c) + d) for y, a, b, c, d in zip((u, v), k1, k2, k3, k4, strict=True)
        )
        before, after = self.deformation(u), self.deformation(after_u)
        turned = self._turning_point(before, self.deformation(v), after, self.deformation(after_v), step)
        return self._after(self._after(state, before, turned), turned, after) | {"u": after_u, "v": after_v}

    @staticmethod
    def _turning_point(u: Any, v: Any, after_u: Any, after_v: Any, step: float) -> Any:
        """Return the deformation at which a spring turns within a step, or that at the end.

        With a linear velocity, u + v² h/(2 (v − v₁)); its error is of third order in the step.
        """
        xp = namespace(u)
        turns = v * after_v < 0.0
        return xp.where(turns, u + 0.5 * step * v * v / xp.where(turns, v - after_v, 1.0), after_u)

    def _after(self, state: State, before: Any, after: Any) -> State:
        """Return the state after a monotonic move of the springs, with the work of their forces and the longest move."""
        xp = namespace(after)
        springs, change = self.moved(state["springs"], after), after - before
        work = state["work"] + 0.5 * (self.force(state["springs"]) + self.force(springs)) * change
        return state | {"springs": springs, "work": work, "longest": xp.maximum(state["longest"], xp.abs(change))}


def short_enough(longest: Any, limit: Any, omega_squared: Any, step: float) -> Any:
    """Return a mask of the runs whose moves and steps are short enough; false for runs that are not finite."""
    xp = namespace(longest)
    return (longest <= limit) & (step * xp.sqrt(omega_squared) <= LONGEST_STEP)
