"""How candidates are proposed and chosen at run time; also the switches of the ablations."""

from dataclasses import dataclass

from lerobot_dexflex.errors import DexFlexError


@dataclass(frozen=True)
class SelectionSettings:
    """Draft, dream, select: how many candidates, from where, and who chooses.

    Raises:
        DexFlexError: If a value is out of its range.
    """

    n_pure: int = 4
    """Candidates drawn from the prior alone; 32 of these and 15 seeded ones did no better (`eval/LOG.md`)."""
    n_seeded: int = 16
    """Candidates drawn from the prior starting at the noisy draft."""
    n_finger: int = 16
    """Candidates that start there too but for one finger, which is drawn anew."""
    include_draft: bool = False
    """Whether the draft as it came is a candidate. By default it is not: what it has of errors that would
    lead fingers apart is what the prior takes out (`eval/LOG.md`)."""
    levels: tuple[float, ...] = (0.5,)
    """Flow times at which draft-seeded candidates start: 0 is pure noise, 1 the draft itself."""
    finger_levels: tuple[float, ...] = (0.0,)
    """The same for the one finger that is drawn anew."""
    others_level: float = 0.5
    """The same for the other fingers of these candidates; at 1 they do what the draft says."""
    nfe: int = 1
    """Network evaluations per decision, whatever the starting level; a second one changed nothing."""
    prefix: int = 1
    """Control steps executed of a chosen chunk before choosing again."""
    hysteresis: float = 2.0
    """How much better, in units of the score, a candidate with fingers drawn anew must look than those that
    follow the draft with the whole hand."""
    use_score: bool = True
    """Whether the learned score chooses; otherwise the proposal nearest to the draft."""
    use_dream: bool = True
    """Whether the score sees the predicted latent."""
    use_touch: bool = True
    """Whether the encoder sees touch."""
    use_slow: bool = True
    """Whether the networks see the slow token."""
    use_splitter: bool = False
    """Whether what of a draft commands into the object is taken out of it, for sources that press; otherwise
    all of it is motion."""
    grip: float = 0.0
    """0: the decoder supplies the grip; above: every touching finger presses so hard [N], as `press` does."""
    seed: int = 0
    """Seed of the noise of candidates: the same for every row and step unless noise is given."""

    def __post_init__(self) -> None:
        for name in ("levels", "finger_levels"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if min(self.n_pure, self.n_seeded, self.n_finger) < 0 or self.n_candidates < 1:
            raise DexFlexError(
                f"There must be at least one candidate. Got n_pure {self.n_pure}, n_seeded {self.n_seeded}, "
                f"n_finger {self.n_finger}, include_draft {self.include_draft}."
            )
        for name, needed in (("levels", self.n_seeded), ("finger_levels", self.n_finger)):
            levels = getattr(self, name)
            if (needed and not levels) or not all(0 <= level < 1 for level in levels):
                raise DexFlexError(f"`{name}` must hold flow times in [0, 1). Got {levels}.")
        if not 0 <= self.others_level <= 1:
            raise DexFlexError(f"`others_level` must be a flow time in [0, 1]. Got {self.others_level}.")
        if self.nfe < 1 or not 1 <= self.prefix <= 8:
            raise DexFlexError(f"`nfe` must be >= 1, `prefix` in [1, 8]. Got {self.nfe}, {self.prefix}.")
        if not (self.hysteresis >= 0 and self.grip >= 0):
            raise DexFlexError(
                f"`hysteresis` and `grip` must be 0 or more. Got {self.hysteresis}, {self.grip}."
            )

    @property
    def n_candidates(self) -> int:
        """Candidates per decision."""
        return self.n_pure + self.n_seeded + self.n_finger + self.include_draft
