"""Adam against torch's optimiser and against numbers worked by hand."""

import pytest
import torch

from flipperctl.agent.descent import Adam


def test_the_first_step_goes_by_the_rate_against_the_gradients_sign() -> None:
    parameters = torch.tensor([1.0, 2.0, 3.0])
    Adam(parameters).step(torch.tensor([0.5, -4.0, 0.0]), 0.1)
    assert parameters.tolist() == pytest.approx([0.9, 2.1, 3.0])


def test_many_steps_equal_torchs_optimiser() -> None:
    generator = torch.Generator().manual_seed(0)
    gradients = torch.randn(50, 20, generator=generator)
    ours, theirs = torch.ones(20), torch.ones(20, requires_grad=True)
    adam, reference = Adam(ours), torch.optim.Adam([theirs], lr=3e-3)
    for gradient in gradients:
        adam.step(gradient, 3e-3)
        theirs.grad = gradient
        reference.step()
    torch.testing.assert_close(ours, theirs.detach(), rtol=1e-5, atol=1e-6)
