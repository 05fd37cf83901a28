"""CUDA graphs: a sequence of kernels, captured once and replayed with other inputs."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import torch

Tensors = tuple[torch.Tensor, ...]
Work = Callable[[Tensors], dict[str, torch.Tensor]]


@dataclass(frozen=True)
class _CapturedGraph:
    graph: torch.cuda.CUDAGraph
    inputs: Tensors
    outputs: dict[str, torch.Tensor]


class CudaGraphs:
    """Captures each kind of work once and replays it, without launching every kernel.

    Small networks leave a GPU idle most of the time: launching a kernel takes longer than its
    work. The first time, work of a kind runs eagerly; the second time it is captured; from then on
    it is replayed.
    """

    def __init__(self) -> None:
        self._warmed_up: set[Hashable] = set()
        self._graphs: dict[Hashable, _CapturedGraph] = {}
        # One pool for all graphs: they never run concurrently, and their outputs are copied.
        self._memory = torch.cuda.graph_pool_handle()

    def clear(self) -> None:
        """Drop every graph, when the tensors that they read and write have moved."""
        self._warmed_up.clear()
        self._graphs.clear()

    def run(self, kind: Hashable, inputs: Tensors, work: Work) -> dict[str, torch.Tensor]:
        """Run work, or replay its graph with these inputs.

        Args:
            kind: Identifies the work: with inputs of the same shapes it launches the same kernels
                on the same tensors, inputs apart, and never synchronises with the host.
            inputs: Arguments of the work.
            work: Called when no graph of its kind exists yet.

        Returns:
            What the work returns, in new tensors.
        """
        kind = (kind, *(value.shape for value in inputs))
        if kind not in self._warmed_up:
            self._warmed_up.add(kind)
            return _warm_up(inputs, work)
        if kind not in self._graphs:
            self._graphs[kind] = self._capture(inputs, work)
        captured = self._graphs[kind]
        for static, value in zip(captured.inputs, inputs, strict=True):
            static.copy_(value)
        captured.graph.replay()
        return {name: value.clone() for name, value in captured.outputs.items()}

    def _capture(self, inputs: Tensors, work: Work) -> _CapturedGraph:
        static = tuple(value.clone() for value in inputs)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, pool=self._memory):  # records and computes nothing
            outputs = work(static)
        return _CapturedGraph(graph, static, outputs)


def _warm_up(inputs: Tensors, work: Work) -> dict[str, torch.Tensor]:
    # What libraries set up at their first use must not be captured; torch requires a stream other
    # than the default one.
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        outputs = work(inputs)
    torch.cuda.current_stream().wait_stream(stream)
    return outputs
