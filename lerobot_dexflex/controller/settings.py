"""How candidates are proposed and chosen at run time; also the switches of the ablations."""

from dataclasses import dataclass

from lerobot_dexflex.errors import DexFlexError

SEEDS = ("draft", "mean")
"""Named starts of the draft-seeded branch; a number is the draft scaled by it."""


@dataclass(frozen=True)
class SelectionSettings:
    """Draft, dream, select: how many candidates, from where, and who chooses.

    Raises:
        DexFlexError: If a value is out of its range.
    """

    n_pure: int = 7
    """Candidates drawn from the prior alone."""
    n_seeded: int = 7
    """Candidates drawn from the prior starting at a noisy draft."""
    include_draft: bool = True
    """Whether the exact draft is a candidate, so that doing nothing can be chosen."""
    project: bool = True
    """Whether the contact projection of the draft is a candidate, and what draft-seeded ones start from."""
    contact_bias: float = 12.0
    """Added to the score of the contact projection: how much better another candidate must look."""
    levels: tuple[float, ...] = (0.5, 0.75)
    """Flow times at which draft-seeded candidates start: 0 is pure noise, 1 the draft itself."""
    seeds: tuple[str, ...] = ("draft", "mean", "0.75", "0.5")
    """What they start from: the draft, the mean of the recent drafts, or the draft scaled by a number."""
    nfe: int = 4
    """Integration steps from noise; draft-seeded candidates take proportionally fewer."""
    prefix: int = 1
    """Control steps executed of a chosen chunk before choosing again."""
    temperature: float = 0.0
    """0 takes the best candidate; above, the mean of all weighted by softmax(score / temperature)."""
    use_score: bool = True
    """Whether the learned score chooses; otherwise the proposal nearest to the draft."""
    use_dream: bool = True
    """Whether score and decoder see the predicted latent."""
    use_touch: bool = True
    """Whether the encoder sees touch."""
    use_slow: bool = True
    """Whether the networks see the slow token."""
    use_residual: bool = False
    """Whether the decoder corrects the joint targets. Off: it costs progress, .05 over the corruption
    families, .07 on clean commands (30 tuning objects, log in `eval/README.md`)."""
    output_gain: float = 1.0
    """Scale of the executed displacement."""
    seed: int = 0
    """Seed of the noise of candidates: the same for every row and step unless noise is given."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", tuple(self.levels))
        object.__setattr__(self, "seeds", tuple(self.seeds))
        if min(self.n_pure, self.n_seeded) < 0 or self.n_candidates < 1:
            raise DexFlexError(
                f"There must be at least one candidate. Got n_pure {self.n_pure}, n_seeded {self.n_seeded}, "
                f"include_draft {self.include_draft}, project {self.project}."
            )
        if self.n_seeded and not (self.levels and self.seeds):
            raise DexFlexError("`levels` and `seeds` must not be empty while `n_seeded` is positive.")
        if not all(0 < level < 1 for level in self.levels):
            raise DexFlexError(f"`levels` must lie strictly between 0 and 1. Got {self.levels}.")
        for seed in self.seeds:
            if seed not in SEEDS and not _is_number(seed):
                raise DexFlexError(
                    f"`seeds` must be {', '.join(SEEDS)} or numbers such as '0.5'. Got {seed!r}."
                )
        if self.nfe < 1 or not 1 <= self.prefix <= 8:
            raise DexFlexError(f"`nfe` must be >= 1, `prefix` in [1, 8]. Got {self.nfe}, {self.prefix}.")
        if self.temperature < 0 or self.output_gain < 0:
            raise DexFlexError(
                f"`temperature` and `output_gain` must not be negative. Got {self.temperature}, "
                f"{self.output_gain}."
            )

    @property
    def n_candidates(self) -> int:
        """Candidates per decision."""
        return self.n_pure + self.n_seeded + self.include_draft + self.project


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
