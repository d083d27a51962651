"""A sampler of somebody else's: random-walk Metropolis chains, with their own purpose of random numbers."""

from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np

from structid.core import streams
from structid.inference.sampling.base import Drawn, Sampler, block_lengths, joined, without_cut_off
from structid.inference.sampling.sampler_list import SamplerKind


@dataclass(frozen=True)
class RandomWalk(Sampler):
    """φ′ = φ + scale · N(0, 1), accepted with probability min(1, p(φ′)/p(φ))."""

    walkers: int = 20
    steps: int = 2000
    ensembles: int = 2
    scale: float = 0.1
    discard: float = 0.25

    needed_length: ClassVar[float] = 50.0
    interacting: ClassVar[bool] = False

    def describe(self):
        return {k: v for k, v in asdict(self).items() if k not in ("steps", "discard")}

    @property
    def in_words(self):
        return f"random walk, {self.ensembles} x {self.walkers} chains of {self.steps} steps"

    def run(self, target, seed, start, blocks, keep, progress=None):
        lengths = list(block_lengths(self.steps))
        blocks = without_cut_off(blocks, lengths)
        if blocks:
            phi, log_density = blocks[-1]["phi"][-1], blocks[-1]["log_density"][-1]
        else:
            rng = streams.stream(seed, streams.Purpose.RANDOM_WALK, len(lengths))
            phi = target.initial(self.ensembles * self.walkers, rng).reshape(self.ensembles, self.walkers, -1)
            log_density = self._density(target, phi)[0]
        for index in range(len(blocks), len(lengths)):
            rng, block = streams.stream(seed, streams.Purpose.RANDOM_WALK, index), []
            for _ in range(lengths[index]):
                proposed = phi + self.scale * rng.standard_normal(phi.shape)
                there, failed = self._density(target, proposed)
                accepted = np.log(rng.random(there.shape)) < there - log_density
                phi = np.where(accepted[..., None], proposed, phi)
                log_density = np.where(accepted, there, log_density)
                block.append({"phi": phi, "log_density": log_density, "accepted": accepted, "failed": failed})
            keep(index, {name: np.array([step[name] for step in block]) for name in block[0]})
            blocks = [*blocks, {name: np.array([step[name] for step in block]) for name in block[0]}]
        every = joined(blocks, self.steps)
        return Drawn(every["phi"], every["log_density"], every["accepted"], int(every["failed"].sum()))

    def _density(self, target, phi):
        log_density, failed = target.evaluate(phi.reshape(-1, phi.shape[-1]))
        return log_density.reshape(phi.shape[:-1]), failed.sum()


KIND = SamplerKind(RandomWalk, "random_walk")
