"""Crash-safe records of a run: episodes, ledger, budget, checkpoints."""
