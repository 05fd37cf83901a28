"""Precision of matrix products, by setting and hardware."""

from __future__ import annotations

import pytest
import torch

from iher_robot.learning.config import Precision
from iher_robot.learning.networks import precision
from iher_robot.learning.networks.precision import pick_matmul_dtype, set_float32_precision
from tests.learning.fakes import CPU
from tests.learning.small_learner import new, quick, real


@pytest.mark.parametrize(
    ("setting", "capable", "expected"),
    [
        ("bfloat16", False, torch.bfloat16),
        ("bfloat16", True, torch.bfloat16),
        ("auto", True, torch.bfloat16),
        ("auto", False, torch.float32),
        ("medium", True, torch.float32),
        ("highest", True, torch.float32),
    ],
)
def test_bfloat16_is_used_if_set_or_if_auto_finds_it(
    setting: Precision, capable: bool, expected: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": capable})
    assert pick_matmul_dtype(setting, CPU) == expected


def test_an_unknown_cpu_has_no_bfloat16(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)
    assert not precision.has_bfloat16(CPU)


def test_float32_precision_is_set_for_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    before = torch.get_float32_matmul_precision()
    expected = {"bfloat16": "highest", "high": "high", "medium": "medium", "highest": "highest"}
    try:
        for capable, auto in ((True, "highest"), (False, "medium")):
            has = {"avx512_bf16": capable}
            monkeypatch.setattr(torch.cpu, "get_capabilities", lambda has=has: has)
            for setting, found in (expected | {"auto": auto}).items():
                set_float32_precision(setting, CPU)  # type: ignore[arg-type]
                assert torch.get_float32_matmul_precision() == found
    finally:
        torch.set_float32_matmul_precision(before)


def test_all_networks_compute_in_the_set_precision_and_are_saved_in_float32() -> None:
    learned = {}
    for setting in ("highest", "bfloat16"):
        config = quick(ddpg={"hidden": (16, 16, 16)})
        learner = new(config.model_copy(update={"matmul_precision": setting}))
        learner.add_real(real(1))
        learner.learn()
        state = learner.state_dict()
        weights = [*state["ddpg"]["critics"].values(), *state["ensemble"]["members"].values()]
        assert {each.dtype for each in weights} == {torch.float32}
        assert {each.dtype for each in state["policy"]["actor"].values()} == {torch.float32}
        learned[setting] = weights
        # The policy that acts on a robot is not rounded.
        assert learner.acting_policy(CPU).matmul_dtype == torch.float32
    for exact, rounded in zip(learned["highest"], learned["bfloat16"], strict=True):
        if exact.dim() == 2:
            assert not torch.equal(exact, rounded)
        torch.testing.assert_close(exact, rounded, rtol=0.1, atol=0.1)
