"""Critics: networks, subsets of them, bounds by layer normalisation."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
import torch
from torch import nn

from iher_robot.learning.config import DDPGConfig
from iher_robot.learning.networks.critics import Critics
from tests.learning.fakes import generator

FEATURES, ACTION = 5, 2


def critics(components: int = 2, seed: int = 0, **settings: Any) -> Critics:
    config = DDPGConfig.model_validate({"hidden": (32, 32), "critics": 3} | settings)
    rng = generator(seed)
    return Critics(FEATURES + ACTION, config, components=components, generator=rng)


def inputs(batch: int = 40, scale: float = 1.0) -> tuple[torch.Tensor, torch.Tensor]:
    rng = generator(9)
    features = torch.randn(batch, FEATURES, generator=rng)
    return scale * features, 2 * torch.rand(batch, ACTION, generator=rng) - 1


def test_networks_have_different_initial_weights() -> None:
    value = critics()(*inputs())
    assert value.shape == (2, 3, 40)
    for one, other in itertools.combinations(value.flatten(0, 1), 2):
        assert (one - other).abs().mean() > 0.01


@pytest.mark.parametrize("members", [[0], [1], [2], [0, 2], [0, 1, 2]])
def test_only_the_given_members_are_evaluated_in_every_component(members: list[int]) -> None:
    networks = critics()
    everything = networks(*inputs())
    torch.testing.assert_close(networks(*inputs(), members), everything[:, members])


def test_a_value_depends_on_features_and_action() -> None:
    networks, (features, action) = critics(), inputs()
    before = networks(features, action)
    for changed in (networks(features + 1, action), networks(features, -action)):
        assert ((changed - before).abs().mean(-1) > 1e-3).all()


def test_layer_normalisation_bounds_values_far_from_the_data() -> None:
    # After the last normalisation the ReLU's output has a norm of at most the root of its width,
    # so that no input takes a value farther from its bias than the last layer's weights allow.
    for layer_norm in (False, True):
        networks = critics(layer_norm=layer_norm)
        near, far = (networks(*inputs(scale=scale)).abs().amax(-1) for scale in (1.0, 1e4))
        heads = [x for x in networks.modules() if isinstance(x, nn.Linear) and x.out_features == 1]
        reach = [head.weight.norm() * 32**0.5 + head.bias.abs().sum() for head in heads]
        bounds = torch.stack(reach).view(2, 3)
        if layer_norm:
            assert (far <= bounds).all()
        else:
            assert (far > 100 * near).all()
            assert (far > bounds).all()
