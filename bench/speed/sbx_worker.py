"""Worker process that measures sbx: one request per line, one answer per line."""

from __future__ import annotations

import json
import os
import sys
from contextlib import redirect_stdout
from types import ModuleType

# Precisions of JAX's products; networks, gradients and optimiser stay in float32.
PRECISIONS = {"fp32": "highest", "medium": "default", "bf16": "bfloat16"}


def main() -> None:
    options, answers = json.loads(sys.argv[1]), sys.stdout
    with redirect_stdout(sys.stderr):  # output of libraries is not an answer
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, cores[: options["threads"]])  # before JAX starts its threads

        import jax
        import torch
        from sbx import DDPG
        from sbx.td3.policies import TD3Policy

        from bench.speed.settings import Settings
        from bench.speed.stable_baselines import Agent

        torch.set_num_threads(options["threads"])  # the replay uses torch
        settings = Settings(1, options["threads"], torch.device("cpu"), (), options["quick"])
        # DDPG has no policy for dict observations; that of TD3, its base, accepts them.
        agent = Agent(DDPG, TD3Policy, settings, options["hidden"], "cpu")
        about = {"platform": platform(jax), "bf16": computes_in_bf16(jax)}
        print(json.dumps(about), file=answers, flush=True)
        for line in sys.stdin:
            request = json.loads(line)
            jax.config.update("jax_default_matmul_precision", PRECISIONS[request["precision"]])
            rate = agent.rate(request["batch"], request["count"])
            print(json.dumps({"rate": rate}), file=answers, flush=True)


def platform(jax: ModuleType) -> str:
    name: str = jax.devices()[0].platform
    return {"gpu": "cuda"}.get(name, name)


def computes_in_bf16(jax: ModuleType) -> bool:
    """Whether XLA computes products in bfloat16 where it may: whether they differ."""
    matrix = jax.random.normal(jax.random.PRNGKey(0), (64, 64))
    exact, rough = (
        jax.numpy.matmul(matrix, matrix, precision=PRECISIONS[name]) for name in ("fp32", "bf16")
    )
    return bool((exact != rough).any())


if __name__ == "__main__":
    main()
