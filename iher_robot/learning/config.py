"""Typed settings of the learner: defaults are the paper's values for Push."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator


class Section(BaseModel):
    """Base of every group of settings: frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class ScheduleConfig(Section):
    """How much of what happens in an epoch (paper, appendix, "Hyperparameters")."""

    workers: int = Field(8, ge=1, le=1024)
    """Averaged workers of the paper; batches and rollouts below are multiplied by it."""
    real_rollouts: int = Field(32, ge=1)
    """R: real episodes an epoch and worker."""
    imaginary_rollouts: int = Field(2, ge=1)
    """I: imaginary episodes a cycle and worker."""
    cycles: int = Field(250, ge=1)
    """C: cycles an epoch, each ending with one target network update."""
    batches: int = Field(40, ge=1)
    """N: gradient updates a cycle."""
    dynamics_steps: int = Field(1250, ge=1)
    """K: gradient steps an epoch of each member of the dynamics ensemble."""
    first_epoch_dynamics_factor: int = Field(5, ge=1)
    """Multiplies K in the first epoch."""
    policy_copy_cycles: int = Field(50, ge=1)
    """A copy of the policy is kept for refilling after every so many cycles."""

    @property
    def real_episodes(self) -> int:
        """Real episodes an epoch, all workers together."""
        return self.workers * self.real_rollouts

    @property
    def imaginary_episodes(self) -> int:
        """Imaginary episodes a cycle, all workers together."""
        return self.workers * self.imaginary_rollouts


class DDPGConfig(Section):
    """The off-policy learner; defaults of the HER reference implementation."""

    hidden: tuple[int, ...] = (256, 256, 256)
    """Widths of the hidden layers of actor and critic."""
    batch_size: int = Field(256, ge=1)
    """Transitions an update and worker."""
    gamma: float = Field(0.98, ge=0.0, lt=1.0)
    """Discount factor."""
    tau: float = Field(0.05, gt=0.0, le=1.0)
    """Share of the online networks that enters the targets at each target update."""
    actor_lr: float = Field(1e-3, gt=0.0, le=1.0)
    """Adam's step size for the actor."""
    critic_lr: float = Field(1e-3, gt=0.0, le=1.0)
    """Adam's step size for the critic."""
    action_l2: float = Field(1.0, ge=0.0)
    """Weight of the mean squared action in the actor's loss."""
    clip_target: Literal["her", "intrinsic", "off"] = "her"
    """Range of the critic's targets: [-1/(1-gamma), 0], the same with eta/(1-gamma) on top, or
    none."""
    source_input: bool = True
    """Tell actor and critic which source a transition is from (``env_is_real``)."""


class ReplayConfig(Section):
    """Hindsight relabelling and the policy's input normalisation."""

    capacity: int = Field(1_000_000, ge=1)
    """Transitions that each source keeps, first in, first out."""
    future_fraction: float = Field(0.8, ge=0.0, le=1.0)
    """Share of sampled transitions whose goal is one achieved later in their episode."""
    normalizer_clip: float = Field(5.0, gt=0.0)
    """Normalised inputs of the policy are clipped to this many standard deviations."""
    normalizer_std_floor: float = Field(0.01, gt=0.0)
    """Smallest standard deviation of the policy's normalisers."""


class DynamicsConfig(Section):
    """The ensemble of one-step models."""

    members: int = Field(5, ge=1, le=100)
    """Networks in the ensemble."""
    hidden: tuple[int, ...] = (512, 512)
    """Widths of each network's hidden layers."""
    lr: float = Field(1e-3, gt=0.0, le=1.0)
    """Adam's step size."""
    batch_size: int = Field(512, ge=1)
    """Transitions a gradient step, member and worker."""
    recency_bias: float = Field(2.0, ge=1.0)
    """b: how much likelier the newest transitions are drawn than the first."""
    recency_weights: Literal["one-plus", "printed"] = "one-plus"
    """1 + (b - 1) E(i)/E, or the paper's printed E(i)/E (b - 1)."""
    std_floor: float = Field(1e-3, gt=0.0)
    """Smallest standard deviation of the model's normalisers, in the observation's units."""

    @model_validator(mode="after")
    def _some_transition_has_weight(self) -> Self:
        if self.recency_weights == "printed" and self.recency_bias == 1.0:
            raise ValueError(
                "recency_bias 1.0 gives every transition the weight 0 in the printed form; "
                "allowed: more than 1.0, or recency_weights one-plus"
            )
        return self


class ImaginationConfig(Section):
    """Imaginary rollouts and how the learner uses them."""

    enabled: bool = True
    """Learn a dynamics ensemble and from what it imagines; off for the model-free baselines."""
    regenerate: bool = True
    """Clear and refill the imaginary source after each model update."""
    state_margin: float = Field(0.1, ge=0.0)
    """Imagined observations are bounded to the real data's range, widened by this share."""


class IntrinsicConfig(Section):
    """Curiosity: reward for disagreement of the ensemble."""

    enabled: bool = True
    """Add the intrinsic reward to real and imagined transitions."""
    scale: float = Field(0.5, ge=0.0)
    """nu: multiplies the disagreement."""
    clip: float = Field(0.8, gt=0.0)
    """eta: the largest intrinsic reward."""
    reduce: Literal["mean", "sum"] = "mean"
    """How the variances of the observation's dimensions become one number."""


class ExplorationConfig(Section):
    """Noise on actions while collecting, real and imagined alike."""

    noise_std: float = Field(0.2, ge=0.0)
    """Standard deviation of the Gaussian noise on each action."""
    random_fraction: float = Field(0.3, ge=0.0, le=1.0)
    """Share of actions replaced by uniformly random ones."""
    source_flip: float = Field(0.1, ge=0.0, le=1.0)
    """Share of rollouts collected with the other source's input."""


class LearnerConfig(Section):
    """All settings of the learner."""

    schedule: ScheduleConfig = ScheduleConfig()
    ddpg: DDPGConfig = DDPGConfig()
    replay: ReplayConfig = ReplayConfig()
    dynamics: DynamicsConfig = DynamicsConfig()
    imagination: ImaginationConfig = ImaginationConfig()
    intrinsic: IntrinsicConfig = IntrinsicConfig()
    exploration: ExplorationConfig = ExplorationConfig()
    matmul_precision: Literal["highest", "high", "medium"] = "medium"
    """Precision of float32 matrix products, as in ``torch.set_float32_matmul_precision``."""
