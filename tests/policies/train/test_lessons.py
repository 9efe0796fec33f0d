"""Inputs that taught nothing leave the network, and what it does on the lessons stays."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from policies.train.imitation.lessons import drop_idle_inputs


def student(inputs: int) -> Any:
    torch.manual_seed(0)
    nets = [torch.nn.Sequential(torch.nn.Linear(inputs, 16), torch.nn.ReLU()) for _ in range(2)]
    extractor = SimpleNamespace(policy_net=nets[0], value_net=nets[1])
    return SimpleNamespace(policy=SimpleNamespace(mlp_extractor=extractor))


def test_constants_and_twins_go_and_the_answers_stay() -> None:
    rng = np.random.default_rng(0)
    features = torch.as_tensor(rng.normal(size=(300, 6)), dtype=torch.float32)
    features[:, 2] = 0.7  # never varied
    features[:, 4] = features[:, 1]  # a twin
    features[:, 5] = 0.0
    model = student(6)
    network = model.policy.mlp_extractor.policy_net
    before = network(features).detach()
    drop_idle_inputs(model, [(features[:100], features[:100]), (features[100:], features[100:])])
    assert torch.allclose(network(features), before, atol=1e-5)
    other = features.clone()
    other[:, [2, 5]] = 3.0
    assert torch.equal(network(other), network(features))
    used = network[0].weight.detach().any(dim=0).tolist()
    assert used[0] and used[3] and not used[2] and not used[5]
    assert used[1] != used[4]  # one of the twins has it all
