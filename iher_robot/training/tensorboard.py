"""TensorBoard listener: the metrics of each epoch as scalars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from drivers.closing import Closing
from iher_robot.training.listener import Row, RunListener


class TensorBoard(RunListener, Closing):
    """Writes the metrics of each epoch for TensorBoard.

    Args:
        folder: Folder of the event files.
    """

    def __init__(self, folder: Path) -> None:
        self._writer = SummaryWriter(str(folder))

    def resume(self, rows: Sequence[Row]) -> None:
        """Write the last epoch again, which a crash after its checkpoint may have left out."""
        self.epoch(rows[-1])

    def epoch(self, row: Row) -> None:
        """Write the metrics of an epoch."""
        for name, value in row.items():
            self._writer.add_scalar(name, value, int(row["epoch"]))
        self._writer.flush()

    def close(self) -> None:
        """Close the event file."""
        self._writer.close()
