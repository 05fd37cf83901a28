"""Typed settings of the learner: defaults are the paper's values for Push."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

# Nothing here loads torch: settings are read by commands that compute nothing.
Precision = Literal["auto", "highest", "high", "medium", "bfloat16"]

MOVED_M = 0.01
"""Displacement of the achieved goal, m, above which an episode counts as one that moved it."""


def _none_if_off(value: object) -> object:
    return None if isinstance(value, str) and value.lower() == "off" else value


OR_OFF = BeforeValidator(_none_if_off)
"""Reads ``off`` as None, which the command line cannot express."""


class Section(BaseModel):
    """Base of every group of settings: frozen; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class ScheduleConfig(Section):
    """Amounts of data and training in an epoch (paper, appendix, "Hyperparameters")."""

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
    """Cycles from one copy of the policy, kept for refilling, to the next."""
    updates_per_step: Annotated[float | None, OR_OFF] = Field(None, gt=0.0, le=1000.0)
    """Gradient updates for each real step that an epoch collected; ``off`` makes C x N an epoch,
    as in the paper. A cycle still has N of them, the last one the remainder."""

    @property
    def real_episodes(self) -> int:
        """Real episodes an epoch, all workers together."""
        return self.workers * self.real_rollouts

    @property
    def imaginary_episodes(self) -> int:
        """Imaginary episodes a cycle, all workers together."""
        return self.workers * self.imaginary_rollouts


class DDPGConfig(Section):
    """The off-policy algorithm; defaults of the HER reference implementation."""

    hidden: tuple[int, ...] = (256, 256, 256)
    """Widths of the hidden layers of actor and critic."""
    critics: int = Field(1, ge=1, le=100)
    """Critics in the ensemble; the actor maximises their mean (Chen et al. 2021, REDQ)."""
    target_subset: int = Field(1, ge=1, le=100)
    """Target critics, drawn for each update, whose minimum is bootstrapped from."""
    inputs: Literal["absolute", "relative"] = "absolute"
    """Input of actor and critics: observation and goal as they are; or the goal relative to the
    achieved one, and only those entries that a shift of the whole scene does not change."""
    layer_norm: bool = False
    """Normalise each hidden layer of the critics (Ball et al. 2023, RLPD)."""
    policy_average: Annotated[float | None, OR_OFF] = Field(None, gt=0.0, lt=1.0)
    """Share of the actor that enters a running mean of its weights at each update; the mean acts
    in real episodes and is the trained policy. ``off`` acts with the newest weights."""
    component_critics: bool = False
    """Separate critics for extrinsic and intrinsic reward; the actor maximises their sum."""
    batch_size: int = Field(256, ge=1)
    """Transitions an update and worker."""
    gamma: float = Field(0.98, ge=0.0, lt=1.0)
    """Discount factor."""
    actor_period: int = Field(1, ge=1)
    """Critic updates from one actor update to the next (Fujimoto et al. 2018, TD3)."""
    tau: float = Field(0.05, gt=0.0, le=1.0)
    """Share of the online networks that enters the targets at each target update."""
    target_update: Literal["cycle", "update"] = "cycle"
    """When the targets are updated: at the end of a cycle, as in the paper, or at each update."""
    actor_lr: float = Field(1e-3, gt=0.0, le=1.0)
    """Adam's step size for the actor."""
    critic_lr: float = Field(1e-3, gt=0.0, le=1.0)
    """Adam's step size for the critic."""
    action_l2: float = Field(1.0, ge=0.0)
    """Weight of the mean squared action in the actor's loss."""
    clip_target: Literal["her", "intrinsic", "off"] = "her"
    """Range of the critic's targets: [-1/(1-gamma), 0], [-1/(1-gamma), eta/(1-gamma)], or
    unbounded."""
    source_input: bool = True
    """Give actor and critic the source of a transition as an input (``env_is_real``)."""

    @model_validator(mode="after")
    def _subset_is_no_more_than_all(self) -> Self:
        if self.target_subset > self.critics:
            raise ValueError(
                f"target_subset is {self.target_subset}, but there are {self.critics} critics; "
                "allowed: 1 to critics"
            )
        return self


class ReplayConfig(Section):
    """Hindsight relabelling and the policy's input normalisation."""

    capacity: int = Field(1_000_000, ge=1)
    """Transitions that each source keeps, first in, first out."""
    future_fraction: float = Field(0.8, ge=0.0, le=1.0)
    """Share of sampled transitions whose goal is one achieved later in their episode."""
    still_weight: float = Field(1.0, gt=0.0, le=1.0)
    """Sampling weight, against 1, of a transition whose episode's achieved goal never moved by
    more than ``moved_m``: there hindsight teaches little."""
    moved_m: float = Field(MOVED_M, gt=0.0)
    """Displacement of the achieved goal, m, above which an episode counts as having moved it."""
    actions: Literal["applied", "between"] = "applied"
    """Actions to learn from: the applied ones; or any between the applied and the requested one,
    which all have the same outcome where a request was clipped. A cached intrinsic reward is that
    of the applied one."""
    tolerance: float = Field(1.0, gt=0.0, le=1.0)
    """Share of the task's tolerance within which a goal counts as reached while learning, so that
    a policy does not learn to stop at the very edge. Success is judged by the full tolerance."""
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
    inputs: Literal["absolute", "relative"] = "absolute"
    """Input of the models: the observation as it is, or only those entries that a shift of the
    whole scene does not change."""

    @model_validator(mode="after")
    def _some_transition_has_weight(self) -> Self:
        if self.recency_weights == "printed" and self.recency_bias == 1.0:
            raise ValueError(
                "recency_bias 1.0 gives every transition the weight 0 in the printed form; "
                "allowed: more than 1.0, or recency_weights one-plus"
            )
        return self


class ImaginationConfig(Section):
    """Imaginary rollouts and their use."""

    enabled: bool = True
    """Learn a dynamics ensemble, and from its rollouts; off for the model-free baselines."""
    regenerate: bool = True
    """Clear and refill the imaginary source after each model update."""
    branch_ticks: Annotated[int | None, OR_OFF] = Field(None, ge=1)
    """Ticks of an imaginary rollout that begins at any real state, with its goal, relabelled or
    not; such branches are dropped when the models change (Janner et al. 2019, MBPO). ``off``
    imagines whole episodes from real starts, as in the paper."""
    share: Annotated[float | None, OR_OFF] = Field(None, ge=0.0, le=1.0)
    """Imagined share of each batch; ``off`` takes the paper's p(imag), the share of newly imagined
    transitions in all transitions collected so far."""
    keep: float = Field(1.0, gt=0.0, le=1.0)
    """Share of the imagined rollouts to keep: those on which the models agree best."""
    state_margin: float = Field(0.1, ge=0.0)
    """Imagined observations are clipped to the real data's range, widened by this share."""


class IntrinsicConfig(Section):
    """Curiosity: reward for disagreement of the ensemble."""

    enabled: bool = True
    """Add the intrinsic reward to real and imagined transitions."""
    scale: float = Field(0.5, ge=0.0)
    """nu: multiplies the disagreement."""
    clip: float = Field(0.8, gt=0.0)
    """eta: the largest intrinsic reward."""
    reduce: Literal["mean", "sum"] = "mean"
    """Reduction of the variances over the observation's dimensions."""


class ExplorationConfig(Section):
    """Noise on actions while collecting, real and imagined alike."""

    noise_std: float = Field(0.2, ge=0.0)
    """Standard deviation of the Gaussian noise on each action."""
    random_fraction: float = Field(0.3, ge=0.0, le=1.0)
    """Share of actions replaced by uniformly random ones."""
    source_flip: float = Field(0.1, ge=0.0, le=1.0)
    """Share of rollouts collected with the other source's input."""


class SymmetryConfig(Section):
    """Data augmentation with the task's symmetries."""

    enabled: bool = False
    """Replace each sampled transition, for the policy and for the models, and each start of an
    imaginary rollout by a random image of it."""
    rough: bool = False
    """Include maps that the task declares to hold only approximately, if it declares any for
    the robot."""


class ContactConfig(Section):
    """Contact-first exploration: a second policy brings the effector to the object."""

    enabled: bool = False
    """Train the second policy, by hindsight on the same real data, and let it explore."""
    share: float = Field(0.5, ge=0.0, le=1.0)
    """Share of the steps that the second policy takes in episodes in which it explores."""
    episodes: float = Field(1.0, ge=0.0, le=1.0)
    """Share of the episodes in which it explores once it rests; before, it explores in all."""
    again_m: Annotated[float | None, OR_OFF] = Field(None, gt=0.0)
    """Approach the object again whenever it was reached or pushed by this much, m, until the
    episode ends; ``off`` leaves all steps after the first touch to the policy."""
    hand_over: float = Field(0.0, ge=0.0, le=1.0)
    """With ``again_m``: probability at each touch that the policy takes the rest of the episode."""
    hand_ticks: int = Field(5, ge=0)
    """Ticks to wait for the hand to move, at the object and at the points around it."""
    radius_m: float = Field(0.03, gt=0.0)
    """Distance, m, within which the second policy's goal is reached and the object touched."""
    touched_m: float = Field(0.01, gt=0.0)
    """The object also counts as touched once it moved by this much, m; large, where only the hand
    around it counts."""
    around_share: float = Field(0.0, ge=0.0, le=1.0)
    """Share of the approaches that first go to a point around the object, so that it is touched
    from every side."""
    around_m: float = Field(0.12, gt=0.0)
    """Largest distance of that point from the object along each axis, m; it is drawn for each
    approach, and never below the object."""
    hidden: tuple[int, ...] = (128, 128)
    """Widths of the hidden layers of its actor and of its only critic."""
    updates_per_step: float = Field(1.0, gt=0.0, le=1000.0)
    """Its gradient updates for each real step."""
    until_touched: float = Field(0.9, gt=0.0, le=1.0)
    """It rests, which ends its training, once the object was touched in this share of the last 20
    episodes."""


class LearnerConfig(Section):
    """All settings of the learner."""

    schedule: ScheduleConfig = ScheduleConfig()
    ddpg: DDPGConfig = DDPGConfig()
    replay: ReplayConfig = ReplayConfig()
    dynamics: DynamicsConfig = DynamicsConfig()
    imagination: ImaginationConfig = ImaginationConfig()
    intrinsic: IntrinsicConfig = IntrinsicConfig()
    exploration: ExplorationConfig = ExplorationConfig()
    symmetry: SymmetryConfig = SymmetryConfig()
    contact: ContactConfig = ContactConfig()
    matmul_precision: Precision = "auto"
    """Precision of matrix products: of float32 ones as in ``torch.set_float32_matmul_precision``,
    where ``medium`` depends on the hardware; or ``bfloat16`` between hidden layers, while weights,
    their gradients' sums and moments, and the first and the last layer stay float32; ``auto`` is
    bfloat16 where the hardware has instructions for it, else ``medium``."""
    cuda_graphs: bool = False
    """On a GPU, capture a block of updates once and replay it, instead of launching each kernel.
    No effect where ``ddpg.target_subset`` is less than ``critics``. Not yet tested on a GPU."""
