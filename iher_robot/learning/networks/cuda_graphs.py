"""Work that a GPU repeats by itself: CUDA graphs."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import torch

Tensors = tuple[torch.Tensor, ...]
Work = Callable[[Tensors], dict[str, torch.Tensor]]


@dataclass(frozen=True)
class _Recording:
    graph: torch.cuda.CUDAGraph
    inputs: Tensors
    outputs: dict[str, torch.Tensor]


class Captured:
    """Replays what was once recorded, so that no kernel waits for the processor to launch it.

    Small networks leave a GPU idle most of the time: launching a kernel takes longer than its
    work. Each kind of work is done once as it comes, recorded the second time it is asked for, and
    from then on replayed.
    """

    def __init__(self) -> None:
        self._seen: set[Hashable] = set()
        self._recordings: dict[Hashable, _Recording] = {}
        # One for all: they never run side by side, and what they return is copied.
        self._memory = torch.cuda.graph_pool_handle()

    def forget(self) -> None:
        """Drop every recording: what they read and write is elsewhere now."""
        self._seen.clear()
        self._recordings.clear()

    def run(self, kind: Hashable, inputs: Tensors, work: Work) -> dict[str, torch.Tensor]:
        """Do some work, or repeat it with other inputs.

        Args:
            kind: Work of one kind, with inputs of the same shapes, launches the same kernels on the
                same tensors but for the inputs, and asks the GPU for nothing.
            inputs: What it is done with.
            work: What is done.

        Returns:
            What the work returns; tensors of the caller's own.
        """
        kind = (kind, *(value.shape for value in inputs))
        if kind not in self._seen:
            self._seen.add(kind)
            return _beside(inputs, work)
        if kind not in self._recordings:
            self._recordings[kind] = self._record(inputs, work)
        recording = self._recordings[kind]
        for place, value in zip(recording.inputs, inputs, strict=True):
            place.copy_(value)
        recording.graph.replay()
        return {name: value.clone() for name, value in recording.outputs.items()}

    def _record(self, inputs: Tensors, work: Work) -> _Recording:
        places = tuple(value.clone() for value in inputs)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, pool=self._memory):  # nothing is computed yet
            outputs = work(places)
        return _Recording(graph, places, outputs)


def _beside(inputs: Tensors, work: Work) -> dict[str, torch.Tensor]:
    # What libraries set up when they are first used must not be recorded; torch asks for a stream
    # other than the default one.
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        outputs = work(inputs)
    torch.cuda.current_stream().wait_stream(stream)
    return outputs
