"""Targets and losses of the learners, and the steps of an optimiser on them.

Adam is Algorithm 1 of Kingma & Ba 2015. torch's own optimiser computes the same, but constructing
one imports torch's compiler (``torch._dynamo``, as of torch 2.13), which costs a second and 80 MB.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import torch


def double_q_target(
    reward: torch.Tensor,
    discount: torch.Tensor,
    next_online: torch.Tensor,
    next_target: torch.Tensor,
) -> torch.Tensor:
    """Return r + γ · Q_target(s′, argmax_a Q_online(s′, a)), (B,) (van Hasselt et al. 2016).

    ``reward`` and ``discount`` are (B,), the discount 0 without bootstrapping;
    ``next_online`` and ``next_target`` are (B, A) at the next observation.
    """
    # The online network chooses the action, the target network values it.
    best = next_online.argmax(dim=1, keepdim=True)  # (B, 1)
    return reward + discount * next_target.gather(1, best).squeeze(1)


def huber(
    prediction: torch.Tensor, target: torch.Tensor, weight: torch.Tensor | None = None
) -> torch.Tensor:
    """Return the mean Huber loss with threshold 1 of two (B,) tensors, weighted by a third."""
    if weight is None:
        return torch.nn.functional.smooth_l1_loss(prediction, target)
    each = torch.nn.functional.smooth_l1_loss(prediction, target, reduction="none")
    return (weight * each).mean()


def teacher_cross_entropy(
    values: torch.Tensor, labels: torch.Tensor, temperature: float
) -> torch.Tensor:
    """Return the mean cross-entropy between ``labels`` and softmax(values / temperature) [-].

    ``values`` (B, A) are Q-values, ``labels`` (B, A) distributions over the actions. The mean is
    over the labelled rows; a row of zeros has no label.
    """
    # The mean is over labelled rows alone: rows of zeros add nothing to the sum.
    logarithms = torch.log_softmax(values / temperature, dim=1)
    labelled = (labels.sum(dim=1) > 0).sum().clamp(min=1)
    return -(labels * logarithms).sum() / labelled


def teacher_large_margin(values: torch.Tensor, labels: torch.Tensor, margin: float) -> torch.Tensor:
    """Return the mean of max_a (Q(s, a) + ``margin`` · [a ≠ a_E]) - Q(s, a_E) (DQfD) [-].

    ``values`` (B, A) are Q-values, ``labels`` (B, A) distributions over the actions, whose most
    probable action is the teacher's, a_E. The loss is 0 where Q(s, a_E) exceeds all others by the
    margin. The mean is over the labelled rows; a row of zeros has no label. Hester et al. 2018,
    "Deep Q-learning from demonstrations", loss J_E.
    """
    # Raise every action but the teacher's by the margin; what still exceeds it is the loss.
    taught = labels.argmax(dim=1, keepdim=True)  # (B, 1)
    raised = (values + margin).scatter(1, taught, values.gather(1, taught))
    excess = raised.amax(dim=1) - values.gather(1, taught).squeeze(1)  # (B,)
    labelled = (labels.sum(dim=1) > 0).to(values.dtype)
    return (labelled * excess).sum() / labelled.sum().clamp(min=1)


def searched_values(values: torch.Tensor, targets: torch.Tensor, clip: float) -> torch.Tensor:
    """Return the loss of Q-values against the searched values of groups of close states [-].

    Both are (B, K, A), for B groups of K states. What follows beyond the perceived ground moves all
    values of a group alike, by far more than the choice among its states and actions does. The loss
    therefore compares three things: the actions of a state, the best values of a group's states,
    and, with a small weight, the means of the groups. Each is divided by its mean size in the
    batch, so that no reward's scale matters. Actions worse than the best by more than ``clip``
    times the mean difference count as worse by that.
    """
    # Differences between the actions of a state: gaps to the action that is best by the search.
    best = targets.argmax(dim=2, keepdim=True)  # (B, K, 1)
    value, target = values.gather(2, best), targets.gather(2, best)
    gap, target_gap = value - values, target - targets  # at least 0 for the targets
    # The mean gap sets the scale; typical gaps limit how much a few huge ones add to it.
    size = target_gap.clamp(max=_typical(target_gap) * clip + 1e-6).mean() + 1e-6
    target_gap = target_gap.clamp(max=clip * size)
    error = gap - target_gap
    error = torch.where(target_gap >= clip * size, error.clamp(max=0), error)  # worse is fine too
    actions = torch.nn.functional.smooth_l1_loss(error / size, torch.zeros_like(error), beta=0.1)
    # Differences between the states of a group, by the values of their best actions.
    mean, target_mean = value.mean(dim=1, keepdim=True), target.mean(dim=1, keepdim=True)
    spread = (target - target_mean).abs().median() + 1e-6
    difference = ((value - mean) - (target - target_mean)) / spread
    states = torch.nn.functional.smooth_l1_loss(difference, torch.zeros_like(difference), beta=0.3)
    # The level of a group, which ground beyond the perceived one moves most, counts least.
    level = torch.nn.functional.smooth_l1_loss(mean / spread, target_mean / spread)
    return 3.0 * actions + states + 0.1 * level


def _typical(gaps: torch.Tensor) -> float:
    """Return the median of gaps, each at least 0.

    If most of them are negligible, it is the median of the others. A reward at the end alone makes
    most actions equal, and their gaps say nothing about its scale.
    """
    median, least = float(gaps.median()), 0.01 * float(gaps.mean())
    if median > least or not least:
        return median
    return float(gaps[gaps > least].median())


def mean_value_penalty(values: torch.Tensor) -> torch.Tensor:
    """Return the mean square of each state's mean Q-value; ``values`` are (B, A) [-].

    Labels do not determine that mean. Unconstrained, rounding errors moved it by whole steps of
    Adam to 5·10⁴, which left float32 little precision for action differences of 0.1.
    """
    return values.mean(dim=1).square().mean()


def double_quantile_target(
    reward: torch.Tensor,
    discount: torch.Tensor,
    next_online: torch.Tensor,
    next_target: torch.Tensor,
) -> torch.Tensor:
    """Return the distribution r + γ · Z_target(s′, argmax_a Q_online(s′, a)) as quantiles, (B, K).

    The arguments are as in ``double_q_target``, but ``next_target`` holds the quantiles of every
    action, (B, A, K).
    """
    # Advanced indexing gathers one row of quantiles for each transition.
    rows = torch.arange(len(reward), device=reward.device)
    best = next_target[rows, next_online.argmax(dim=1)]  # (B, K)
    return reward.unsqueeze(1) + discount.unsqueeze(1) * best


def quantile_huber(
    prediction: torch.Tensor, target: torch.Tensor, row_weight: torch.Tensor | None = None
) -> torch.Tensor:
    """Return the quantile Huber loss with threshold 1 (Dabney et al. 2018, Eqs. 9 and 10).

    ``prediction`` (B, K) holds the quantiles at τ_i = (i + ½) / K, ``target`` (B, K′) values that
    are equally likely. The loss is summed over the quantiles and averaged over the values and the
    batch, whose rows are weighted by ``row_weight`` (B,).
    """
    count = prediction.shape[1]
    # The midpoints τ_i of K equally likely quantiles, and all pairs of estimate and sample.
    tau = (torch.arange(count, device=prediction.device) + 0.5) / count
    error = target.unsqueeze(1) - prediction.unsqueeze(2)  # (B, K, K′)
    size = error.abs()
    # Huber's loss with threshold 1: s·(|e| - s/2) with s = min(|e|, 1).
    small = size.clamp(max=1.0)
    weight = (tau.view(1, -1, 1) - (error < 0).to(error.dtype)).abs()
    each = (weight * small * (size - 0.5 * small)).sum(dim=1)  # (B, K′)
    return each.mean() if row_weight is None else (row_weight.unsqueeze(1) * each).mean()


def divergence(p: torch.Tensor, log_q: torch.Tensor) -> torch.Tensor:
    """Return the mean Kullback-Leibler divergence KL(p | q) of a batch.

    ``p``: probabilities, (B, A); ``log_q``: logarithms of probabilities, (B, A).
    """
    divergence: torch.Tensor = (torch.special.xlogy(p, p) - p * log_q).sum(dim=1).mean()
    return divergence


def clipped_gain(
    log_policy: torch.Tensor,
    action: torch.Tensor,
    drawn_with: torch.Tensor,
    advantage: torch.Tensor,
    clip: float,
) -> torch.Tensor:
    """Return the clipped surrogate objective (Schulman et al. 2017, Eq. 7), averaged.

    ``log_policy``: logarithms of the policy's probabilities, (B, A); ``action``: the actions, (B,),
    which were drawn with the probabilities ``drawn_with``, (B, A); ``advantage``: (B,).
    """
    # Ratio of the new to the old probability of each action, from logarithms.
    column = action.unsqueeze(1)
    ratio = (log_policy.gather(1, column) - drawn_with.gather(1, column).log()).squeeze(1).exp()
    return torch.minimum(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage).mean()


@contextmanager
def _denormals_flushed() -> Iterator[None]:
    """Compute numbers below 1.2·10⁻³⁸ as 0 on this thread.

    Moments of weights without a gradient shrink to such numbers, with which a processor computes
    tens of times slower; no weight changes by it.
    """
    before = not (_DENORMAL * 1).item()  # torch does not say what it is set to
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(before)


_DENORMAL = torch.tensor(1e-39)
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
"""The paper's decay rates of the moments, and its term against a division by zero [-]."""


class Adam:
    """Holds the moments of the gradient and changes ``parameters`` in place."""

    def __init__(self, parameters: torch.Tensor) -> None:
        """Optimise ``parameters``, (P,)."""
        self.parameters = parameters
        self.moments = {name: torch.zeros_like(parameters) for name in ("first", "second")}
        self.steps = 0

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return the moments."""
        return self.moments

    def load_state_dict(self, moments: Mapping[str, torch.Tensor]) -> None:
        """Take the moments that ``state_dict`` returned; ``steps`` are set apart."""
        for name, moment in self.moments.items():
            moment.copy_(moments[name])

    def step(self, gradient: torch.Tensor, rate: float) -> None:
        """Take one step against ``gradient``, (P,), with the learning rate ``rate``."""
        self.steps += 1
        with _denormals_flushed():
            self._step(gradient, rate)

    def _step(self, gradient: torch.Tensor, rate: float) -> None:
        first, second = self.moments["first"], self.moments["second"]
        first.lerp_(gradient, 1 - BETA_1)
        second.mul_(BETA_2).addcmul_(gradient, gradient, value=1 - BETA_2)
        # Both bias corrections go into the step's size; ε is scaled with the second moment.
        scale = math.sqrt(1 - BETA_2**self.steps)
        size = rate * scale / (1 - BETA_1**self.steps)
        self.parameters.addcdiv_(first, second.sqrt().add_(EPSILON * scale), value=-size)


def flatten_parameters(parameters: Sequence[torch.nn.Parameter]) -> torch.Tensor:
    """Move parameters into one vector, (P,); they become views of it."""
    # Parameters become views of one vector, so that one operation changes all of them.
    vector = torch.cat([p.detach().reshape(-1) for p in parameters])
    parts = torch.split(vector, [p.numel() for p in parameters])
    for parameter, part in zip(parameters, parts, strict=True):
        parameter.data = part.view_as(parameter)
    return vector


def descend(
    loss: torch.Tensor,
    parameters: Sequence[torch.Tensor],
    optimiser: Adam,
    norm: float,
    rate: float,
) -> None:
    """Take one step of the optimiser against the gradient of the loss, clipped to ``norm``.

    Parameters without a part in the loss, such as parameters of noise that is off, have a gradient
    of 0.
    """
    gradients = torch.autograd.grad(loss, parameters, allow_unused=True, materialize_grads=True)
    with torch.no_grad():
        # Clipping acts on all parameters together, by the norm of the whole gradient.
        gradient = torch.cat([g.reshape(-1) for g in gradients])
        length = float(torch.linalg.vector_norm(gradient))
        if length > norm:
            gradient.mul_(norm / length)
        optimiser.step(gradient, rate)
